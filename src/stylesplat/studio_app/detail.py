"""Fewer Gaussians in place of many: for browsers that draw, and while the camera moves."""

import math
from dataclasses import replace
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import appearance_only
from stylesplat.scene.projection import share_in_images
from stylesplat.scene.splats import Splats

MOVING_GAUSSIANS = 100_000  # in view of a moving camera: two cores turn ten pictures a second
SMALLEST_DRAW = 1e-12  # a draw of 0 has no logarithm
LEVELS_PER_HALVING = 4  # as finely as the number of Gaussians follows the view


def most_visible(splats: Splats, count: int) -> Int[Tensor, " M"]:
    """Rows of the `count` Gaussians of the largest visible area, in order."""
    return _log_areas(splats).topk(min(count, len(splats))).indices.sort().values


def _log_areas(splats: Splats) -> Float[Tensor, " N"]:
    """Logarithms of opacities times the area of the largest side of each Gaussian."""
    scales = splats.scales
    return torch.nn.functional.logsigmoid(splats.opacities) + scales.sum(1) - scales.amin(1)


class ReducedSplats:
    """A random part of splats that covers as much as all of them.

    By priority sampling (Duffield, Lund and Thorup 2007): of Gaussians of the areas w, those with
    the largest w / u are kept, where u is uniform in 0 to 1. With the threshold t that is the
    largest w / u left out, a Gaussian was kept with the probability p = min(1, w / t), and its area
    is divided by p. So large Gaussians stay as they are, and some of the small ones grow.
    """

    def __init__(self, splats: Splats) -> None:
        self._splats = appearance_only(splats)
        self._level = 0, self._splats

    def seen_from(self, camera: Cameras, count: int = MOVING_GAUSSIANS) -> Splats:
        """Splats with about `count` Gaussians at most in view of a camera; all if these are few."""
        if len(self._splats) <= count:
            return self._splats
        seen = len(self._splats) * float(share_in_images(self._splats.means, camera)[0])
        level = max(0, math.ceil(LEVELS_PER_HALVING * math.log2(max(seen, 1.0) / count)))
        if level != self._level[0]:
            self._level = level, self._reduced(level)
        return self._level[1]

    def _reduced(self, level: int) -> Splats:
        if level == 0:
            return self._splats
        count = round(len(self._splats) * 2 ** (-level / LEVELS_PER_HALVING))
        areas, priorities, order = self._ranking
        rows = order[:count]
        log_probabilities = (areas[rows] - priorities[count]).clamp(max=0)
        kept = self._splats[rows]
        return replace(kept, scales=kept.scales - log_probabilities[:, None] / 2)

    @cached_property
    def _ranking(self) -> tuple[Float[Tensor, " N"], Float[Tensor, " N"], Int[Tensor, " N"]]:
        """Logarithms of areas; those of priorities, largest first, and whose they are."""
        areas = _log_areas(self._splats)
        draws = torch.rand(len(areas), generator=torch.Generator().manual_seed(0))
        priorities, order = (areas - draws.clamp(min=SMALLEST_DRAW).log()).sort(descending=True)
        return areas, priorities, order
