from dataclasses import replace

import pytest
import torch

from scenes import random_splats, two_cameras
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.frames import Frame, seen_from
from stylesplat.scene.turned import moved


def rotation(*angles: float) -> torch.Tensor:
    """About x, y and z in turn, in radians."""
    turn = torch.eye(3, dtype=torch.float64)
    for axis, angle in enumerate(angles):
        generator = torch.zeros(3, 3, dtype=torch.float64)
        generator[(axis + 2) % 3, (axis + 1) % 3], generator[(axis + 1) % 3, (axis + 2) % 3] = 1, -1
        turn = torch.linalg.matrix_exp(angle * generator) @ turn
    return turn


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("angles", [(0.4, -1.2, 2.5), (3.0, 0, 0), (0, 3.1, 0), (0, 0, 2.9)])
def test_cameras_that_move_along_see_the_same(degree: int, angles: tuple[float, float, float]):
    splats = replace(random_splats(sh_degree=degree), identities=None)
    frame = Frame(rotation(*angles), 1.5, torch.tensor([1.0, -2.0, 0.5]))
    cameras = two_cameras()
    before, _, _ = rasterize(splats, cameras[0], backend="reference")
    after, _, _ = rasterize(moved(splats, frame), seen_from(cameras, frame)[0], backend="reference")
    # float32 of positions a few units from the origin; eps2d is in pixels, so scale changes nothing
    assert (after - before).abs().max() < 1e-3
    assert before.std() > 0.05


@pytest.mark.parametrize("signs", [(1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
def test_half_turns_are_exact_and_taken_back_by_another(signs: tuple[int, int, int]):
    splats = random_splats()
    frame = Frame(torch.diag(torch.tensor(signs).double()))
    turned = moved(splats, frame)
    assert torch.equal(turned.shN.abs(), splats.shN.abs())
    assert not torch.equal(turned.shN, splats.shN)
    again = moved(turned, frame)
    for name in ("means", "scales", "opacities", "sh0", "shN"):
        assert torch.equal(getattr(again, name), getattr(splats, name))
    assert torch.equal(again.quats, -splats.quats)  # a whole turn


def test_no_move_keeps_every_bit():
    splats = random_splats()
    same = moved(splats, Frame(torch.eye(3)))
    assert all(torch.equal(t, same.tensors()[name]) for name, t in splats.tensors().items())
