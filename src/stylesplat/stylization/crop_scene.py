"""The part of a large scene that an object is painted in: its Gaussians, and all that show near it.

The whole scene is rendered once per view. After that painting takes as long as in a small scene.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.shares import coverage, without_looks
from stylesplat.rendering.visibility import LARGE, in_view, visible
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.confine import reached_pixels
from stylesplat.stylization.target import PaintContext, PaintTarget

VISIBLE = 0.02  # share of some pixel: an object with less in a view is hidden, but for seams
MARGIN = 24  # pixels around what it may reach: in smaller renders Gaussians grow by as much


@dataclass(frozen=True)
class SceneCrop:
    """The Gaussians and views that matter to an object."""

    rows: Int[Tensor, " M"]
    """Gaussians of the scene, in order."""
    views: frozenset[str]
    """Names of the views that show the object; in others what hides it may be missing."""

    def context(self, context: PaintContext) -> PaintContext:
        """The context with these Gaussians and views alone."""
        return replace(
            context,
            splats=context.splats[self.rows],
            cameras=self.cameras(context.cameras),
            all_cameras=self.cameras(context.all_cameras),
        )

    def cameras(self, cameras: Cameras) -> Cameras:
        """The cameras that show the object."""
        return cameras[[n for n, name in enumerate(cameras.names) if name in self.views]]

    def target(self, target: PaintTarget) -> PaintTarget:
        """The target among these Gaussians."""
        protected = target.protected if target.protected is None else target.protected[self.rows]
        return replace(target, mask=target.mask[self.rows], protected=protected)

    def of_base(self, family: Int[Tensor, " N"]) -> "SceneCrop":
        """The same as rows of the base, given the one that each Gaussian belongs to."""
        return SceneCrop(family[self.rows].unique(), self.views)

    def rows_in(self, family: Int[Tensor, " L"]) -> Int[Tensor, " K"]:
        """The rows of other splats that belong to these rows of the base."""
        return torch.isin(family, self.rows).nonzero()[:, 0]


@torch.no_grad()
def crop_scene(context: PaintContext, mask: Bool[Tensor, " N"]) -> SceneCrop | None:
    """Find what matters to an object; None if the scene is small, or no view shows the object.

    Besides the object's Gaussians these are all that would show near it if it were not there: what
    hides it, and what it hides. In views that hide the object, new Gaussians are not confined.

    Args:
        context: The scene, and all views that it will be seen in.
        mask: The object's Gaussians.
    """
    splats, cameras = context.splats, context.all_cameras
    names = cameras.names
    if len(splats) < LARGE or splats.device.type != "cpu" or len({*names}) < len(names):
        return None
    views = [*cameras]
    found = track(_nearby(splats, mask, views), "looking around the object", total=len(views))
    kept, visible = mask.clone(), set[str]()
    for name, rows in zip(names, found, strict=True):
        if rows is not None:
            kept[rows] = True
            visible.add(name)
    if visible.isdisjoint(context.cameras.names):
        return None
    return SceneCrop(kept.nonzero()[:, 0], frozenset(visible))


def _nearby(
    splats: Splats, mask: Bool[Tensor, " N"], views: Sequence[Cameras]
) -> Iterator[Int[Tensor, " M"] | None]:
    """For each view the Gaussians that would show near the object; None if it is hidden there."""
    bare, own = without_looks(splats), mask.nonzero()[:, 0]
    others = replace(bare, opacities=bare.opacities.masked_fill(mask, -torch.inf))
    alone, square = bare[own], np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)

    def look(view: Cameras) -> Tensor | None:
        near = reached_pixels(alone, view)
        if not near.any():
            return None
        near = torch.from_numpy(cv2.dilate(near.numpy().astype(np.uint8), square)).bool()
        rows = visible(in_view(others, view, near), view).rows
        there = torch.cat([own, rows])
        shares = coverage(bare[there], view, torch.arange(len(there)) < len(own))
        return rows if (shares > VISIBLE).any() else None

    return at_once(look, views)
