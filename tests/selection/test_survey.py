from dataclasses import replace

import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS
from stylesplat.figures.sheets import object_sheet
from stylesplat.selection import survey as surveying
from stylesplat.selection.own_shares import OwnShares, own_shares
from stylesplat.selection.pick import each_object
from stylesplat.selection.soft_picks import looked_at
from stylesplat.selection.survey import survey


def test_small_scenes_are_not_surveyed():
    assert survey(SPLATS, looked_at(CAMERAS)) is None


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> None:
    """The balls' scene counts as large."""
    monkeypatch.setattr(surveying, "LARGE", 0)


@pytest.mark.usefixtures("large")
def test_shares_are_those_in_the_whole_scene():
    found = OwnShares(SPLATS, CAMERAS)
    for _, picked in each_object(SPLATS, [*BALLS]):
        assert torch.equal(found.of(picked), own_shares(SPLATS, picked, CAMERAS))
    nobody = torch.zeros(len(SPLATS), dtype=torch.bool)
    assert not found.of(nobody).any()


@pytest.mark.usefixtures("large")
def test_what_is_not_near_and_does_not_show_is_left_out():
    means = SPLATS.means.clone()
    means[:50, 2] += 1e4  # of the table
    scene = replace(SPLATS, means=means)
    seen = survey(scene, looked_at(CAMERAS))
    assert seen is not None
    for _, picked in each_object(scene, [*BALLS]):
        rows = seen.around(picked)
        assert torch.isin(picked.nonzero()[:, 0], rows).all() and (rows.diff() > 0).all()
        assert (rows >= 50).all()


def test_the_sheet_is_the_same(monkeypatch: pytest.MonkeyPatch):
    whole = object_sheet(SPLATS, CAMERAS)
    monkeypatch.setattr(surveying, "LARGE", 0)
    apart = object_sheet(SPLATS, CAMERAS).int() - whole.int()
    assert apart.abs().max() <= 1, "but for rounding"
