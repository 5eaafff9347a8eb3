"""Leakage and strength of edits whose numbers are known."""

import pytest
import torch

from stylesplat.metrics.masked_change import changed_share, farther_than, masked_psnr, strength

MASK = torch.zeros(20, 30, dtype=torch.bool)
MASK[5:15, 10:20] = True
BEFORE = torch.rand(20, 30, 3, generator=torch.Generator().manual_seed(0)) * 0.5


def test_what_did_not_change_is_zero():
    for mask in (MASK, ~MASK):
        assert changed_share(BEFORE, BEFORE, mask) == strength(BEFORE, BEFORE, mask) == 0
        assert masked_psnr(BEFORE, BEFORE, mask) == pytest.approx(120)


def test_an_edit_counts_on_its_side_of_the_mask_only():
    after = BEFORE.clone()
    after[5:15, 20:25] += 0.1  # 50 pixels, all outside
    assert changed_share(BEFORE, after, MASK) == 0 == strength(BEFORE, after, MASK)
    assert changed_share(BEFORE, after, ~MASK) == pytest.approx(50 / (600 - 100))
    error = 0.1**2 * 50 / 500
    expected = -10 * torch.tensor(error).log10().item()
    assert masked_psnr(BEFORE, after, ~MASK) == pytest.approx(expected, abs=1e-3)
    assert changed_share(BEFORE, BEFORE + 0.04, ~MASK) == 0, "it is not seen"


def test_strength_from_black_to_white_is_100():
    black = torch.zeros_like(BEFORE)
    assert strength(black, 1 - black, MASK) == pytest.approx(100, abs=0.05)  # rounded matrices


def test_no_pixels_changed_where_there_are_none():
    none = torch.zeros_like(MASK)
    assert changed_share(BEFORE, 1 - BEFORE, none) == 0 == strength(BEFORE, 1 - BEFORE, none)
    assert masked_psnr(BEFORE, 1 - BEFORE, none) == pytest.approx(120)


def test_farther_than_a_reach():
    far = farther_than(MASK, 2.0)
    assert not far[3:17, 10:20].any() and far[2, 10:20].all() and far[17, 10:20].all()
    assert far[3, 8], "a corner is 2.8 away"
    assert torch.equal(farther_than(MASK, 0.0), ~MASK)
    assert farther_than(torch.zeros_like(MASK), 3.0).all()
