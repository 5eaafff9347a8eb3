"""IoU of masks and of their contours, for which geometry says what it is."""

import pytest
import torch

from stylesplat.imaging.similarity import mask_iou, object_iou, pairwise_iou

SIDE, SIZE = 60, 100
WIDTH = 3  # 2 % of the diagonal of 141 pixels


def square(shift: int) -> torch.Tensor:
    labels = torch.zeros(SIZE, SIZE, dtype=torch.int64)
    labels[20 : 20 + SIDE, 20 + shift : 20 + shift + SIDE] = 1
    return labels


@pytest.mark.parametrize("shift", [0, 1, 2, 10])
def test_a_shifted_square(shift: int):
    """The bands along contours are frames 3 pixels wide.

    Their upper and lower bars share what the squares share. The left and right bars, 3 wide and 54
    high between the others, share columns while the shift is less than 3.
    """
    pair, expected = (square(shift), square(0)), (SIDE - shift) / (SIDE + shift)
    assert object_iou([pair])[1] == pytest.approx(expected)
    assert mask_iou(pair[0] == 1, pair[1] == 1) == pytest.approx(expected)
    masks = [each == 1 for each in pair]
    assert pairwise_iou(masks, masks)[0, 1] == pytest.approx(expected)
    band = SIDE**2 - (SIDE - 2 * WIDTH) ** 2
    shared = 2 * WIDTH * (SIDE - shift) + 2 * max(0, WIDTH - shift) * (SIDE - 2 * WIDTH)
    found = object_iou([pair], boundary=True)[1]
    assert found == pytest.approx(shared / (2 * band - shared))


def test_a_hole_has_a_contour():
    hole = square(0)
    hole[40:60, 40:60] = 0
    bands, hole_band = SIDE**2 - 54**2, 26**2 - 20**2  # the same three pixels, around the hole
    found = object_iou([(hole, square(0))], boundary=True)[1]
    assert found == pytest.approx(bands / (bands + hole_band))


def test_objects_are_pooled_over_views_and_background_is_none():
    given, predicted = torch.tensor([[1, 1, 2, 0]]), torch.tensor([[1, 0, 2, 0]])
    assert object_iou([(predicted, given)]) == {1: 1 / 2, 2: 1}
    assert object_iou([(predicted, given), (0 * given, given)]) == {1: 1 / 4, 2: 1 / 2}
    assert object_iou([(0 * given, 0 * given)]) == {}
    assert mask_iou(given == 9, given == 9) == 1 and pairwise_iou([], []).shape == (0, 0)
