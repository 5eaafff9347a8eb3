from dataclasses import replace

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import is_in_image
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.training.initialize import (
    MIN_VIEWS,
    commonly_visible_points,
    first_splats,
    neighbor_distances,
)
from stylesplat.training.views import TrainingView


def begun(capture: Capture, *, cap: int = 1000, sh_degree: int = 3) -> Splats:
    generator = torch.Generator().manual_seed(0)
    return first_splats(capture, sh_degree=sh_degree, max_gaussians=cap, generator=generator)


@pytest.mark.parametrize("degree", range(4))
def test_one_round_faint_gaussian_per_point(capture: Capture, degree: int):
    assert capture.points is not None and capture.point_colors is not None
    splats = begun(capture, sh_degree=degree)
    assert torch.equal(splats.means, capture.points)
    colors = rgb_from_sh0(splats.sh0[:, 0])
    assert torch.allclose(colors, capture.point_colors / 255, atol=1e-6)
    assert splats.sh_degree == degree and not splats.shN.any()
    assert (splats.scales == splats.scales[:, :1]).all()
    assert torch.allclose(torch.sigmoid(splats.opacities), torch.tensor(0.1))
    assert torch.allclose(splats.quats.norm(dim=1), torch.tensor(1.0))


def test_of_too_many_points_some_are_taken(capture: Capture):
    assert capture.points is not None
    splats = begun(capture, cap=50)
    assert len(splats) == 50 == len(splats.means.unique(dim=0))
    assert (splats.means[:, None] == capture.points).all(-1).any(1).all()


def views_of(capture: Capture) -> list[TrainingView]:
    photos = [photo.float() / 255 for photo in capture.photos]
    return [
        TrainingView(camera, photo, None, None, None)
        for camera, photo in zip(capture.cameras, photos, strict=True)
    ]


def colors_of(capture: Capture, views: list[TrainingView]) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    options = {"sh_degree": 0, "max_gaussians": 1000, "generator": generator}
    return rgb_from_sh0(first_splats(capture, **options, views=views).sh0[:, 0])


@pytest.mark.parametrize("level", [0, 1, 255, None], ids=str)
def test_colours_that_no_photo_shows_are_those_of_the_photos(
    capture: Capture, said: list[str], level: int | None
):
    assert capture.points is not None
    colors = None if level is None else torch.full((len(capture.points), 3), level).byte()
    views = views_of(capture)
    for view in views:
        view.photo[:] = torch.tensor([0.8, 0.4, 0.2])
    for view in views[:3]:
        view.photo[:] = 0.5  # something hides the points in these
    visible = torch.stack([is_in_image(capture.points, view.camera) for view in views]).all(dim=0)
    found = colors_of(replace(capture, point_colors=colors), views)[visible]
    assert len(found) > 50
    assert torch.allclose(found, torch.tensor([0.8, 0.4, 0.2]), atol=1e-6)
    assert any("No photo shows" in line for line in said) == (level is not None)


def test_colours_that_photos_show_are_kept(capture: Capture, said: list[str]):
    assert capture.points is not None
    views, colors = views_of(capture), torch.full((len(capture.points), 3), 102).byte()
    for view in views:
        view.photo[:] = 0.9
    views[0].photo[:] = 0.45
    found = colors_of(replace(capture, point_colors=colors), views)
    visible = is_in_image(capture.points, views[0].camera)
    assert torch.allclose(found[visible], torch.tensor(0.4)) and visible.sum() > 50
    assert not said, "one photo is enough"


def test_transparent_pixels_show_no_colours(capture: Capture):
    assert capture.points is not None
    views = [
        view._replace(photo=torch.zeros(64, 72, 3), alpha=torch.zeros(64, 72, 1))
        for view in views_of(capture)
    ]
    views[0] = views[0]._replace(photo=torch.full((64, 72, 3), 0.7), alpha=torch.ones(64, 72, 1))
    found = colors_of(replace(capture, point_colors=None), views)
    visible = is_in_image(capture.points, views[0].camera)
    assert torch.allclose(found[visible], torch.tensor(0.7)) and visible.sum() > 50


@pytest.mark.parametrize("points", [None, torch.zeros(0, 3), torch.zeros(2, 3)])
def test_without_points_random_ones_are_taken_and_a_line_says_so(
    capture: Capture, said: list[str], points
):
    bare = replace(capture, points=points, point_colors=None)
    splats = begun(bare, cap=500)
    assert len(splats) == 500 and len(said) == 1 and "random" in said[0]
    assert splats.means.norm(dim=1).max() < 9


def test_distances_to_neighbours_by_hand():
    # At 0, 1, 3, 7 and 15 on a line; three neighbours each.
    points = torch.tensor([0.0, 1, 3, 7, 15])[:, None] * torch.tensor([1.0, 0, 0])
    expected = [11 / 3, 9 / 3, 9 / 3, 17 / 3, 34 / 3]
    assert neighbor_distances(points).tolist() == pytest.approx(expected)
    for count in (1, 2, 3):  # fewer than that
        distances = neighbor_distances(points[:count])
        assert distances.shape == (count,) and (distances > 0).all()


def test_random_points_are_seen_by_several_cameras(cameras: Cameras):
    points = commonly_visible_points(cameras, 500, torch.Generator().manual_seed(0))
    assert len(points) == 500
    views = torch.stack([is_in_image(points, cameras[row]) for row in range(len(cameras))]).sum(
        dim=0
    )
    assert (views >= MIN_VIEWS * len(cameras)).all()


def test_cameras_that_share_no_view_are_refused(cameras: Cameras):
    away = replace(cameras, viewmats=cameras.viewmats.clone())
    away.viewmats[:, 2, 3] = -3
    with pytest.raises(StyleSplatError, match="outwards"):
        commonly_visible_points(away, 100, torch.Generator().manual_seed(0))
