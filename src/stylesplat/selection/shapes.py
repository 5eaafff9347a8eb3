"""Picking Gaussians by a shape in the world, for splats that know no objects."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.shares import COVERED, expected_depth
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop, unproject
from stylesplat.scene.splats import Splats


def in_box(splats: Splats, low: Float[Tensor, "3"], high: Float[Tensor, "3"]) -> Bool[Tensor, " N"]:
    """The Gaussians whose centres lie in a box along the world's axes.

    Raises:
        StyleSplatError: If the box is inverted or holds none.
    """
    if not (low < high).all():
        raise StyleSplatError(
            f"The box from {_text(low)} to {_text(high)} is empty. Give the lower corner first."
        )
    inside = ((splats.means >= low.to(splats.means)) & (splats.means <= high.to(splats.means))).all(
        1
    )
    return _some(inside, splats, f"the box from {_text(low)} to {_text(high)}")


def in_sphere(splats: Splats, centre: Float[Tensor, "3"], radius: float) -> Bool[Tensor, " N"]:
    """The Gaussians whose centres lie in a sphere, its radius in world units.

    Raises:
        StyleSplatError: If the radius is not positive or the sphere holds none.
    """
    if not radius > 0:
        raise StyleSplatError(f"A sphere cannot have the radius {radius:g}. Give more than 0.")
    inside = (splats.means - centre.to(splats.means)).norm(dim=1) <= radius
    return _some(inside, splats, f"the sphere of radius {radius:g} around {_text(centre)}")


@torch.no_grad()
def surface_point(
    splats: Splats, camera: Cameras, point: tuple[float, float]
) -> Float[Tensor, "3"]:
    """Where in the world the surface lies that shows at a pixel of one camera.

    Raises:
        StyleSplatError: If the pixel is outside the image, or nothing solid shows there.
    """
    (x, y), (width, height) = point, camera.size
    if not (0 <= x < width and 0 <= y < height):
        raise StyleSplatError(
            f"Point {x:g},{y:g} is outside {camera.names[0]}, which is {width}x{height} pixels."
        )
    row, column = int(y), int(x)
    pixel = crop(camera, (column, row), (1, 1))
    depths, alphas = expected_depth(splats, pixel)
    if alphas[0, 0] < COVERED:
        raise StyleSplatError(
            f"Nothing solid shows at {x:g},{y:g} in {camera.names[0]}. Choose another pixel."
        )
    depth = depths[0, 0]
    return unproject(depth.new_tensor([[column + 0.5, row + 0.5]]), depth[None], camera)[0]


def _some(inside: Tensor, splats: Splats, shape: str) -> Bool[Tensor, " N"]:
    if not inside.any():
        low, high = splats.means.amin(dim=0), splats.means.amax(dim=0)
        raise StyleSplatError(
            f"No Gaussian lies in {shape}. The splat reaches from {_text(low)} to {_text(high)}."
        )
    return inside


def _text(point: Tensor) -> str:
    return ",".join(f"{value:.3g}" for value in point.tolist())
