from dataclasses import replace

import pytest
import torch

from balls import CAMERAS
from scenes import random_splats, two_cameras
from stylesplat.rendering.render import rasterize
from stylesplat.scene.frames import FRAME_SAME, Frame, known_frames, move_cameras, move_splats


def test_nerfstudio_frame_is_centred_upright_and_small():
    turned = Frame(known_frames(CAMERAS)["nerfstudio-axes"].rotation, 7.0, torch.ones(3))
    cameras = move_cameras(CAMERAS, turned)  # any frame before leads to the same
    there = move_cameras(cameras, known_frames(cameras)["nerfstudio"])
    assert there.positions.mean(dim=0).abs().max() < 1e-5
    assert there.positions.abs().max() == pytest.approx(1, abs=1e-5)
    up = -there.viewmats[:, 1, :3].mean(dim=0)
    torch.testing.assert_close(up / up.norm(), torch.tensor([0.0, 0.0, 1.0]), atol=1e-5, rtol=0)
    cameras = move_cameras(CAMERAS, Frame(torch.diag(torch.tensor([1.0, -1.0, -1.0]))))
    up = -move_cameras(cameras, known_frames(cameras)["nerfstudio"]).viewmats[:, 1, :3].mean(dim=0)
    assert up[2] > 0, "also upside down"


def rotation(*angles: float) -> torch.Tensor:
    """About x, y and z in turn, in radians."""
    turn = torch.eye(3, dtype=torch.float64)
    for axis, angle in enumerate(angles):
        generator = torch.zeros(3, 3, dtype=torch.float64)
        generator[(axis + 2) % 3, (axis + 1) % 3], generator[(axis + 1) % 3, (axis + 2) % 3] = 1, -1
        turn = torch.linalg.matrix_exp(angle * generator) @ turn
    return turn


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("angles", [(0.4, -1.2, 2.5), (3.0, 0, 0), (0, 3.1, 0)])
def test_cameras_that_move_along_see_the_same(degree: int, angles: tuple[float, float, float]):
    splats = replace(random_splats(sh_degree=degree), identities=None)
    frame = Frame(rotation(*angles), 1.5, torch.tensor([1.0, -2.0, 0.5]).double())
    cameras = two_cameras()
    back = move_cameras(move_cameras(cameras, frame), frame.inverse())
    torch.testing.assert_close(back.viewmats, cameras.viewmats, atol=1e-5, rtol=0)
    before, _, _ = rasterize(splats, cameras[0], backend="reference")
    after, _, _ = rasterize(
        move_splats(splats, frame), move_cameras(cameras, frame)[0], backend="reference"
    )
    # float32 of positions a few units from the origin; eps2d is in pixels, so scale changes nothing
    assert (after - before).abs().max() < 1e-3
    assert before.std() > 0.05


@pytest.mark.parametrize("signs", [(1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
def test_half_turns_are_exact_and_taken_back_by_another(signs: tuple[int, int, int]):
    splats = random_splats()
    frame = Frame(torch.diag(torch.tensor(signs).double()))
    turned = move_splats(splats, frame)
    assert torch.equal(turned.shN.abs(), splats.shN.abs())
    assert not torch.equal(turned.shN, splats.shN)
    again = move_splats(turned, frame)
    for name in ("means", "scales", "opacities", "sh0", "shN"):
        assert torch.equal(getattr(again, name), getattr(splats, name))
    assert torch.equal(again.quats, -splats.quats)  # a whole turn
    same = move_splats(splats, FRAME_SAME)
    assert all(torch.equal(t, same.tensors()[name]) for name, t in splats.tensors().items())
