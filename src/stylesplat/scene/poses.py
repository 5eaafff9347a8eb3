"""Where cameras stand and look, and what they look at."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras

UP_RIDGE = 0.01  # weight of the cameras' mean up against 'no camera is rolled'
PARALLEL = 1e-3  # mean squared sine between view axes (about 2 degrees) below which they never meet
ROTATION_TOLERANCE = 1e-3  # of an entry of R R^T; files round poses to six digits or so
REMEDY = "To render, choose --views all; to train, give sparse points."


def are_rigid(
    viewmats: Float[Tensor, "C 4 4"], tolerance: float = ROTATION_TOLERANCE
) -> Bool[Tensor, " C"]:
    """Which poses are finite, and a rotation and a shift only."""
    rotations = viewmats[:, :3, :3]
    error = rotations @ rotations.mT - torch.eye(3).to(viewmats)
    turned = (error.abs() < tolerance).flatten(1).all(dim=1)
    return turned & (torch.linalg.det(rotations) > 0) & viewmats.isfinite().flatten(1).all(dim=1)


def focus_point(cameras: Cameras) -> Float[Tensor, "3"]:
    """The point nearest to all view axes, in the least-squares sense.

    Raises:
        StyleSplatError: If the axes are parallel, or most cameras look away from the point.
    """
    directions = cameras.viewmats[:, 2, :3].double()
    positions = cameras.positions.double()
    projectors = torch.eye(3).double() - directions[:, :, None] * directions[:, None]  # [C, 3, 3]
    matrix = projectors.mean(dim=0)
    if torch.linalg.eigvalsh(matrix)[0] < PARALLEL:
        raise StyleSplatError(
            f"The cameras all look the same way, so they have no point in common. {REMEDY}"
        )
    focus = torch.linalg.solve(
        matrix, torch.einsum("cij,cj->i", projectors, positions) / len(cameras)
    )
    if ((focus - positions) * directions).sum(dim=-1).median() <= 0:
        raise StyleSplatError(
            f"The cameras look outwards, so they have no point in common. {REMEDY}"
        )
    return focus


def up_vector(cameras: Cameras) -> Float[Tensor, "3"]:
    """The direction that is up: level with every camera's x axis, on the side of their tops.

    Photos are hardly ever rolled, but often look down, so the x axes tell more than the tops;
    where they leave it open, as when all cameras face one way, the mean of the tops decides.
    """
    rights, tops = cameras.viewmats[:, 0, :3].double(), -cameras.viewmats[:, 1, :3].double()
    matrix = rights.T @ rights / len(cameras) + UP_RIDGE * torch.eye(3).double()
    return torch.nn.functional.normalize(torch.linalg.solve(matrix, tops.mean(dim=0)), dim=0)


def look_at(
    positions: Float[Tensor, "M 3"], focus: Float[Tensor, "3"], up: Float[Tensor, "3"]
) -> Float[Tensor, "M 4 4"]:
    """World-to-camera matrices (OpenCV axes) of cameras that look at a point."""
    forward = torch.nn.functional.normalize(focus - positions, dim=-1)
    right = torch.nn.functional.normalize(
        torch.linalg.cross(forward, up.expand_as(forward)), dim=-1
    )
    rotations = torch.stack([right, torch.linalg.cross(forward, right), forward], dim=1)
    viewmats = torch.eye(4).to(positions).repeat(len(positions), 1, 1)
    viewmats[:, :3, :3] = rotations
    viewmats[:, :3, 3] = -torch.einsum("mij,mj->mi", rotations, positions)
    return viewmats


def median_lens(cameras: Cameras) -> tuple[Float[Tensor, "3 3"], tuple[int, int]]:
    """Intrinsics and even size of the camera whose view is median in width, centred."""
    widths = cameras.sizes[:, 0] / cameras.Ks[:, 0, 0].cpu()
    row = int(widths.argsort()[len(cameras) // 2])
    width, height = (size - size % 2 for size in cameras.sizes[row].tolist())
    K = cameras.Ks[row].clone()
    K[0, 2], K[1, 2] = width / 2, height / 2
    return K, (width, height)
