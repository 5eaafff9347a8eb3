"""Whether an object has the painting's colours, and in the painting's shares."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.metrics.lab import cells, distinct, lab_from_rgb, nearest_colors, thinned

TOLERANCE = 10.0  # of Lab, from which a colour is another one, rather than another shade
SAME = 1.0  # of Lab, the size of the cubes whose colours count as one
SURELY_NEAR = 5.0  # of Lab: no colours in a cube of this size are farther apart than 8.7
DIRECTIONS = 64  # that palettes are projected on
QUANTILES = 256  # by which two projections are compared


def off_palette(colors: Float[Tensor, "P 3"], style: Float[Tensor, "Q 3"]) -> float:
    """The share of colours that are farther than 10 in Lab (CIE 1976) from all of the style.

    Args:
        colors: In 0..1; of very many some, evenly chosen, stand for all.
        style: Those of the pictures, in 0..1. Such as differ by less than about 1 count as one.
    """
    lab = lab_from_rgb(thinned(colors))
    palette = lab_from_rgb(distinct(style, SAME))
    far = ~torch.isin(cells(lab, SURELY_NEAR), cells(palette, SURELY_NEAR))
    if not far.any():
        return 0.0
    others = lab[far]
    distances = (others - palette[nearest_colors(others, palette)]).norm(dim=1)
    return int((distances > TOLERANCE).sum()) / len(lab)


def palette_distance(
    colors: Float[Tensor, "P 3"], style: Float[Tensor, "Q 3"], *, seed: int = 0
) -> float:
    """The sliced Wasserstein distance of two sets of colours, in Lab.

    Args:
        colors: In 0..1.
        style: In 0..1.
        seed: Of the directions that both are projected on.

    Returns:
        The root mean square over directions and quantiles; 0 if all colours have their shares.
        It is 1 / sqrt(3) of the distance if all colours are moved by the same.
    """
    generator = torch.Generator().manual_seed(seed)
    directions = F.normalize(torch.randn(3, DIRECTIONS, generator=generator), dim=0).to(colors)
    levels = ((torch.arange(QUANTILES) + 0.5) / QUANTILES).to(colors)
    one, other = (
        (lab_from_rgb(thinned(each)) @ directions).quantile(levels, dim=0)
        for each in (colors, style)
    )
    return float((one - other).square().mean().sqrt())
