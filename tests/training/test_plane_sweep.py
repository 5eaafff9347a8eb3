"""Points on surfaces that photos show together."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import project
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.training.initialize import with_swept_points
from stylesplat.training.plane_sweep import sweep_planes
from stylesplat.training.views import TrainingView

WALL, DISTANCE = 0.1, 4.0  # deviation of the spots on a wall, and how far it is from the cameras
PROBE = torch.tensor([-1.0, -1.0, 3.0]) + 2 * torch.rand(
    600, 3, generator=torch.Generator().manual_seed(1)
)


@pytest.fixture(scope="module")
def cameras() -> Cameras:
    """Five in a row, which look at a wall's middle."""
    places = torch.zeros(5, 3)
    places[:, 0] = torch.linspace(-0.8, 0.8, 5)
    middle, up = torch.tensor([0.0, 0.0, DISTANCE]), torch.tensor([0.0, -1.0, 0.0])
    viewmats = look_at(places, middle, up)
    K = torch.tensor([[80.0, 0.0, 40.0], [0.0, 80.0, 30.0], [0.0, 0.0, 1.0]])
    names = tuple(f"{row}.png" for row in range(5))
    return Cameras(viewmats, K.repeat(5, 1, 1), torch.tensor([[80, 60]]).repeat(5, 1), names)


@pytest.fixture(scope="module")
def pictures(cameras: Cameras) -> Tensor:
    """Photos of a wall with spots of all colours."""
    generator = torch.Generator().manual_seed(0)
    count = 800
    places = 8 * torch.rand(count, 3, generator=generator) - 4
    places[:, 2] = DISTANCE
    wall = Splats(
        means=places,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), WALL).log(),
        opacities=torch.full((count,), 3.0),
        sh0=sh0_from_rgb(torch.rand(count, 3, generator=generator))[:, None],
        shN=torch.zeros(count, 0, 3),
    )
    return torch.stack([rasterize(wall, camera)[0][0].clamp(0, 1) for camera in cameras])


@pytest.fixture
def view_of(cameras: Cameras, pictures: Tensor) -> Callable[[int], TrainingView]:
    return lambda row: TrainingView(cameras[row], pictures[row], None, None, None)


def test_points_lie_on_the_wall_in_its_colours(
    cameras: Cameras, pictures: Tensor, view_of: Callable[[int], TrainingView]
):
    points, colors = sweep_planes(cameras, view_of, PROBE)
    assert len(points) > 5000
    off = (points[:, 2] - DISTANCE).abs()
    assert off.median() < 0.06 and off.quantile(0.95) < 0.4
    middle = (points[:, :2] @ torch.tensor([[20.0, 0.0], [0.0, 20.0]])).round().long()
    inside = (middle.abs() < 30).all(dim=1)
    x, y = (middle[inside] + torch.tensor([40, 30])).unbind(dim=1)
    error = (pictures[2][y.clamp(max=59), x.clamp(max=79)] - colors[inside]).abs().mean()
    assert error < 0.1, "a pixel beside has .2 and more"


@pytest.mark.parametrize("how", ["masked", "transparent"])
def test_what_is_not_to_be_learned_from_gives_no_points(
    cameras: Cameras, pictures: Tensor, how: str
):
    left = torch.zeros(60, 80, dtype=torch.bool)
    left[:, :40] = True

    def view_of(row: int) -> TrainingView:
        view = TrainingView(cameras[row], pictures[row], None, None, None)
        alpha = left[..., None].float()
        return view._replace(valid=left) if how == "masked" else view._replace(alpha=alpha)

    points, _ = sweep_planes(cameras, view_of, PROBE)
    assert len(points) > 250
    shown = [project(points, camera)[0][:, 0] < 40 for camera in cameras]
    assert torch.stack(shown).any(dim=0).all()


def test_photos_that_share_nothing_give_none(
    cameras: Cameras, view_of: Callable[[int], TrainingView]
):
    one = cameras[0]
    points, colors = sweep_planes(one, view_of, PROBE)
    assert points.shape == colors.shape == (0, 3)
    same = one + one + one  # which tell no depths
    assert len(sweep_planes(same, view_of, PROBE)[0]) == 0
    away = replace(cameras, viewmats=torch.diag(torch.tensor([1.0, -1, -1, 1])) @ cameras.viewmats)
    assert len(sweep_planes(away, view_of, PROBE)[0]) == 0


def test_training_without_sparse_points_starts_from_the_wall(
    cameras: Cameras, pictures: Tensor, view_of: Callable[[int], TrainingView], said: list[str]
):
    photos = [*(255 * pictures).round().to(torch.uint8)]
    capture = Capture(cameras, photos)
    rows = range(len(cameras))

    def begun(of: Capture) -> Capture:
        generator = torch.Generator().manual_seed(0)
        return with_swept_points(of, rows, lambda row, _: view_of(row), generator)

    found = begun(capture)
    assert found.points is not None and found.point_colors is not None
    assert len(found.points) == len(found.point_colors) > 2500
    assert (found.points[:, 2] - DISTANCE).abs().median() < 0.06
    assert said == [
        f"The capture has no sparse points: training starts from {len(found.points):,} on the "
        "surfaces that its photos show together."
    ]
    sparse = replace(capture, points=PROBE, point_colors=None)
    assert begun(sparse) is sparse
    plain = [torch.full_like(photos[0], 128)] * len(photos)
    flat = TrainingView(cameras[0], torch.full((60, 80, 3), 0.5), None, None, None)
    empty = replace(capture, photos=plain)
    generator = torch.Generator().manual_seed(0)
    nothing = with_swept_points(
        empty, rows, lambda row, _: flat._replace(camera=cameras[row]), generator
    )
    assert nothing is empty, "random points are taken"
