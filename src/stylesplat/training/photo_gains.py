"""How bright photos are against each other, from points that several of them show."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.progress import track
from stylesplat.scene.projection import project
from stylesplat.scene.sampling import evenly
from stylesplat.training.training_views import View

POINTS = 2000  # that are looked at
ROUNDS = 8  # of taking photos' and points' medians in turn
DARK, BRIGHT = 0.05, 0.98  # colours beyond tell nothing of a gain
FEWEST = 30  # points by which a photo is judged


def photo_gains(
    points: Float[Tensor, "M 3"], views: Callable[[int], View], rows: Sequence[int]
) -> Float[Tensor, "R 3"]:
    """The logarithms of each photo's gain per channel of sRGB, whose mean over photos is 0.

    Points may be hidden, and shine; medians see past that.

    Args:
        points: Sparse points in the world.
        views: Photos with their cameras, by row.
        rows: Which photos.
    """
    some = points[evenly(range(len(points)), POINTS)].cpu()
    logs = torch.stack([_colors(some, views(row)) for row in track(rows, "comparing exposures")])
    seen = (~logs.isnan()).all(dim=-1).sum(dim=1)  # [R]
    gains = torch.zeros(len(rows), 3)
    for _ in range(ROUNDS):
        typical = (logs - gains[:, None]).nanmedian(dim=0).values  # [P, 3]
        gains = (logs - typical).nanmedian(dim=1).values
        gains = torch.where((seen < FEWEST)[:, None], 0.0, gains)
        gains = gains - gains.mean(dim=0)
    return gains


def _colors(points: Float[Tensor, "P 3"], view: View) -> Float[Tensor, "P 3"]:
    """Logarithms of a photo's colours at points; NaN where they tell nothing."""
    photo = view.photo.cpu()
    height, width, _ = photo.shape
    places, depths = project(points, view.camera)
    x, y = places.nan_to_num(-1, -1, -1).clamp(-1, 1e6).floor().long().unbind(dim=1)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (depths > 0)
    colors = photo[y.clamp(0, height - 1), x.clamp(0, width - 1)]
    told = inside & (colors > DARK).all(dim=1) & (colors < BRIGHT).all(dim=1)
    return torch.where(told[:, None], colors.clamp(min=DARK).log(), torch.nan)
