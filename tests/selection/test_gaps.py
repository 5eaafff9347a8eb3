"""What label maps have left in doubt amid an object belongs to it."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from balls import SHARPNESS, SPLATS
from stylesplat.scene.splats import Splats
from stylesplat.selection.gaps import amid
from stylesplat.selection.pick import pick

FIRST = torch.arange(200, 280)  # Gaussians of the ball 3; the table's come before
HOLE = FIRST[::10]


def with_identities(rows: Tensor, *classes: float) -> Splats:
    """The still life, some rows having these scores of background and the balls 3, 7 and 300."""
    assert SPLATS.identities is not None
    identities = SPLATS.identities.clone()
    identities[rows] = 0.0
    identities[rows, : len(classes)] = torch.tensor(classes)
    return replace(SPLATS, identities=identities)


def test_what_is_in_doubt_amid_an_object_is_picked():
    doubtful = with_identities(HOLE, 0.5, 0.9, 0.9)  # likelier none of them than any
    picked = pick(doubtful, object_id=3)
    assert picked[HOLE].all()
    assert not picked[: FIRST[0]].any() and not picked[FIRST[-1] + 1 :].any()


@pytest.mark.parametrize(
    "classes", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)], ids=["another's", "background"]
)
def test_what_is_surely_something_else_is_not(classes: tuple[float, ...]):
    sure = with_identities(HOLE, *classes)
    assert not pick(sure, object_id=3)[HOLE].any()


def test_what_is_in_doubt_elsewhere_is_not():
    rows = torch.arange(0, 200, 10)  # of the table
    assert not pick(with_identities(rows, 0.5, 0.9, 0.9), object_id=3)[rows].any()


def test_two_objects_never_share_a_gap():
    assert SPLATS.identities is not None
    noise = torch.randn(SPLATS.identities.shape, generator=torch.Generator().manual_seed(0))
    splats = replace(SPLATS, identities=SPLATS.identities + 5 / SHARPNESS * noise)
    picks = torch.stack([pick(splats, object_id=id) for id in (3, 7, 300)])
    assert int(picks.sum(dim=0).max()) == 1


def all_of(rows: Tensor) -> Tensor:
    return torch.ones_like(rows, dtype=torch.bool)


def test_hardly_visible_gaussians_vouch_for_nothing():
    faint = replace(SPLATS, opacities=SPLATS.opacities.index_fill(0, FIRST, -6.0))
    picked = torch.zeros(len(SPLATS), dtype=torch.bool).index_fill(0, FIRST[1:], True)
    assert not amid(faint, picked, all_of).any()
    assert not amid(SPLATS, torch.zeros_like(picked), all_of).any(), "amid nothing"
