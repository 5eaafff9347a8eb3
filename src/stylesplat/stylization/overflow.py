"""Gaussians of a painted object that show where nothing of the object showed."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.linear import contributions
from stylesplat.rendering.shares import coverage, without_looks
from stylesplat.rendering.visibility import pixel_bounds, touching
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats

Untouched = tuple[Cameras, Tensor]  # one camera, and some of its pixels [H, W]
NONE = torch.zeros(0, dtype=torch.long)


@torch.no_grad()
def untouched(
    splats: Splats, picked: Bool[Tensor, " N"], cameras: Sequence[Cameras]
) -> list[Untouched]:
    """The pixels of each camera in which nothing of an object shows.

    Args:
        splats: The scene, on the CPU.
        picked: The object's Gaussians.
        cameras: One by one.
    """
    bare = without_looks(splats)

    def look(camera: Cameras) -> Untouched:
        return camera, coverage(bare, camera, picked) == 0

    return [*track(at_once(look, cameras), "looking where nothing shows", total=len(cameras))]


@torch.no_grad()
def cut_to(splats: Splats, cameras: Cameras, margin: int) -> list[Cameras]:
    """The part of each camera's image that Gaussians may reach; none of one that sees none.

    Args:
        splats: The Gaussians, on the CPU.
        cameras: All of them.
        margin: Pixels around that part.
    """
    cuts = []
    for index in range(len(cameras)):
        camera = cameras[index]
        low, high = pixel_bounds(splats, camera)
        low, high = (low - margin).clamp(min=0), torch.minimum(high + margin, camera.sizes[0])
        found = (low < high).all(dim=1)
        if found.any():
            low, high = low[found].amin(dim=0), high[found].amax(dim=0)
            cuts.append(crop(camera, low.tolist(), (high - low).tolist()))
    return cuts


@torch.no_grad()
def beside(
    splats: Splats, picked: Bool[Tensor, " N"], pixels: Sequence[Untouched]
) -> list[Int[Tensor, " M"]]:
    """Which of an object's Gaussians show where nothing of it may show, in each view.

    Args:
        splats: The scene, on the CPU.
        picked: The object's Gaussians.
        pixels: Where nothing may show.
    """
    bare = without_looks(splats)

    def overflowing(where: Untouched) -> Tensor:
        return _showing(bare, where[0], picked, where[1])

    return [*track(at_once(overflowing, pixels), "looking beside the object", total=len(pixels))]


def _showing(
    splats: Splats, camera: Cameras, picked: Tensor, pixels: Bool[Tensor, "H W"]
) -> Int[Tensor, " M"]:
    """Which picked Gaussians show in some pixels of one camera; only what lies there is drawn."""
    suspects = picked.nonzero()[:, 0]
    suspects = suspects[touching(*pixel_bounds(splats[suspects], camera), pixels)]
    pixels = pixels & reached(splats[suspects], camera)
    if not pixels.any():
        return suspects[:0]
    there = touching(*pixel_bounds(splats, camera), pixels).nonzero()[:, 0]
    drawn = contributions(splats[there], camera, picked[there])
    return there[drawn.gaussians[drawn.weights(pixels) > 0]]


def reached(splats: Splats, camera: Cameras) -> Bool[Tensor, "H W"]:
    """The pixels in which some Gaussians would show if there were no others."""
    everyone = torch.ones(len(splats), dtype=torch.bool)
    return coverage(without_looks(splats), camera, everyone) > 0
