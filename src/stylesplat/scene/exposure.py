"""Exposure and white balance of photos, compared by the colours of points that they show."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import is_in_image, project
from stylesplat.scene.sampling import evenly

POINTS = 2000  # whose colours are compared
ROUNDS = 8  # of taking photos' and points' medians in turn
DARK, BRIGHT = 0.05, 0.98  # colours beyond say nothing about a gain
FEWEST = 30  # points by which a photo's gain is estimated


def photo_gains(
    points: Float[Tensor, "M 3"], photos: Iterable[tuple[Float[Tensor, "H W 3"], Cameras]]
) -> Float[Tensor, "C 3"]:
    """The logarithms of each photo's gain per channel of sRGB, whose mean over photos is 0.

    Medians ignore points that are hidden in a photo, or shine. A photo that shows too few points
    has NaN. Each photo comes with a camera of its size.
    """
    some = points[evenly(range(len(points)), POINTS)].cpu()
    logs = torch.stack([_log_colors(some, photo, camera) for photo, camera in photos])  # [C, P, 3]
    known = (~logs.isnan()).all(dim=-1).sum(dim=1) >= FEWEST  # [C]
    gains = torch.where(known[:, None], torch.zeros(len(logs), 3), torch.nan)
    if not known.any():
        return gains
    for _ in range(ROUNDS):
        typical = (logs - gains[:, None]).nanmedian(dim=0).values  # [P, 3]
        gains = torch.where(known[:, None], (logs - typical).nanmedian(dim=1).values, torch.nan)
        gains = gains - gains.nanmean(dim=0)
    return gains


def _log_colors(
    points: Float[Tensor, "P 3"], photo: Float[Tensor, "H W 3"], camera: Cameras
) -> Float[Tensor, "P 3"]:
    """Logarithms of a photo's colours at points; NaN where they say nothing about a gain."""
    logs = torch.full_like(points, torch.nan)
    rows = is_in_image(points, camera).nonzero()[:, 0]
    x, y = project(points[rows], camera)[0].long().unbind(dim=1)
    height, width, _ = photo.shape
    colors = photo[y.clamp(max=height - 1), x.clamp(max=width - 1)]
    usable = (colors > DARK).all(dim=1) & (colors < BRIGHT).all(dim=1)
    logs[rows[usable]] = colors[usable].log()
    return logs
