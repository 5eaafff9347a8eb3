"""The part of a large scene that one object is painted in: itself, and what shows around it.

Its surroundings are looked at once per view. Everything after that takes as long as in a scene that
has nothing else.
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
from stylesplat.rendering.visibility import LARGE, visible_rows
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.overflow import reached
from stylesplat.stylization.style_job import Studio, StyleJob

SHOWN = 0.02  # share of some pixel: what shows less in a view is behind others, but for seams
MARGIN = 24  # pixels around what it may reach: in smaller renders Gaussians grow by as much


@dataclass(frozen=True)
class CutScene:
    """What matters to an object."""

    rows: Int[Tensor, " M"]
    """Gaussians of the scene, in order."""
    views: frozenset[str]
    """Names of the views that show the object; in others what hides it may be missing."""

    def studio(self, studio: Studio) -> Studio:
        """The studio without what does not matter."""
        return replace(
            studio,
            splats=studio.splats[self.rows],
            cameras=self.showing(studio.cameras),
            every_camera=self.showing(studio.every_camera),
        )

    def showing(self, cameras: Cameras) -> Cameras:
        """Those of some views that show the object."""
        return cameras[[n for n, name in enumerate(cameras.names) if name in self.views]]

    def job(self, job: StyleJob) -> StyleJob:
        """The job among these Gaussians."""
        return replace(job, picked=job.picked[self.rows])

    def of_base(self, family: Int[Tensor, " N"]) -> "CutScene":
        """The same as rows of the base, given the one that each Gaussian belongs to."""
        return CutScene(family[self.rows].unique(), self.views)

    def among(self, family: Int[Tensor, " L"]) -> Int[Tensor, " K"]:
        """The Gaussians of other splats that belong to these rows of the base."""
        return torch.isin(family, self.rows).nonzero()[:, 0]


@torch.no_grad()
def cut_scene(studio: Studio, picked: Bool[Tensor, " N"]) -> CutScene | None:
    """Find what matters to an object; None where that is not worth its while, or no view shows it.

    Besides its own Gaussians these are all that would show where it may be seen if it were not
    there: what hides it, and what it hides. Whether new Gaussians show beside the object is not
    looked at in views that hide it.

    Args:
        studio: The scene, and all views that it will be seen in.
        picked: The object's Gaussians.
    """
    splats = studio.splats
    names = studio.every_camera.names
    if len(splats) < LARGE or splats.device.type != "cpu" or len({*names}) < len(names):
        return None
    views = [studio.every_camera[index] for index in range(len(studio.every_camera))]
    found = track(_around(splats, picked, views), "looking around the object", total=len(views))
    mine, shown = picked.clone(), set[str]()
    for name, rows in zip(names, found, strict=True):
        if rows is not None:
            mine[rows] = True
            shown.add(name)
    if shown.isdisjoint(studio.cameras.names):
        return None
    return CutScene(mine.nonzero()[:, 0], frozenset(shown))


def _around(
    splats: Splats, picked: Bool[Tensor, " N"], views: Sequence[Cameras]
) -> Iterator[Int[Tensor, " M"] | None]:
    """What would show around the picked Gaussians without them in each view that shows them."""
    bare, own = without_looks(splats), picked.nonzero()[:, 0]
    others = replace(bare, opacities=bare.opacities.masked_fill(picked, -torch.inf))
    alone, around = bare[own], np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)

    def look(view: Cameras) -> Tensor | None:
        near = reached(alone, view)
        if not near.any():
            return None
        near = torch.from_numpy(cv2.dilate(near.numpy().astype(np.uint8), around)).bool()
        rows = visible_rows(others, view, near)
        there = torch.cat([own, rows])
        shares = coverage(bare[there], view, torch.arange(len(there)) < len(own))
        return rows if (shares > SHOWN).any() else None

    return at_once(look, views)
