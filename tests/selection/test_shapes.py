import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from balls import BALL_RADIUS, BALLS, CAMERAS, SPLATS
from scenes import cloud
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import pick
from stylesplat.selection.shapes import (
    grow,
    grow_by_similarity,
    in_box,
    in_sphere,
    robust_diameter,
    shrink,
    surface_point,
)

RED = pick(SPLATS, object_id=3, remove_outliers=False)
CENTRE = torch.tensor(BALLS[3][0])


def test_a_box_and_a_sphere_around_a_ball_hold_it_alone():
    reach = 1.01 * BALL_RADIUS
    above = torch.tensor([0.0, 0.0, 0.01])  # the table lies at 0
    assert torch.equal(in_sphere(SPLATS, CENTRE + above, reach + 0.01) & RED, RED)
    box = in_box(SPLATS, CENTRE - reach, CENTRE + reach)
    assert torch.equal(box & RED, RED)
    others = pick(SPLATS, object_id=[7, 300], remove_outliers=False)
    assert not (box & others).any()


def test_surface_point_lies_on_what_shows():
    camera = CAMERAS[0]
    viewmat, K = camera.viewmats[0], camera.Ks[0]
    pixel = K @ (viewmat[:3, :3] @ CENTRE + viewmat[:3, 3])
    x, y = (pixel[:2] / pixel[2]).tolist()
    assert rasterize(SPLATS, camera)[1][0, int(y), int(x), 0] > 0.5
    point = surface_point(SPLATS, camera, (x, y))
    assert (point - CENTRE).norm() < 1.6 * BALL_RADIUS
    ahead = viewmat[:3, :3] @ point + viewmat[:3, 3]
    seen = K @ ahead
    assert (seen[:2] / seen[2] - torch.tensor([int(x) + 0.5, int(y) + 0.5])).norm() < 1e-3


def test_a_selection_spreads_over_what_looks_alike():
    begun = RED & in_sphere(SPLATS, CENTRE + torch.tensor([0, 0, BALL_RADIUS]), 0.5 * BALL_RADIUS)
    found = grow_by_similarity(SPLATS, begun, 6 * BALL_RADIUS)
    assert (found & RED).sum() > 0.9 * RED.sum() and (found & ~RED).sum() <= 0.05 * RED.sum()
    nearer = grow_by_similarity(SPLATS, begun, 0.8 * BALL_RADIUS)
    assert begun.sum() < nearer.sum() < found.sum() and not (nearer & ~found).any()


SOLID, GHOST = 3.0, -6.0  # logits of opacity


def lattice(opacity: float = SOLID) -> Splats:
    """Centres one apart along x, from 0 to 20."""
    means = torch.arange(21)[:, None] * torch.tensor([1, 0, 0])
    return cloud(means, math.exp(-1), opacity)


ROW = lattice()
MIDDLE = (ROW.means[:, 0] >= 5) & (ROW.means[:, 0] <= 15)
SIZE = robust_diameter(ROW.means[MIDDLE])


def places(picked: torch.Tensor) -> list[int]:
    return picked.nonzero()[:, 0].tolist()


def test_as_far_as_the_share_says():
    for steps in (1, 2, 3):
        share = steps / SIZE
        assert places(grow(ROW, MIDDLE, share)) == [*range(5 - steps, 16 + steps)]
        assert places(shrink(ROW, MIDDLE, share)) == [*range(5 + steps, 16 - steps)]
        assert torch.equal(grow(ROW, MIDDLE, 0.99 * share), grow(ROW, MIDDLE, (steps - 0.5) / SIZE))


def test_what_hardly_shows_takes_nothing_away_and_nothing_in():
    def with_ghost(row: int) -> Splats:
        return replace(ROW, opacities=ROW.opacities.index_fill(0, torch.tensor([row]), GHOST))

    assert places(shrink(with_ghost(4), MIDDLE, 1 / SIZE)) == [*range(5, 15)]
    assert places(grow(with_ghost(15), MIDDLE, 1.3 / SIZE)) == [*range(4, 16)]
    faint = lattice(GHOST)
    assert torch.equal(grow(faint, MIDDLE, 1 / SIZE), grow(ROW, MIDDLE, 1 / SIZE)), "all it has"


ZERO, ONE = torch.zeros(3), torch.ones(3)


@pytest.mark.parametrize(
    ("shape", "arguments", "fact"),
    [
        (in_box, (SPLATS, ONE, ZERO), r"is empty\. Give the lower corner first"),
        (in_box, (SPLATS, ONE * 50, ONE * 51), "No Gaussian lies in the box from 50,50,50"),
        (in_sphere, (SPLATS, ONE * 50, 1.0), "The splat reaches from -1"),
        (in_sphere, (SPLATS, ONE, 0.0), r"radius 0\. Give more than 0"),
        (surface_point, (SPLATS, CAMERAS[0], (48.0, 3.0)), r"is outside 0000\.jpg, which is 48x36"),
        (surface_point, (SPLATS, CAMERAS[0], (0.0, 0.0)), r"Nothing solid shows at 0,0 .* another"),
        *(
            (change, (ROW, MIDDLE, share), "Give more than 0 and at most 1")
            for change in (grow, shrink)
            for share in (0.0, -0.1, 1.01, math.nan, math.inf)
        ),
        (shrink, (ROW, MIDDLE, 1.0), "leaves nothing of the object"),
    ],
)
def test_nothing_there(shape: Callable, arguments: tuple, fact: str):
    with pytest.raises(StyleSplatError, match=fact):
        shape(*arguments)
