from dataclasses import replace

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.scene.splats import Splats
from stylesplat.selection.margins import extent, grow, shrink

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


def test_it_is_taken_in_all_the_same():
    assert places(grow(with_opacity(4, GHOST), MIDDLE, 1 / SIZE)) == [*range(4, 17)]


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_units_do_not_matter(scale: float):
    splats = replace(ROW, means=scale * ROW.means - 7 * scale)
    for change in (grow, shrink):
        assert torch.equal(change(splats, MIDDLE, 0.15), change(ROW, MIDDLE, 0.15))


def test_strays_do_not_make_an_object_large():
    points = torch.randn(300, 3, generator=torch.Generator().manual_seed(0))
    strays = torch.cat([points, 1000 * points[:15]])
    assert extent(strays) < 1.2 * extent(points)
    assert 2 < extent(points) < 6  # about 5 deviations hold 90 % of a normal law


def test_the_whole_scene():
    everything = torch.ones(len(ROW.means), dtype=torch.bool)
    assert grow(ROW, everything, 0.5).all()
    assert shrink(ROW, everything, 0.5).all(), "nothing is close to it"


@pytest.mark.parametrize("share", [0.0, -0.1, 1.01, float("nan"), float("inf")])
def test_no_share(share: float):
    for change in (grow, shrink):
        with pytest.raises(StyleSplatError, match="Give more than 0 and at most 1"):
            change(ROW, MIDDLE, share)


def test_nothing_left():
    with pytest.raises(StyleSplatError, match="leaves nothing of the object"):
        shrink(ROW, MIDDLE, 1.0)
