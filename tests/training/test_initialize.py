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
