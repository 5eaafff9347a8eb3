"""Children of split Gaussians that show where nothing of the object showed, taken back.

Children of large Gaussians close to a camera, each of which it sees in its own perspective; that
lie before what hid the parent's centre; or that grew when they were fitted.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Int
from torch import Tensor
from torch.nn.functional import pad

from stylesplat.progress import track
from stylesplat.rendering import cpu, rasterize
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.gaussians import views_of
from stylesplat.rendering.linear import contributions
from stylesplat.rendering.shares import coverage, without_looks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.split import Split, unsplit

CHECKED_VIEWS = 16
Untouched = tuple[Cameras, Tensor]  # one camera, and some of its pixels [H, W]
NONE = torch.zeros(0, dtype=torch.long)


@torch.no_grad()
def without_overflow(
    splats: Splats, split: Split, picked: Bool[Tensor, " N"], cameras: Cameras
) -> Split:
    """Leave those Gaussians whole whose children show where nothing of the object showed.

    Args:
        splats: The scene before the split, on the CPU.
        split: After it.
        picked: The object's Gaussians, before.
        cameras: Views in which the object may cover no pixel that it did not cover before; of
            many some are checked.
    """
    rows = beside(split.splats, picked[split.parents], untouched(splats, picked, cameras))
    return unsplit(splats, split, split.parents[rows].unique())


@torch.no_grad()
def untouched(
    splats: Splats, picked: Bool[Tensor, " N"], cameras: Cameras, *, views: int = CHECKED_VIEWS
) -> list[Untouched]:
    """Some cameras, and the pixels of each in which nothing of an object shows.

    Args:
        splats: The scene, on the CPU.
        picked: The object's Gaussians.
        cameras: To choose from.
        views: How many, at most.
    """
    bare = without_looks(splats)

    def look(row: int) -> Untouched:
        return cameras[row], coverage(bare, cameras[row], picked) == 0

    rows = evenly(range(len(cameras)), views)
    return [*track(at_once(look, rows), "looking where nothing shows", total=len(rows))]


@torch.no_grad()
def beside(
    splats: Splats, picked: Bool[Tensor, " N"], pixels: Sequence[Untouched]
) -> Int[Tensor, " M"]:
    """Which of an object's Gaussians show where nothing of it may show.

    Args:
        splats: The scene, on the CPU.
        picked: The object's Gaussians.
        pixels: Where nothing may show.
    """
    bare = without_looks(splats)

    def overflowing(where: Untouched) -> Tensor:
        return _showing(bare, where[0], picked, where[1])

    found = track(at_once(overflowing, pixels), "looking beside the object", total=len(pixels))
    return torch.cat([NONE, *found]).unique()


def _showing(
    splats: Splats, camera: Cameras, picked: Tensor, pixels: Bool[Tensor, "H W"]
) -> Int[Tensor, " M"]:
    """Which picked Gaussians show in some pixels of one camera; only what lies there is drawn."""
    suspects = picked.nonzero()[:, 0]
    suspects = suspects[_touching(splats[suspects], camera, pixels)]
    alone = splats[suspects]
    reached = coverage(alone, camera, torch.ones_like(suspects, dtype=torch.bool)) > 0
    pixels = pixels & reached
    if not pixels.any():
        return suspects[:0]
    there = _touching(splats, camera, pixels).nonzero()[:, 0]
    drawn = contributions(splats[there], camera, picked[there])
    return there[drawn.gaussians[drawn.weights(pixels) > 0]]


def _touching(splats: Splats, camera: Cameras, pixels: Bool[Tensor, "H W"]) -> Bool[Tensor, " N"]:
    """Which Gaussians may reach some pixels: the boxes around them hold some."""
    projected = cpu.project_gaussians(
        rasterize.activated(splats), views_of(rasterize.beside(splats, camera))[0]
    )
    sums = pad(pixels.int().cumsum(0).cumsum(1), (1, 0, 1, 0))  # [H + 1, W + 1]
    size = torch.tensor(camera.size)
    low = (projected.means2d - projected.radii).floor().long().clamp(min=0).minimum(size)
    high = (projected.means2d + projected.radii).ceil().long().clamp(min=0).minimum(size)
    (left, top), (right, bottom) = low.unbind(1), high.unbind(1)
    held = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return (held > 0) & (projected.radii > 0).all(dim=1)
