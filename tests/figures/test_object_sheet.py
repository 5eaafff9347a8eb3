from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, CLASSIFIER, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.figures.grid import CARD, CELL, MARGIN
from stylesplat.figures.sheets import GAP, SMALL, object_sheet
from stylesplat.scene.splats import Classifier

WIDTH = CELL + GAP + SMALL  # of a cell


def cut_out(sheet: torch.Tensor, column: int) -> torch.Tensor:
    left = MARGIN + column * (WIDTH + MARGIN)
    return sheet[MARGIN : MARGIN + CELL, left : left + CELL]


def small_ones(sheet: torch.Tensor, column: int) -> list[torch.Tensor]:
    left = MARGIN + column * (WIDTH + MARGIN) + CELL + GAP
    tops = (MARGIN, MARGIN + SMALL + GAP)
    return [sheet[top : top + SMALL, left : left + SMALL] for top in tops]


def test_each_cell_is_filled_by_its_object_alone():
    sheet = object_sheet(SPLATS, CAMERAS)
    for column, channel in enumerate((0, 1, 2)):  # the red, green and blue ball
        cell = cut_out(sheet, column).float()
        shown = (cell - torch.tensor(CARD)).abs().sum(dim=-1) > 60
        assert 0.5 < shown.float().mean() < 0.9  # a disc in its square covers 0.79
        assert (cell[shown].mean(dim=0).argmax()) == channel
        assert torch.equal(cell[0, 0], torch.tensor(CARD).float())


def test_two_other_sides_are_shown_small():
    sheet = object_sheet(SPLATS, CAMERAS)
    for column, channel in enumerate((0, 1, 2)):
        first, second = small_ones(sheet, column)
        for cell in (first.float(), second.float()):
            shown = (cell - torch.tensor(CARD)).abs().sum(dim=-1) > 60
            assert 0.4 < shown.float().mean() < 0.9
            assert cell[shown].mean(dim=0).argmax() == channel
        assert not torch.equal(first, second)
    one = object_sheet(SPLATS, CAMERAS[:1])
    assert all((cell == torch.tensor(CARD)).all() for cell in small_ones(one, 0))


def test_no_close_up_of_what_does_not_show():
    nothing = torch.zeros(len(SPLATS), dtype=torch.bool)
    nothing[0] = True
    splats = replace(SPLATS, opacities=SPLATS.opacities.index_fill(0, torch.tensor([0]), -9.0))
    with pytest.raises(StyleSplatError, match=r"does not show in any of 8 views"):
        close_up(splats, CAMERAS, nothing)
    with pytest.raises(StyleSplatError, match=r"does not show in 0003\.jpg"):
        close_up(splats, CAMERAS[3], nothing)


def test_strays_do_not_shrink_the_object():
    means, scales = SPLATS.means.clone(), SPLATS.scales.clone()
    noise = torch.randn(25, 3, generator=torch.Generator().manual_seed(0))
    means[200:225] = torch.tensor([-0.7, 0.0, 1.4]) + 0.01 * noise  # part of the red ball
    scales[200:225] -= 1
    splats = replace(SPLATS, means=means, scales=scales)
    cell = cut_out(object_sheet(splats, CAMERAS), 0).float()
    red = (cell[..., 0] > 150) & (cell[..., 1] < 100)
    assert red.float().mean() > 0.4  # framing the strays too leaves less than 0.2


def test_a_whole_view_wins_over_a_larger_one_that_cuts_the_object():
    whole = CAMERAS[0]
    Ks = 2 * whole.Ks
    Ks[:, 0, 2] = 22.0  # the red ball's middle is on the left border
    Ks[:, 2, 2] = 1.0
    both = replace(
        CAMERAS[:2],
        viewmats=whole.viewmats.repeat(2, 1, 1),
        Ks=torch.cat([Ks, whole.Ks]),
    )
    chosen, expected = (cut_out(object_sheet(SPLATS, c), 0) for c in (both, whole))
    assert torch.equal(chosen, expected)


def test_names_are_drawn():
    plain = object_sheet(SPLATS, CAMERAS)
    named = object_sheet(SPLATS, CAMERAS, names={7: "apple"})
    changed = (plain != named).any(dim=-1).nonzero()
    assert len(changed)
    assert changed[:, 0].min() >= MARGIN + CELL  # in the caption
    assert changed[:, 1].min() >= 2 * MARGIN + WIDTH  # of the second cell
    assert changed[:, 1].max() < 2 * (MARGIN + WIDTH)


def test_an_object_without_gaussians_has_an_empty_cell():
    weight = torch.cat([CLASSIFIER.weight, torch.zeros(1, 16)])
    bias = torch.cat([CLASSIFIER.bias, torch.tensor([-50.0])])
    more = Classifier(weight, bias, ids=(*CLASSIFIER.ids, 999))
    sheet = object_sheet(replace(SPLATS, classifier=more), CAMERAS)
    assert (cut_out(sheet, 3) == torch.tensor(CARD)).all()


def test_only_background():
    alone = Classifier(CLASSIFIER.weight[:1], CLASSIFIER.bias[:1], ids=(0,))
    with pytest.raises(StyleSplatError, match="no objects"):
        object_sheet(replace(SPLATS, classifier=alone), CAMERAS)
