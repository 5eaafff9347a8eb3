"""Which Gaussians one camera sees, and where; without colours, on the CPU.

The scene is looked through a part at a time, so that what is found takes the memory of what is
seen. Kernels are loaded when something is looked up: to select by id none are needed.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Real
from torch import Tensor
from torch.nn.functional import pad

from stylesplat.rendering.gaussians import Projected, views_of
from stylesplat.rendering.rasterize import activated, beside
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import overlapping
from stylesplat.scene.splats import Splats

LARGE = 400_000  # Gaussians of a scene; of fewer, looking for what matters takes what it saves
PART = 1 << 17  # Gaussians whose numbers stay in the cache while they are looked at


class Seen(NamedTuple):
    """The Gaussians that may reach a camera's image."""

    rows: Int[Tensor, " M"]
    """Which of the scene, in order."""
    projected: Projected
    """What the camera sees of them."""
    opacities: Float[Tensor, " M"]
    """From 0 to 1."""

    def some(self, places: Int[Tensor, " L"]) -> "Seen":
        """Some of them."""
        projected = Projected(*(each[places] for each in self.projected))
        return Seen(self.rows[places], projected, self.opacities[places])

    def box(self, camera: Cameras) -> Bool[Tensor, "H W"]:
        """The rectangle of that camera's pixels which they may reach."""
        width, height = camera.size
        inside = torch.zeros(height, width, dtype=torch.bool)
        if len(self.rows):
            low, high = bounds(self.projected)
            left, top = low.amin(dim=0).clamp(min=0).tolist()
            right, bottom = high.amax(dim=0).tolist()
            inside[int(top) : int(bottom), int(left) : int(right)] = True
        return inside


@torch.no_grad()
def seen(splats: Splats, camera: Cameras, pixels: Bool[Tensor, "H W"] | None = None) -> Seen:
    """Which Gaussians may reach the image of one camera, if there were no others.

    Args:
        splats: The scene, on the CPU.
        camera: The camera.
        pixels: Those that count; what cannot reach one of them is left out.
    """
    camera = beside(splats, camera)
    starts = range(0, max(1, len(splats)), PART)
    marked = None if pixels is None else _marked(pixels)
    parts = [_seen_part(splats, camera, start, marked) for start in starts]
    rows, opacities, *projected = parts.pop() if len(parts) == 1 else _joined(parts)
    return Seen(rows, Projected(*projected), opacities)


def _seen_part(
    splats: Splats, camera: Cameras, start: int, marked: "_Marked | None"
) -> tuple[Tensor, ...]:
    from stylesplat.rendering import cpu

    gaussians = activated(splats, slice(start, start + PART))
    projected = cpu.project_gaussians(gaussians, views_of(camera)[0])
    rows = (projected.radii[:, 0] > 0).nonzero()[:, 0]
    if marked is not None:
        low, high = (corner.index_select(0, rows) for corner in bounds(projected))
        rows = rows[_touching(low, high, marked)]
    found = (gaussians.opacities, *projected)
    return start + rows, *(each.index_select(0, rows) for each in found)


def _joined(parts: list[tuple[Tensor, ...]]) -> Iterator[Tensor]:
    """Each column as a whole; parts are let go once they are joined."""
    columns = [[*each] for each in zip(*parts, strict=True)]
    parts.clear()
    for column in columns:
        yield torch.cat(column)
        column.clear()


def touching(
    low: Real[Tensor, "N 2"], high: Real[Tensor, "N 2"], pixels: Bool[Tensor, "H W"]
) -> Bool[Tensor, " N"]:
    """Which boxes of pixels, from and to, hold some that count."""
    return _touching(low, high, _marked(pixels))


class _Marked(NamedTuple):
    """Pixels that count, for looking up many boxes."""

    sums: Int[Tensor, "_ _"]
    """How many lie left of and above each corner of a pixel: [H + 1, W + 1]."""
    first: Int[Tensor, " 2"]
    """The rectangle that holds them, from; beyond the image if there are none."""
    last: Int[Tensor, " 2"]
    """And to."""


def _marked(pixels: Bool[Tensor, "H W"]) -> _Marked:
    sums = pad(pixels.int().cumsum(0).cumsum(1), (1, 0, 1, 0))
    places = pixels.nonzero().flip(1)  # x, y
    size = places.new_tensor([*pixels.shape[::-1]])
    first, last = torch.aminmax(places, dim=0) if len(places) else (size + 1, size)
    return _Marked(sums, first, last + 1)


def _touching(low: Tensor, high: Tensor, marked: _Marked) -> Bool[Tensor, " N"]:
    touched = torch.zeros(len(low), dtype=torch.bool)
    first, last = marked.first.to(low), marked.last.to(low)
    rows = overlapping(low, high, first, last)  # few are near a small object
    sums = marked.sums
    size = low.new_tensor([side - 1 for side in reversed(sums.shape)])
    corners = (corner[rows].clamp(min=0).minimum(size).long() for corner in (low, high))
    (left, top), (right, bottom) = (corner.unbind(1) for corner in corners)
    counts = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return touched.index_fill(0, rows[counts > 0], True)


@torch.no_grad()
def drawn(
    splats: Splats, camera: Cameras, pixels: Bool[Tensor, "H W"] | None = None
) -> Int[Tensor, " M"]:
    """Which Gaussians reach a pixel of one camera, whatever others hide, in order.

    Args:
        splats: The scene, on the CPU.
        camera: The camera.
        pixels: Those that count; of what cannot reach one of them nothing is drawn.
    """
    return unhidden(seen(splats, camera, pixels), camera).rows


@torch.no_grad()
def unhidden(near: Seen, camera: Cameras) -> Seen:
    """What of it reaches a pixel of that camera."""
    from stylesplat.rendering import cpu
    from stylesplat.rendering.linear import reaching

    colors = near.opacities.new_zeros(len(near.rows), 3)
    tiled = cpu.draw(near.projected, near.opacities, colors, camera.size).tiled
    places = np.sort(tiled.order[reaching(tiled)])
    return near.some(torch.from_numpy(places.astype(np.int64)))


@torch.no_grad()
def pixel_bounds(splats: Splats, camera: Cameras) -> tuple[Int[Tensor, "N 2"], Int[Tensor, "N 2"]]:
    """The pixels that each Gaussian may reach, from and to; none if it is not drawn."""
    from stylesplat.rendering import cpu

    views = views_of(beside(splats, camera))
    projected = cpu.project_gaussians(activated(splats), views[0])
    shown = (projected.radii > 0).all(dim=1, keepdim=True)
    low, high = (corner * shown for corner in bounds(projected))
    return low.long(), high.long()


def bounds(projected: Projected) -> tuple[Float[Tensor, "N 2"], Float[Tensor, "N 2"]]:
    """The whole pixels that what is drawn may reach, from and to."""
    places, radii = projected.means2d, projected.radii
    return (places - radii).floor(), (places + radii).ceil()
