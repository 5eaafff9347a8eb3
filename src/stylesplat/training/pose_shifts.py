"""Where photos were taken, a little beside where the capture says: learned turns and shifts.

Both are of the world, so that their means over the photos, which are held at nothing, are those of
the world frame.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.training.initialize import scene_extent
from stylesplat.training.state import State


def moved(cameras: Cameras, shifts: Float[Tensor, "C 6"], unit: float) -> Cameras:
    """Cameras turned about their centres and shifted; differentiable by the shifts.

    Args:
        cameras: As they are given.
        shifts: Axis times angle in the world, in radians, and shift in units.
        unit: Of length.
    """
    viewmats = cameras.viewmats.to(shifts)
    turns = torch.linalg.matrix_exp(_cross_products(shifts[:, :3]))  # [C, 3, 3]
    rotations = viewmats[:, :3, :3] @ turns.mT
    positions = cameras.positions.to(shifts) + unit * shifts[:, 3:]
    upper = torch.cat([rotations, -rotations @ positions[:, :, None]], dim=2)
    return replace(cameras, viewmats=torch.cat([upper, viewmats[:, 3:]], dim=1))


def refined(capture: Capture, state: State, rows: Sequence[int]) -> Capture:
    """The capture with its cameras where training has found them; as given if it did not look.

    Args:
        capture: As it is given.
        state: After training.
        rows: Photos that were trained on; the others' cameras stay.
    """
    shifts = state.params.get("pose_shifts")
    if shifts is None:
        return capture
    unit, shifts = scene_extent(capture.cameras), shifts.detach().cpu()

    def found(cameras: Cameras) -> Cameras:
        viewmats = cameras.viewmats.clone()
        viewmats[list(rows)] = moved(cameras[rows], shifts.to(viewmats), unit).viewmats
        return replace(cameras, viewmats=viewmats)

    full = None if capture.full is None else found(capture.full)
    return replace(capture, cameras=found(capture.cameras), full=full)


def _cross_products(axes: Float[Tensor, "C 3"]) -> Float[Tensor, "C 3 3"]:
    """The matrices that multiply as the cross product with each axis does."""
    basis = torch.eye(3).to(axes)
    return torch.linalg.cross(axes[:, None].expand(-1, 3, -1), basis.expand(len(axes), 3, 3)).mT
