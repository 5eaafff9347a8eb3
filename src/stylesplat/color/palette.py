"""The colours of a picture, and the nearest of them to any colour."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.color.lab import distinct, lab_from_rgb, nearest_colors, thinned

SHADE = 5.0  # of Lab: colours in one cube of this size are one
NEAR = 6.0  # of Lab: a colour this near to the palette may stay
LEVELS = 24  # of red, green and blue in the table of nearest colours


@dataclass(frozen=True, eq=False)
class Palette:
    """The colours of a style, and the nearest of them to any colour."""

    table: Float[Tensor, "_ 3"]
    """The nearest colour in 0..1, by red, green and blue in `LEVELS` levels, blue fastest."""
    shares: Float[Tensor, " _"]
    """The share of the way there that ends at distance `NEAR`; 0 for nearer colours."""

    def offset(self, colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
        """From colours in 0..1 to where the palette is near; without gradients."""
        colors = colors.detach()
        red, green, blue = (colors.clamp(0, 1) * (LEVELS - 1)).round().long().unbind(-1)
        rows = ((red * LEVELS + green) * LEVELS + blue).flatten()
        nearest = self.table.index_select(0, rows).view(colors.shape)
        return (nearest - colors) * self.shares.index_select(0, rows).view(*colors.shape[:-1], 1)

    def distance(
        self, image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]
    ) -> Float[Tensor, ""]:
        """The mean squared offset of some pixels, which gradients shorten."""
        offset = self.offset(image) * mask[..., None]
        goal = torch.where(offset != 0, image.detach() + offset, image)
        return (image - goal).square().sum() / mask.sum()


@torch.no_grad()
def build_palette(style: Float[Tensor, "Q 3"]) -> Palette:
    """Prepare the colours of a style, in 0..1."""
    palette = distinct(thinned(style), SHADE)  # rarer colours are no aim
    axis = torch.linspace(0, 1, LEVELS).to(style)
    every, shades = lab_from_rgb(torch.cartesian_prod(axis, axis, axis)), lab_from_rgb(palette)
    nearest = nearest_colors(every, shades)
    away = (every - shades[nearest]).norm(dim=1)
    return Palette(palette[nearest], (1 - NEAR / away).clamp(min=0))
