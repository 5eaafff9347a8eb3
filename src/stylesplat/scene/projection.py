"""Between the world and the pixels of one camera; centres of pixels lie at +0.5."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from stylesplat.scene.cameras import Cameras

IN_IMAGES = 1000  # points that are projected into every image


def depths_of(points: Float[Tensor, "P 3"], camera: Cameras) -> Float[Tensor, " P"]:
    """How far along a camera's z axis points lie; negative behind it."""
    axis = camera.viewmats[0, 2].to(points)
    return points @ axis[:3] + axis[3]


def project(
    points: Float[Tensor, "P 3"], camera: Cameras
) -> tuple[Float[Tensor, "P 2"], Float[Tensor, " P"]]:
    """Where points lie in a camera's image, and their depths. Behind it places mean nothing."""
    viewmat, K = camera.viewmats[0].to(points), camera.Ks[0].to(points)
    points_c = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    depths = points_c[:, 2]
    return (points_c @ K.T)[:, :2] / depths[:, None], depths


def shown(points: Float[Tensor, "P 3"], camera: Cameras) -> Tensor:
    """Which points lie in a camera's image, though something may hide them."""
    places, depths = project(points, camera)
    size = torch.tensor(camera.size).to(places)
    return ((places >= 0) & (places < size)).all(dim=1) & (depths > 0)


def unproject(
    pixels: Float[Tensor, "P 2"], depths: Float[Tensor, " P"], camera: Cameras
) -> Float[Tensor, "P 3"]:
    """World positions of pixels of a camera at a depth along its z axis."""
    viewmat, K = camera.viewmats[0].to(depths), camera.Ks[0].to(depths)
    ones = pixels.new_ones(len(pixels), 1)
    rays_c = torch.cat([pixels, ones], dim=1) @ torch.linalg.inv(K).T
    return (rays_c * depths[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3]


def pixel_centres(width: int, height: int) -> Float[Tensor, "P 2"]:
    """The places, x and y, of all pixels of an image, row by row."""
    x, y = torch.arange(width) + 0.5, torch.arange(height) + 0.5
    return torch.cartesian_prod(y, x).flip(1)


def crop(
    camera: Cameras, corner: Sequence[int | float], size: Sequence[int], *, zoom: float = 1.0
) -> Cameras:
    """What a camera sees to the right of and below a place of its image, or beside it.

    Args:
        camera: One camera.
        corner: Left and top, in the camera's pixels; they may lie outside the image.
        size: Width and height of the new image, in its own pixels.
        zoom: How many of them make one of the camera's.
    """
    Ks = camera.Ks.clone()
    Ks[:, :2, 2] -= Ks.new_tensor(corner)
    Ks[:, :2] *= zoom
    return replace(camera, Ks=Ks, sizes=torch.tensor([size], dtype=camera.sizes.dtype))


def share_in_images(points: Float[Tensor, "M 3"], cameras: Cameras) -> Float[Tensor, " C"]:
    """The share of points that lies in each image, whether or not something hides them."""
    some = points[:: max(1, len(points) // IN_IMAGES)].to(cameras.viewmats)
    return torch.stack([shown(some, camera).float().mean() for camera in cameras])


def overlapping(
    lows: Shaped[Tensor, "N D"],
    highs: Shaped[Tensor, "N D"],
    low: Shaped[Tensor, " D"],
    high: Shaped[Tensor, " D"],
) -> Int[Tensor, " M"]:
    """Which boxes share a point with another one, in order.

    One axis after the other is looked at: few are left after the first.

    Args:
        lows: Their lower corners; for points, these.
        highs: Their upper corners.
        low: The lower corner of the other one.
        high: Its upper corner.
    """
    rows = ((lows[:, 0] <= high[0]) & (highs[:, 0] >= low[0])).nonzero()[:, 0]
    for axis in range(1, len(low)):
        shared = (lows[rows, axis] <= high[axis]) & (highs[rows, axis] >= low[axis])
        rows = rows[shared]
    return rows
