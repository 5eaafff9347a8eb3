"""Projection between the world and the pixels of one camera; pixel centres lie at +0.5."""

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor
from torch.nn import functional as F

from stylesplat.scene.cameras import Cameras

IN_IMAGES = 1000  # points that are projected into every image


def depths_of(points: Float[Tensor, "P 3"], camera: Cameras) -> Float[Tensor, " P"]:
    """Coordinates of points along a camera's z axis."""
    axis = camera.viewmats[0, 2].to(points)
    return points @ axis[:3] + axis[3]


def project(
    points: Float[Tensor, "P 3"], camera: Cameras
) -> tuple[Float[Tensor, "P 2"], Float[Tensor, " P"]]:
    """Pixels and depths of points in a camera; pixels are valid where depths are positive."""
    viewmat, K = camera.viewmats[0].to(points), camera.Ks[0].to(points)
    points_c = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    depths = points_c[:, 2]
    return (points_c @ K.T)[:, :2] / depths[:, None], depths


def is_in_image(points: Float[Tensor, "P 3"], camera: Cameras) -> Tensor:
    """Which points lie in a camera's image, hidden or not."""
    places, depths = project(points, camera)
    size = torch.tensor(camera.size).to(places)
    return ((places >= 0) & (places < size)).all(dim=1) & (depths > 0)


def unproject(
    pixels: Float[Tensor, "P 2"], depths: Float[Tensor, " P"], camera: Cameras
) -> Float[Tensor, "P 3"]:
    """World positions of a camera's pixels at some depths along its z axis."""
    viewmat, K = camera.viewmats[0].to(depths), camera.Ks[0].to(depths)
    ones = pixels.new_ones(len(pixels), 1)
    rays_c = torch.cat([pixels, ones], dim=1) @ torch.linalg.inv(K).T
    return (rays_c * depths[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3]


def pixel_centres(width: int, height: int) -> Float[Tensor, "P 2"]:
    """The centres, x and y, of all pixels of an image, row by row."""
    x, y = torch.arange(width) + 0.5, torch.arange(height) + 0.5
    return torch.cartesian_prod(y, x).flip(1)


def normals_towards(
    points: Float[Tensor, "H W 3"], origin: Float[Tensor, "1 3"]
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W"]]:
    """Normals towards a camera from neighbouring pixels' points, and their cosines to the rays."""
    padded = F.pad(points.permute(2, 0, 1)[None], (1, 1, 1, 1), mode="replicate")[0]
    along = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    down = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    normals = F.normalize(torch.linalg.cross(along, down, dim=0), dim=0).permute(1, 2, 0)
    facing = (normals * F.normalize(origin - points, dim=2)).sum(dim=2)
    return normals * facing.sign()[..., None], facing.abs()


def share_in_images(points: Float[Tensor, "M 3"], cameras: Cameras) -> Float[Tensor, " C"]:
    """The share of points that lies in each image, hidden or not."""
    some = points[:: max(1, len(points) // IN_IMAGES)].to(cameras.viewmats)
    return torch.stack([is_in_image(some, camera).float().mean() for camera in cameras])


def overlapping(
    lows: Shaped[Tensor, "N D"],
    highs: Shaped[Tensor, "N D"],
    low: Shaped[Tensor, " D"],
    high: Shaped[Tensor, " D"],
) -> Int[Tensor, " M"]:
    """The rows of the boxes, given by their corners, that overlap another one; in order."""
    return ((lows <= high) & (highs >= low)).all(dim=1).nonzero()[:, 0]
