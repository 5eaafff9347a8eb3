"""What matters to each of many objects of a large scene: every view is looked at once for all."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int, Int32
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.seen import LARGE, bounds, pixel_bounds, seen, unhidden
from stylesplat.rendering.shares import without_looks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.overlap import overlapping
from stylesplat.scene.splats import Splats

MARGIN = 2  # pixels around what an object may reach
NEARBY = 0.25  # of an object's extent along each axis: what it stands on lies within


@dataclass(frozen=True)
class Shown:
    """What shows in one view."""

    camera: Cameras
    """The camera alone."""
    rows: Int32[Tensor, " M"]
    """Gaussians of the scene."""
    low: Int32[Tensor, "M 2"]
    """The pixels that each may reach, from."""
    high: Int32[Tensor, "M 2"]
    """And to."""


@dataclass(frozen=True)
class Survey:
    """What shows in some views."""

    splats: Splats
    """The scene."""
    views: Sequence[Shown]
    """Each view alone."""

    def around(self, picked: Bool[Tensor, " N"]) -> Int[Tensor, " M"]:
        """An object's Gaussians, those that show where it may be seen, and those close by.

        Args:
            picked: The object's Gaussians, at least one.
        """
        mine = picked.clone()
        own = self.splats[picked.nonzero()[:, 0]]
        for view in self.views:
            low, high = pixel_bounds(own, view.camera)
            shown = (low < high).all(dim=1)
            if shown.any():
                low, high = low[shown].amin(dim=0) - MARGIN, high[shown].amax(dim=0) + MARGIN
                mine[view.rows[overlapping(view.low, view.high, low + 1, high - 1)].long()] = True
        low, high = own.means.amin(dim=0), own.means.amax(dim=0)
        room = NEARBY * (high - low).norm()
        means = self.splats.means
        mine[overlapping(means, means, low - room, high + room)] = True
        return mine.nonzero()[:, 0]


@torch.no_grad()
def survey(splats: Splats, cameras: Sequence[Cameras]) -> Survey | None:
    """Look at every view once; None where that is not worth its while.

    Args:
        splats: The scene.
        cameras: One by one, in the size that objects are going to be looked at.
    """
    if len(splats) < LARGE or splats.device.type != "cpu":
        return None
    bare = without_looks(splats)

    def look(camera: Cameras) -> Shown:
        near = unhidden(seen(bare, camera), camera)
        low, high = bounds(near.projected)
        return Shown(camera, near.rows.int(), low.int(), high.int())

    found = at_once(look, cameras)
    return Survey(splats, [*track(found, "looking at all objects", total=len(cameras))])
