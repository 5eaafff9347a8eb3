"""Contours of masks, moved to the edges of a disc before a wall."""

import pytest
import torch

from scenes import randn
from stylesplat.imaging.similarity import mask_iou
from stylesplat.masks.contours import ColorLevels, move_to_edges
from stylesplat.masks.grabcut import color_levels
from stylesplat.scene.capture import Mask

SIZE = 120


def disc(x: float, y: float, radius: float = 40) -> Mask:
    rows, columns = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    return (rows - y) ** 2 + (columns - x) ** 2 < radius**2


def photo(mask: Mask, contrast: float) -> ColorLevels:
    """A disc before a wall, whose light falls off to the right; with noise."""
    gray = 140 - 0.3 * torch.arange(SIZE) + contrast * mask
    image = gray[..., None] + 2 * randn(SIZE, SIZE, 3)
    return color_levels(image.clamp(0, 255).to(torch.uint8))


@pytest.mark.parametrize("wrong", [disc(61, 58), disc(60, 60, 37), disc(60, 60, 43)])
def test_a_contour_moves_to_the_edge(wrong: Mask):
    truth = disc(60, 60)
    moved = move_to_edges(photo(truth, 60), wrong)
    assert mask_iou(wrong, truth) < 0.95 < 0.98 < mask_iou(moved, truth)


def test_a_contour_without_an_edge_stays():
    mask = disc(60, 60)
    assert mask_iou(move_to_edges(photo(mask, 0), mask), mask) > 0.96


@pytest.mark.parametrize("mask", [torch.zeros(SIZE, SIZE), torch.ones(SIZE, SIZE)])
def test_masks_without_contours_stay(mask: torch.Tensor):
    assert torch.equal(move_to_edges(photo(disc(60, 60), 60), mask.bool()), mask.bool())


def test_a_leg_grows_to_its_end():
    leg = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    leg[20:70, 30:90], leg[70:100, 57:63] = True, True
    cut = leg.clone()
    cut[97:] = False
    moved = move_to_edges(photo(leg, 60), cut)
    assert (moved & leg)[97:].sum() > 0.9 * leg[97:].sum()
    assert mask_iou(moved, leg) > 0.98
