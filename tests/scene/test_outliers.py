"""What lies far from all others is left out; what only stands far away is kept."""

from dataclasses import replace

import pytest
import torch

from scenes import rand, randn, shell
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import find_outliers, scene_extent
from stylesplat.scene.virtual_cameras import cameras_of, centred_K

UP = torch.tensor([0.0, 1.0, 0.0])
POINTS = randn(500, 3)


def cameras_at(positions: torch.Tensor, focal: float = 60.0) -> Cameras:
    """Cameras that look at the origin."""
    viewmats = look_at(positions, torch.zeros(3), UP)
    return cameras_of(viewmats, centred_K(focal, (64, 48)), (64, 48), names="{}.png")


def ring(count: int, radius: float = 4.0) -> torch.Tensor:
    angles = torch.arange(count) * 2 * torch.pi / count
    return radius * torch.stack([angles.cos(), 0 * angles, angles.sin()], dim=1)


FAR = torch.tensor([[-500.0, 300.0, 800.0]])


@pytest.mark.parametrize("factor", [0.3, 1.0, 100.0, 1e5])
@pytest.mark.parametrize("count", [3, 12])
@pytest.mark.parametrize("points", [POINTS, None])
def test_a_camera_far_from_all_else_is_an_outlier(factor: float, count: int, points):
    positions = torch.cat([ring(count), factor * FAR])
    if points is None and factor < 1:
        return
    near, _, found = find_outliers(cameras_at(positions), points)
    assert near.tolist() == [True] * count + [False]
    assert [*found.photos] == [f"{count}.png"] and f"{count}.png" in str(found)


def test_several_of_both_kinds():
    positions = torch.cat([FAR, ring(12), -9 * FAR])
    points = torch.cat([POINTS, 1e4 * randn(20, 3, seed=1)])
    near, near_points, found = find_outliers(cameras_at(positions), points)
    assert near.tolist() == [False] + [True] * 12 + [False]
    assert near_points is not None and near_points.tolist() == [True] * 500 + [False] * 20
    assert found.points == 20 and "20 points" in str(found)


WALK = torch.stack([torch.arange(40) * 5.0, 0 * torch.arange(40), 0 * torch.arange(40) + 3], dim=1)
LEGITIMATE = {
    "an orbit with a sky": (ring(12), torch.cat([POINTS, shell(200, 350.0)])),
    "three photos, two of one place": (
        torch.tensor([[0, 0, 4.0], [0, 0.01, 4], [4, 0, 0]]),
        POINTS,
    ),
    "two photos": (torch.cat([ring(1), FAR]), POINTS),
    "a walk": (WALK, WALK[:, None].add(rand(40, 20, 3)).flatten(0, 1)),
    "forward-facing": (torch.tensor([0, 0, -20.0]) + 0.05 * randn(20, 3), POINTS),
    "a turn on the spot": (torch.tensor([0, 0, -9.0]) + 1e-3 * randn(20, 3), POINTS),
    "close-ups, and a view of all the land around them": (
        torch.cat([ring(30, 3.0), torch.tensor([[0.0, 300.0, 9.0]])]),
        torch.cat([POINTS, 200 * (rand(400, 3) - 0.5) * torch.tensor([1.0, 0, 1.0])]),
    ),
}


@pytest.mark.parametrize("name", LEGITIMATE)
def test_no_photo_of_a_sound_capture_is_an_outlier(name: str):
    positions, points = LEGITIMATE[name]
    near, near_points, found = find_outliers(cameras_at(positions), points)
    assert near.all() and near_points is not None and near_points.all() and not found


def test_a_photo_through_a_long_lens_is_no_outlier():
    cameras = cameras_at(torch.cat([ring(12), 0.3 * FAR]))
    cameras.Ks[-1, :2, :2] *= 60
    assert find_outliers(cameras, POINTS)[0].all()


def test_the_extent_is_the_radius_without_the_few_that_are_far():
    expected = pytest.approx(1.1 * 4)
    assert scene_extent(cameras_at(ring(12))) == expected
    assert scene_extent(cameras_at(torch.cat([ring(12), 0.1 * FAR]))) == pytest.approx(4.4, rel=0.1)
    two = torch.tensor([[0.0, 0, 1], [3, 0, 1]])
    assert scene_extent(cameras_at(two)) == pytest.approx(1.1 * 1.5), "of few cameras all count"
    assert scene_extent(cameras_at(two[:1])) == 1


def test_a_capture_without_outliers(said: list[str]):
    cameras, points = cameras_at(torch.cat([ring(4), FAR])), torch.cat([POINTS, 1e5 + POINTS[:3]])
    photos = [torch.full((48, 64, 3), row).byte() for row in range(5)]
    whole = Capture(cameras, photos, points=points, point_colors=torch.zeros(503, 3).byte())
    capture = whole.without_outliers()
    assert capture.cameras.names == cameras.names[:4] and int(capture.photos[3][0, 0, 0]) == 3
    assert capture.points is not None and capture.point_colors is not None
    assert torch.equal(capture.points, POINTS) and len(capture.point_colors) == 500
    assert len(said) == 1 and "4.png" in said[0] and "3 points" in said[0]
    assert capture.without_outliers() is capture and len(said) == 1
    plain = replace(capture, cameras=cameras_at(ring(4)))
    assert plain.without_outliers() is plain
