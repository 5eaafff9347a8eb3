"""The level plane that a scene stands on: a floor, a table."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

MAX_TILT = 15.0  # degrees by which cameras are taken to be wrong about what is level
TRIPLES = 20_000  # of points that planes are tried through; one in a hundred is level in a room
PLANES = 500  # that are tried of them
MAX_POINTS = 5000  # that they are tried on
THICKNESS = 0.01  # of a plane on each side, in units of the cameras' distance
NEAR = 2.0  # the same units from the centre: what lies farther off is not looked at
LEAST_SHARE = 0.1  # of the points near by that a plane must hold
# Of the points in three times its thickness: a slice of clutter holds a third of them
LEAST_CONTRAST = 0.6
LEAST_WIDTH = 0.15  # the same units: standard deviation along its shorter side
REFINEMENTS = 5


def ground_normal(
    points: Float[Tensor, "M 3"], up: Float[Tensor, "3"], *, seed: int = 0
) -> Float[Tensor, "3"] | None:
    """The direction that is up by the plane that holds most points, of those that are near level.

    Args:
        points: The scene's, about its centre, in units of the cameras' distance.
        up: The direction that the cameras take for up.
        seed: Of the triples of points that planes are tried through (RANSAC).

    Returns:
        The plane's normal; None if none is clear.
    """
    near = points[points.norm(dim=1) < NEAR]
    near = near[:: max(1, len(near) // MAX_POINTS)]
    normals, offsets = _level_planes(near, up, torch.Generator().manual_seed(seed))
    if not len(normals):
        return None
    held = (near @ normals.T - offsets).abs() < THICKNESS  # [M, planes]
    best = int(held.sum(dim=0).argmax())
    return _refined(near, held[:, best], up)


def _level_planes(
    points: Float[Tensor, "M 3"], up: Float[Tensor, "3"], generator: torch.Generator
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, " P"]]:
    """Normals, up, and offsets along them, of planes through three points each."""
    if len(points) < 3:
        return points[:0], points[:0, 0]
    triples = torch.randint(len(points), (TRIPLES, 3), generator=generator)
    one, two, three = points[triples].unbind(dim=1)
    normals = torch.nn.functional.normalize(torch.linalg.cross(two - one, three - one), dim=1)
    normals = normals * (normals @ up).sign()[:, None]
    level = _are_level(normals, up).nonzero()[:PLANES, 0]
    return normals[level], (one[level] * normals[level]).sum(dim=1)


def _are_level(normals: Float[Tensor, "P 3"], up: Float[Tensor, "3"]) -> Bool[Tensor, " P"]:
    return normals @ up > torch.deg2rad(torch.tensor(MAX_TILT)).cos()


def _refined(
    points: Float[Tensor, "M 3"], held: Bool[Tensor, " M"], up: Float[Tensor, "3"]
) -> Float[Tensor, "3"] | None:
    """The normal of the plane through the points that it holds, fitted again and again."""
    for _ in range(REFINEMENTS):
        _, _, distances = _fitted(points, held)
        held = distances < THICKNESS
        if held.sum() < 3:
            return None
    normal, widths, distances = _fitted(points, held)
    clear = held.sum() >= LEAST_CONTRAST * (distances < 3 * THICKNESS).sum()
    large = widths[1] >= LEAST_WIDTH and held.double().mean() >= LEAST_SHARE
    normal = normal * (normal @ up).sign()
    return normal if clear and large and _are_level(normal[None], up) else None


def _fitted(
    points: Float[Tensor, "M 3"], held: Bool[Tensor, " M"]
) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"], Float[Tensor, " M"]]:
    """Normal of the plane of some points, their deviations in its axes, distances of all to it."""
    centre = points[held].mean(dim=0)
    variances, axes = torch.linalg.eigh(torch.cov((points[held] - centre).T, correction=0))
    return axes[:, 0], variances.clamp(min=0).sqrt(), ((points - centre) @ axes[:, 0]).abs()
