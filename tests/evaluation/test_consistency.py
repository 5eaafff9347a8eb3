import math
from dataclasses import replace

import pytest
import torch

from balls import viewmat_from
from scenes import cloud, joined, rand, randn
from stylesplat.evaluation.changes import (
    OCCLUDED,
    ObjectRender,
    view_consistency,
    warped_difference,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats, sh0_from_rgb

DEPTH, FOCAL, SIDE = 4.0, 32.0, 24
COUNT = 1500


def camera(viewmat: torch.Tensor) -> Cameras:
    K = torch.tensor([[FOCAL, 0.0, SIDE / 2], [0.0, FOCAL, SIDE / 2], [0.0, 0.0, 1.0]])
    return Cameras(viewmat[None], K[None], torch.tensor([[SIDE, SIDE]]), ("a",))


def wall(viewmat: torch.Tensor, colors: torch.Tensor) -> ObjectRender:
    """A plane that fills the image, at one depth."""
    surface = torch.tensor([1.0, DEPTH]).expand(SIDE, SIDE, 2).clone()
    return ObjectRender(camera(viewmat), colors, surface)


def shifted(pixels: float) -> torch.Tensor:
    """A camera moved to the right, in which a wall appears that many pixels to the left."""
    viewmat = torch.eye(4)
    viewmat[0, 3] = -pixels * DEPTH / FOCAL
    return viewmat


@pytest.fixture(scope="module")
def ball() -> Splats:
    """A matte ball of radius 0.5 whose colour changes smoothly along it."""
    index = torch.arange(COUNT) + 0.5
    z, turn = 1 - 2 * index / COUNT, index * math.pi * (1 + 5**0.5)
    ring = (1 - z * z).sqrt()
    means = 0.5 * torch.stack([ring * turn.cos(), ring * turn.sin(), z], dim=1)
    colors = sh0_from_rgb(0.5 + 0.6 * means)[:, None]
    return replace(cloud(means, 0.02, opacity=4.0), sh0=colors, shN=torch.zeros(COUNT, 3, 3))


@pytest.fixture(scope="module")
def arc() -> Cameras:
    """Ten views 5 degrees apart, 64x64 pixels."""
    angles = [math.radians(5 * i) for i in range(10)]
    viewmats = torch.stack(
        [viewmat_from((-3 * math.sin(a), -3 * math.cos(a), 0.5)) for a in angles]
    )
    K = torch.tensor([[120.0, 0.0, 32.0], [0.0, 120.0, 32.0], [0.0, 0.0, 1.0]]).repeat(10, 1, 1)
    return Cameras(viewmats, K, torch.full((10, 2), 64), tuple(f"{i}" for i in range(10)))


def everything(splats: Splats) -> torch.Tensor:
    return torch.ones(len(splats), dtype=torch.bool)


def test_a_shifted_wall_matches_itself():
    pixels = 3
    colors = rand(SIDE, SIDE, 6)
    moved = wall(shifted(pixels), colors.roll(-pixels, dims=1))
    found = warped_difference(wall(torch.eye(4), colors), moved)
    assert found.shape == (SIDE * (SIDE - 3), 6)  # three columns have left the image
    assert found.abs().max() < 1e-5  # whole pixels: nothing is interpolated, but for rounding


def test_what_is_not_the_same_surface_is_left_out():
    colors = rand(SIDE, SIDE, 6)
    a, b = (wall(torch.eye(4), colors) for _ in range(2))
    a.surface[0] *= 0.4  # a row that the object hardly covers
    a.surface[1, :, 1] *= 1 + 1.5 * OCCLUDED
    a.surface[2, :, 1] *= 1 - 1.5 * OCCLUDED
    a.surface[3, :, 1] *= 1 + 0.5 * OCCLUDED
    assert len(warped_difference(a, b)) == SIDE * (SIDE - 3)
    b.surface[4] *= 0.4
    assert len(warped_difference(a, b)) == SIDE * (SIDE - 4)


def test_a_matte_ball_is_consistent_and_a_glossy_one_is_not(ball: Splats, arc: Cameras):
    shN = torch.zeros_like(ball.shN)
    shN[:, 2] = 1.0  # brighter from one side, along x
    found = view_consistency(ball, replace(ball, shN=shN), arc, everything(ball))
    assert found["short_range_rmse_base"] < 0.01  # 2.5 of 255: errors of depth
    assert found["long_range_rmse_base"] < 0.02
    # A step of 5 degrees near the y axis changes x by sin(5), the colour by SH_C1 times that.
    assert found["short_range_rmse"] == pytest.approx(0.49 * math.sin(math.radians(5)), rel=0.2)
    assert found["long_range_rmse"] > 4 * found["short_range_rmse"]


def test_the_rest_of_the_scene_does_not_count(ball: Splats, arc: Cameras):
    """A second ball stands beside the first and glitters."""
    beside = replace(ball, means=ball.means * 0.1 + torch.tensor([0.0, 0.0, -0.8]))
    glitter = replace(beside, shN=10 * randn(*ball.shN.shape))
    base, styled = joined(ball, beside), joined(ball, glitter)
    mine = torch.arange(len(base)) < COUNT
    found = view_consistency(base, styled, arc[:5], mine)
    assert found["short_range_rmse"] == pytest.approx(found["short_range_rmse_base"], rel=1e-4)
    found = view_consistency(base, styled, arc[:5], ~mine)
    assert found["short_range_rmse"] > 5 * found["short_range_rmse_base"]


def test_too_few_views(ball: Splats, arc: Cameras):
    assert view_consistency(ball, ball, arc[:1], everything(ball)) == {}
    assert view_consistency(ball, ball, arc, ~everything(ball)) == {}
