from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.frames import SAME, Frame, known_frames, seen_from
from stylesplat.scene.splats import Splats


def moved(splats: Splats, frame: Frame) -> Splats:
    """Round Gaussians of one colour in another frame."""
    shift = torch.zeros(3) if frame.shift is None else frame.shift
    return replace(
        splats,
        means=frame.scale * splats.means @ frame.rotation.T + shift,
        scales=splats.scales.mean(dim=1, keepdim=True).expand(-1, 3)
        + torch.tensor(frame.scale).log(),
        shN=splats.shN[:, :0],
    )


@pytest.mark.parametrize("name", known_frames(CAMERAS))
def test_cameras_move_along_with_the_world(name: str):
    frame = known_frames(CAMERAS)[name]
    still = rasterize(moved(SPLATS, SAME), CAMERAS[1])[0]
    there = rasterize(moved(SPLATS, frame), seen_from(CAMERAS, frame)[1])[0]
    torch.testing.assert_close(there, still, atol=2e-3, rtol=0)  # 0.3 pixels' blur stays


def test_nerfstudio_frame_is_centred_upright_and_small():
    turned = Frame(known_frames(CAMERAS)["nerfstudio-axes"].rotation, 7.0, torch.ones(3))
    cameras = seen_from(CAMERAS, turned)  # any frame before leads to the same
    there = seen_from(cameras, known_frames(cameras)["nerfstudio"])
    assert there.positions.mean(dim=0).abs().max() < 1e-5
    assert there.positions.abs().max() == pytest.approx(1, abs=1e-5)
    up = -there.viewmats[:, 1, :3].mean(dim=0)
    torch.testing.assert_close(up / up.norm(), torch.tensor([0.0, 0.0, 1.0]), atol=1e-5, rtol=0)


def test_upside_down():
    over = Frame(torch.diag(torch.tensor([1.0, -1.0, -1.0])))
    cameras = seen_from(CAMERAS, over)
    up = -seen_from(cameras, known_frames(cameras)["nerfstudio"]).viewmats[:, 1, :3].mean(dim=0)
    assert up[2] > 0


def test_frames_lead_back():
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).double()
    points = torch.rand(9, 3).double()
    for frame in (Frame(turn, 1.7, torch.tensor([1.0, -2.0, 0.5]).double()), Frame(turn)):
        torch.testing.assert_close(frame.inverse().place(frame.place(points)), points)
