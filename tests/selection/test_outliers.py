import pytest
import torch

from stylesplat.selection.outliers import MIN_POINTS, inliers


def ball(count: int) -> torch.Tensor:
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(0))


def test_far_points_are_dropped_and_the_object_stays():
    points = torch.cat([ball(500), torch.tensor([[30.0, 0.0, 0.0], [0.0, -40.0, 5.0]])])
    keep = inliers(points)
    assert not keep[500:].any()
    assert keep[:500].float().mean() > 0.95  # 2 standard deviations of a normal law leave out 2%


def test_one_extreme_point_does_not_hide_a_nearer_one():
    points = torch.cat([ball(500), torch.tensor([[1e6, 0.0, 0.0], [25.0, 0.0, 0.0]])])
    assert inliers(points)[500:].tolist() == [False, False]


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_units_do_not_matter(scale: float):
    points = torch.cat([ball(300), 20 * ball(10)])
    assert torch.equal(inliers(points), inliers(scale * points + 7))


def test_order_does_not_matter():
    points = torch.cat([ball(300), 20 * ball(10)])
    order = torch.randperm(310, generator=torch.Generator().manual_seed(1))
    assert torch.equal(inliers(points)[order], inliers(points[order]))


@pytest.mark.parametrize("count", [0, 1, 2, MIN_POINTS - 1])
def test_small_sets_are_kept_whole(count: int):
    assert inliers(ball(count) ** 5).all()


def test_coincident_points_are_kept():
    assert inliers(torch.ones(100, 3)).all()


def test_a_large_one_that_reaches_its_neighbours_stays_and_a_small_one_does_not():
    points = torch.cat([ball(500), torch.tensor([[9.0, 0.0, 0.0], [0.0, -9.0, 0.0]])])
    reaches = torch.zeros(502)
    reaches[500] = 12
    assert inliers(points, reaches=reaches)[500:].tolist() == [True, False]
    assert torch.equal(inliers(points, reaches=torch.zeros(502)), inliers(points))
