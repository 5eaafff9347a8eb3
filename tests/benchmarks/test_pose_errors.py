import math
from dataclasses import replace

import pytest
import torch
from pose_errors import pose_errors, similarity

from stylesplat.demo.still_life import dome_cameras
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.frames import Frame, seen_from
from stylesplat.scene.poses import look_at

ELSEWHERE = Frame(
    rotation_matrices(torch.tensor([[0.3, -0.8, 0.2, 0.5]]).double())[0],
    scale=0.02,
    shift=torch.tensor([40.0, -3.0, 7.0]).double(),
)


def given_cameras() -> Cameras:
    """Whose rotations are such in float64, too."""
    cameras = dome_cameras(20, 64, 48)
    target, up = torch.tensor([[0.0, 0.0, 0.4], [0.0, 0.0, 1.0]]).double()
    return replace(cameras, viewmats=look_at(cameras.positions.double(), target, up))


def turned(viewmat: torch.Tensor, degrees: float) -> torch.Tensor:
    """A camera that looks elsewhere from the same place."""
    half = math.radians(degrees) / 2
    quaternion = torch.tensor([[math.cos(half), 0, math.sin(half), 0]], dtype=torch.float64)
    return torch.block_diag(rotation_matrices(quaternion)[0], torch.ones(1, 1)) @ viewmat


def test_another_world_frame_is_no_error():
    given = given_cameras()
    errors = pose_errors(seen_from(given, ELSEWHERE), given)
    assert errors.degrees.max() < 1e-5 and errors.shares.max() < 1e-7  # of float64's square root
    assert errors.frame.scale == pytest.approx(1 / ELSEWHERE.scale)


def test_errors_are_what_was_done_to_each_camera():
    given = given_cameras()
    viewmats = given.viewmats.clone()
    viewmats[3] = turned(viewmats[3], 2.5)
    viewmats[7, 0, 3] += 0.3  # to the side, by so much in the given world
    errors = pose_errors(seen_from(replace(given, viewmats=viewmats), ELSEWHERE), given)
    centred = given.positions - given.positions.mean(dim=0)
    spread = centred.square().sum(dim=1).mean().sqrt()
    assert errors.degrees[3].item() == pytest.approx(2.5)
    assert errors.shares[7].item() == pytest.approx(0.3 / spread.item())
    others = [row for row in range(20) if row not in (3, 7)]
    # the camera that stands elsewhere has not pulled the others along
    assert errors.degrees[others].max() < 1e-5 and errors.shares[others].max() < 1e-7


def test_a_mirrored_set_is_not_turned_into_its_image():
    points = torch.randn(9, 3, generator=torch.Generator().manual_seed(0)).double()
    frame = similarity(points, points * torch.tensor([1.0, 1.0, -1.0]).double())
    assert torch.linalg.det(frame.rotation).item() == pytest.approx(1)
