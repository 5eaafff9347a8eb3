from dataclasses import replace

import pytest
import torch

from balls import BALL_RADIUS, BALLS, CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.selection.shapes import (
    alike,
    extent,
    grow,
    in_box,
    in_sphere,
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
    found = alike(SPLATS, begun, 6 * BALL_RADIUS)
    assert (found & RED).sum() > 0.9 * RED.sum() and (found & ~RED).sum() <= 0.05 * RED.sum()
    nearer = alike(SPLATS, begun, 0.8 * BALL_RADIUS)
    assert begun.sum() < nearer.sum() < found.sum() and not (nearer & ~found).any()


def test_nothing_there():
    zero, one = torch.zeros(3), torch.ones(3)
    with pytest.raises(StyleSplatError, match=r"is empty\. Give the lower corner first"):
        in_box(SPLATS, one, zero)
    with pytest.raises(StyleSplatError, match="No Gaussian lies in the box from 50,50,50"):
        in_box(SPLATS, one * 50, one * 51)
    with pytest.raises(StyleSplatError, match="The splat reaches from -1"):
        in_sphere(SPLATS, one * 50, 1.0)
    with pytest.raises(StyleSplatError, match=r"radius 0\. Give more than 0"):
        in_sphere(SPLATS, one, 0.0)
    with pytest.raises(StyleSplatError, match=r"is outside 0000\.jpg, which is 48x36"):
        surface_point(SPLATS, CAMERAS[0], (48.0, 3.0))
    with pytest.raises(StyleSplatError, match=r"Nothing solid shows at 0,0 .* Choose another"):
        surface_point(SPLATS, CAMERAS[0], (0.0, 0.0))


SOLID, GHOST = 3.0, -6.0  # logits of opacity


def lattice(opacity: float = SOLID) -> Splats:
    """Centres one apart along x, from 0 to 20."""
    count = 21
    means = torch.zeros(count, 3)
    means[:, 0] = torch.arange(count)
    return Splats(
        means=means,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), -1.0),
        opacities=torch.full((count,), opacity),
        sh0=torch.zeros(count, 1, 3),
        shN=torch.zeros(count, 0, 3),
    )


ROW = lattice()
MIDDLE = (ROW.means[:, 0] >= 5) & (ROW.means[:, 0] <= 15)
SIZE = extent(ROW.means[MIDDLE])


def places(picked: torch.Tensor) -> list[int]:
    return picked.nonzero()[:, 0].tolist()


def with_opacity(row: int, opacity: float) -> Splats:
    opacities = ROW.opacities.clone()
    opacities[row] = opacity
    return replace(ROW, opacities=opacities)


def test_as_far_as_the_share_says():
    for steps in (1, 2, 3):
        share = steps / SIZE
        assert places(grow(ROW, MIDDLE, share)) == [*range(5 - steps, 16 + steps)]
        assert places(shrink(ROW, MIDDLE, share)) == [*range(5 + steps, 16 - steps)]
        assert torch.equal(grow(ROW, MIDDLE, 0.99 * share), grow(ROW, MIDDLE, (steps - 0.5) / SIZE))


def test_what_hardly_shows_takes_nothing_away_and_nothing_in():
    assert places(shrink(with_opacity(4, GHOST), MIDDLE, 1 / SIZE)) == [*range(5, 15)]
    assert places(grow(with_opacity(15, GHOST), MIDDLE, 1.3 / SIZE)) == [*range(4, 16)]
    faint = lattice(GHOST)
    assert torch.equal(grow(faint, MIDDLE, 1 / SIZE), grow(ROW, MIDDLE, 1 / SIZE)), "all it has"


@pytest.mark.parametrize("share", [0.0, -0.1, 1.01, float("nan"), float("inf")])
def test_no_share(share: float):
    for change in (grow, shrink):
        with pytest.raises(StyleSplatError, match="Give more than 0 and at most 1"):
            change(ROW, MIDDLE, share)


def test_nothing_left():
    with pytest.raises(StyleSplatError, match="leaves nothing of the object"):
        shrink(ROW, MIDDLE, 1.0)
