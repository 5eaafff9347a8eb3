"""What label maps have left in doubt fill_gaps an object belongs to it."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from balls import SPLATS
from scenes import randn
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import MEMBER_FEWEST, inliers, pick

FIRST = torch.arange(200, 280)  # Gaussians of the ball 3; the table's come before
HOLE = FIRST[::10]


def with_identities(rows: Tensor, *classes: float) -> Splats:
    """The still life, some rows having these scores of background and the balls 3, 7 and 300."""
    assert SPLATS.identities is not None
    identities = SPLATS.identities.clone()
    identities[rows] = 0.0
    identities[rows, : len(classes)] = torch.tensor(classes)
    return replace(SPLATS, identities=identities)


@pytest.mark.parametrize(
    ("classes", "is_picked"),
    [
        ((0.5, 0.9, 0.9), True),  # likelier none of them than any
        ((0.0, 0.0, 1.0), False),  # another's
        ((1.0, 0.0, 0.0), False),  # background
    ],
)
def test_what_is_in_doubt_amid_an_object_is_picked(classes: tuple[float, ...], is_picked: bool):
    picked = pick(with_identities(HOLE, *classes), object_id=3)
    assert (picked[HOLE] == is_picked).all()
    assert not picked[: FIRST[0]].any() and not picked[FIRST[-1] + 1 :].any()


def test_far_points_are_dropped_and_the_object_stays():
    points = torch.cat([randn(500, 3), torch.tensor([[30.0, 0.0, 0.0], [0.0, -40.0, 5.0]])])
    keep = inliers(points)
    assert not keep[500:].any()
    assert keep[:500].float().mean() > 0.95  # 2 standard deviations of a normal law leave out 2%


@pytest.mark.parametrize("count", [0, 1, 2, MEMBER_FEWEST - 1])
def test_small_sets_are_kept_whole(count: int):
    assert inliers(randn(count, 3) ** 5).all()


def test_a_large_one_that_reaches_its_neighbours_stays_and_a_small_one_does_not():
    points = torch.cat([randn(500, 3), torch.tensor([[9.0, 0.0, 0.0], [0.0, -9.0, 0.0]])])
    reaches = torch.zeros(502)
    reaches[500] = 12
    assert inliers(points, reaches=reaches)[500:].tolist() == [True, False]
    assert torch.equal(inliers(points, reaches=torch.zeros(502)), inliers(points))
