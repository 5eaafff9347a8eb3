"""Keeping an object to the colours of its painting, which matching features alone does not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.metrics.lab import distinct, lab_from_rgb, nearest_colors, thinned
from stylesplat.scene.splats import SH_C0, Splats
from stylesplat.stylization.object_views import ObjectView, weights_in, with_fixed_bands

SHADE = 5.0  # of Lab: colours in one cube of this size are one
NEAR = 6.0  # of Lab: as near is near enough
LEVELS = 24  # of red, green and blue, for which the nearest colour is looked up once
ROUNDS = 4  # of `settle`; further ones hardly change anything
STRIDE = 1.5  # of its steps: more than 1 is sooner there, from 2 on it would not settle
DARKEST = 1e-4  # of 1: above the clamp at black, where no gradient is, far below a level
FAINT = 0.05  # of the median weight: Gaussians that show less move accordingly less


@dataclass(frozen=True)
class NearPalette:
    """The nearest colour of a painting to every colour there is."""

    table: Float[Tensor, "_ 3"]
    """In 0..1, by red, green and blue in `LEVELS` levels, blue running fastest."""
    shares: Float[Tensor, " _"]
    """Of the way there, that which ends as near as is near enough; 0 for what is nearer."""

    def way_back(self, colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
        """From colours in 0..1 to where the painting is near; has no gradients."""
        colors = colors.detach()
        levels = (colors.clamp(0, 1) * (LEVELS - 1)).round()
        rows = (levels @ levels.new_tensor([LEVELS**2, LEVELS, 1])).long().flatten()
        nearest = self.table.index_select(0, rows).view(colors.shape)
        return (nearest - colors) * self.shares.index_select(0, rows).view(*colors.shape[:-1], 1)

    def distance(
        self, image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]
    ) -> Float[Tensor, ""]:
        """The mean square of the ways back of some pixels, which gradients shorten."""
        back = self.way_back(image) * mask[..., None]
        there = torch.where(back != 0, image.detach() + back, image)
        return (image - there).square().sum() / mask.sum()


@torch.no_grad()
def near_palette(style: Float[Tensor, "Q 3"]) -> NearPalette:
    """Prepare the colours of a painting, in 0..1."""
    palette = distinct(thinned(style), SHADE)  # what is rarer need not be aimed at
    axis = torch.linspace(0, 1, LEVELS).to(style)
    every, shades = lab_from_rgb(torch.cartesian_prod(axis, axis, axis)), lab_from_rgb(palette)
    nearest = nearest_colors(every, shades)
    away = (every - shades[nearest]).norm(dim=1)
    return NearPalette(palette[nearest], (1 - NEAR / away).clamp(min=0))


def settle(
    splats: Splats, shares: Float[Tensor, " N"], views: Sequence[ObjectView], near: NearPalette
) -> Splats:
    """Move the colours of an object's Gaussians until an object's pixels are near a painting's.

    Each round sends every pixel's way back to the Gaussians that it shows, by their weights there,
    and averages (simultaneous algebraic reconstruction, Gilbert 1972). Pixels that are near ask
    for nothing to change.

    Args:
        splats: The scene.
        shares: How much of each Gaussian is the object's; it moves that much of the way.
        views: Where to look at the object.
        near: The painting's colours.
    """
    picked = shares > 0
    views = with_fixed_bands(views, splats)
    weights = weights_in(views, splats, picked)
    weights = weights + FAINT * weights[weights > 0].median()
    colors = splats.sh0[picked, 0] * SH_C0 + 0.5
    strides = STRIDE * shares[picked, None]
    brightest = colors.clamp(min=1)  # what shows in part needs colours beyond white
    for _ in range(ROUNDS):
        # below black nothing shows, and nothing can be asked for
        splats = _with_colors(splats, picked, colors.clamp(min=DARKEST))
        wanted = _wanted(splats, picked, views, near) / weights[:, None]
        colors = (colors.clamp(min=DARKEST) + strides * wanted).minimum(brightest)
    return _with_colors(splats, picked, colors.clamp(min=0))


def _with_colors(splats: Splats, picked: Tensor, colors: Tensor) -> Splats:
    sh0 = splats.sh0.clone()
    sh0[picked, 0] = (colors - 0.5) / SH_C0
    return replace(splats, sh0=sh0)


def _wanted(splats: Splats, picked: Tensor, views: Sequence[ObjectView], near: NearPalette):
    """The ways back of all pixels, summed over those that show each picked Gaussian."""
    sh0 = splats.sh0.detach().requires_grad_()
    with torch.enable_grad():
        for view in views:
            image = view.render(replace(splats, sh0=sh0))
            (image * near.way_back(image) * view.pixels[..., None]).sum().backward()
    assert sh0.grad is not None
    return sh0.grad[picked, 0] / SH_C0
