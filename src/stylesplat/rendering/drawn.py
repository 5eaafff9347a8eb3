"""Which Gaussians show in a view, and where; without colours, on the CPU.

Kernels are loaded when something is looked up: to select by id none are needed.
"""

import numpy as np
import torch
from jaxtyping import Bool, Int, Real
from torch import Tensor
from torch.nn.functional import pad

from stylesplat.rendering.gaussians import Gaussians, Projected, views_of
from stylesplat.rendering.rasterize import activated, beside
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

AT_ONCE = 1 << 16  # Gaussians whose places stay in the cache while they are looked up


@torch.no_grad()
def drawn(
    gaussians: Gaussians, camera: Cameras, pixels: Bool[Tensor, "H W"] | None = None
) -> Int[Tensor, " M"]:
    """Which Gaussians reach a pixel of one camera, in no order.

    Args:
        gaussians: As they are drawn, on the CPU.
        camera: The camera, with matrices of their type.
        pixels: Those that count; of what cannot reach one of them nothing is drawn.
    """
    from stylesplat.rendering import cpu
    from stylesplat.rendering.linear import reaching

    projected = cpu.project_gaussians(gaussians, views_of(camera)[0])
    rows = _near(projected, pixels)
    seen = Projected(*(each[rows] for each in projected))
    colors = gaussians.means.new_zeros(len(rows), 3)
    tiled = cpu.draw(seen, gaussians.opacities[rows], colors, camera.size).tiled
    return rows[torch.from_numpy(tiled.order[reaching(tiled)].astype(np.int64))]


def _near(projected: Projected, pixels: Bool[Tensor, "H W"] | None) -> Int[Tensor, " M"]:
    """Those that may reach a pixel that counts."""
    rows = []
    parts = zip(projected.means2d.split(AT_ONCE), projected.radii.split(AT_ONCE), strict=True)
    for number, (places, radii) in enumerate(parts):
        near = (radii > 0).all(dim=1)
        if pixels is not None:
            near &= touching((places - radii).floor(), (places + radii).ceil(), pixels)
        rows.append(AT_ONCE * number + near.nonzero()[:, 0])
    return torch.cat(rows)


def touching(
    low: Real[Tensor, "N 2"], high: Real[Tensor, "N 2"], pixels: Bool[Tensor, "H W"]
) -> Bool[Tensor, " N"]:
    """Which boxes of pixels, from and to, hold some that count."""
    size = low.new_tensor([*pixels.shape[::-1]])
    low, high = (corner.clamp(min=0).minimum(size).long() for corner in (low, high))
    sums = pad(pixels.int().cumsum(0).cumsum(1), (1, 0, 1, 0))  # [H + 1, W + 1]
    (left, top), (right, bottom) = low.unbind(1), high.unbind(1)
    return sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left] > 0


@torch.no_grad()
def in_picture(splats: Splats, camera: Cameras) -> Splats:
    """The Gaussians that may reach the picture of one camera: of a part of a photo few.

    Args:
        splats: The scene. On a GPU, which draws it at once, all are kept.
        camera: The camera.
    """
    if splats.device.type != "cpu":
        return splats
    low, high = pixel_bounds(splats, camera)
    return splats[(low < high).all(dim=1).nonzero()[:, 0]]


@torch.no_grad()
def pixel_bounds(splats: Splats, camera: Cameras) -> tuple[Int[Tensor, "N 2"], Int[Tensor, "N 2"]]:
    """The pixels that each Gaussian may reach, from and to; none if it is not drawn."""
    from stylesplat.rendering import cpu

    views = views_of(beside(splats, camera))
    projected = cpu.project_gaussians(activated(splats), views[0])
    seen = (projected.radii > 0).all(dim=1, keepdim=True)
    low = (projected.means2d - projected.radii).floor() * seen
    high = (projected.means2d + projected.radii).ceil() * seen
    return low.long(), high.long()
