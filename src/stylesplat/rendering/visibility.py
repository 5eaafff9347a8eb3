"""Which Gaussians are in view of one camera, and which of them are visible.

Gaussians in view may reach its image if there were no others; visible ones do reach a pixel. The
scene is projected a part at a time, so that memory is that of the Gaussians in view. Kernels are
loaded on the first call: to select by id none are needed.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Real
from torch import Tensor
from torch.nn.functional import pad

from stylesplat.interrupts import raise_if_interrupted
from stylesplat.rendering.reference import (
    EVERYONE,
    Backend,
    Projected,
    Rasterizer,
    activated,
    rasterizer,
    views_of,
    with_matrices_of,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import overlapping
from stylesplat.scene.splats import IDENTITY_SIZE, Splats

VISIBLE_LARGE = 400_000  # Gaussians of a scene; culling a smaller one takes as long as it saves
VISIBLE_MANY = (
    1 << 21
)  # Gaussians in view, from which features are gathered of the visible ones alone
CHANNELS_PER_PASS = IDENTITY_SIZE  # the CPU kernels are compiled for this many and for fewer
PART = 1 << 17  # Gaussians whose numbers stay in the processor's cache


class InView(NamedTuple):
    rows: Int[Tensor, " M"]
    """Rows of the scene, in order."""
    projected: Projected

    def some(self, places: Int[Tensor, " L"]) -> "InView":
        projected = Projected(*(each[places] for each in self.projected))
        return InView(self.rows[places], projected)

    def box(self, camera: Cameras) -> Bool[Tensor, "H W"]:
        """The rectangle of the camera's pixels that they may reach."""
        width, height = camera.size
        inside = torch.zeros(height, width, dtype=torch.bool, device=self.rows.device)
        if len(self.rows):
            low, high = bounds(self.projected)
            left, top = low.amin(dim=0).clamp(min=0).tolist()
            right, bottom = high.amax(dim=0).tolist()
            inside[int(top) : int(bottom), int(left) : int(right)] = True
        return inside


@torch.no_grad()
def in_view(
    splats: Splats,
    camera: Cameras,
    pixels: Bool[Tensor, "H W"] | None = None,
    backend: Backend = "auto",
) -> InView:
    """The Gaussians that may reach the image of one camera, if there were no others.

    With `pixels`, without those that cannot reach one of these.
    """
    raise_if_interrupted()  # all loops over views pass here
    starts = range(0, max(1, len(splats)), PART)
    parts = [_part_in_view(splats, camera, start, pixels, backend) for start in starts]
    columns = parts[0] if len(parts) == 1 else map(torch.cat, zip(*parts, strict=True))
    rows, *projected = columns
    return InView(rows, Projected(*projected))


def _part_in_view(
    splats: Splats,
    camera: Cameras,
    start: int,
    pixels: Bool[Tensor, "H W"] | None,
    backend: Backend,
) -> tuple[Tensor, ...]:
    projected = project_splats(splats, camera, slice(start, start + PART), backend)
    rows = (projected.radii[:, 0] > 0).nonzero()[:, 0]
    if pixels is not None:
        low, high = (corner.index_select(0, rows) for corner in bounds(projected))
        rows = rows[touching(low, high, pixels)]
    return start + rows, *(each.index_select(0, rows) for each in projected)


@torch.no_grad()
def project_splats(
    splats: Splats, camera: Cameras, part: slice = EVERYONE, backend: Backend = "auto"
) -> Projected:
    """Splats, or a part of them, in the pixels of one camera."""
    (view,) = views_of(with_matrices_of(splats, camera))
    return rasterizer(backend, splats.device).project_gaussians(activated(splats, part), view)


def touching(
    low: Real[Tensor, "N 2"], high: Real[Tensor, "N 2"], pixels: Bool[Tensor, "H W"]
) -> Bool[Tensor, " N"]:
    """Which boxes of pixels, from and to, hold marked ones."""
    touched = torch.zeros(len(low), dtype=torch.bool, device=low.device)
    marked = pixels.nonzero().flip(1).to(low)  # x, y
    if not len(marked):
        return touched
    first, last = torch.aminmax(marked, dim=0)
    rows = overlapping(low, high, first, last + 1)  # few are near a small object
    sums = pad(pixels.int().cumsum(0).cumsum(1), (1, 0, 1, 0))  # left of and above each corner
    size = low.new_tensor([*pixels.shape[::-1]])
    corners = (corner[rows].clamp(min=0).minimum(size).long() for corner in (low, high))
    (left, top), (right, bottom) = (corner.unbind(1) for corner in corners)
    counts = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return touched.index_fill(0, rows[counts > 0], True)


def tiled(projected: Projected, size: tuple[int, int], backend: Backend = "auto") -> "TiledView":
    """Projected Gaussians, prepared to composite values of theirs again and again."""
    drawn_by = rasterizer(backend, projected.depths.device)
    return TiledView(drawn_by.tile(projected, size), drawn_by)


def _nbytes(kept: Any) -> int:
    """The memory of tensors, in dictionaries and tuples of any depth."""
    if isinstance(kept, Tensor):
        return kept.nbytes
    parts = kept.values() if isinstance(kept, dict) else kept if isinstance(kept, tuple) else ()
    return sum(map(_nbytes, parts))


class TiledView(NamedTuple):
    """Projected Gaussians of one view, prepared for compositing by a backend."""

    tiles: Any
    drawn_by: Rasterizer

    @property
    def nbytes(self) -> int:
        """The memory of what is kept projected, or sorted into tiles."""
        return _nbytes(self.tiles)

    def composite(self, values: Float[Tensor, "M K"]) -> Float[Tensor, "H W K"]:
        """Composite their values, as many channels at a time as kernels take."""
        some = values.split(CHANNELS_PER_PASS, dim=1)
        parts = [self.drawn_by.composite(self.tiles, part) for part in some]
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=-1)

    def backproject(self, image: Float[Tensor, "H W K"]) -> Float[Tensor, "M K"]:
        """The adjoint."""
        some = image.split(CHANNELS_PER_PASS, dim=-1)
        parts = [self.drawn_by.backproject(self.tiles, part) for part in some]
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)


@torch.no_grad()
def visible(near: InView, camera: Cameras, view: TiledView | None = None) -> InView:
    """The Gaussians that reach a pixel of the camera, though others hide some.

    `view` is theirs, where it is there already.
    """
    if near.rows.device.type != "cpu":
        width, height = camera.size
        image = near.projected.means2d.new_ones(height, width, 1)
        view = view or tiled(near.projected, camera.size)
        pixels = view.backproject(image)
        return near.some(pixels.nonzero()[:, 0])
    from stylesplat.rendering import cpu

    colors = near.projected.means2d.new_zeros(len(near.rows), 3)
    lists = cpu.rasterize_to_pixels(near.projected, colors, camera.size).tiled
    places = np.sort(lists.order[cpu.reaching(lists)])
    return near.some(torch.from_numpy(places.astype(np.int64)))


@torch.no_grad()
def pixel_bounds(splats: Splats, camera: Cameras) -> tuple[Int[Tensor, "N 2"], Int[Tensor, "N 2"]]:
    """The pixels that each Gaussian may reach, from and to; none if it is out of view."""
    projected = project_splats(splats, camera)
    outside = (projected.radii <= 0).any(dim=1, keepdim=True)  # whose places gsplat does not write
    low, high = (corner.masked_fill(outside, 0) for corner in bounds(projected))
    return low.long(), high.long()


def bounds(projected: Projected) -> tuple[Float[Tensor, "N 2"], Float[Tensor, "N 2"]]:
    places, radii = projected.means2d, projected.radii
    return (places - radii).floor(), (places + radii).ceil()
