"""A shifted mask has the IoU that geometry says, and so has its border."""

import pytest
import torch

from stylesplat.metrics.iou import mask_iou, object_iou

SIDE, SIZE = 60, 100
WIDTH = 3  # 2 % of the diagonal of 141 pixels


def square(shift: int) -> torch.Tensor:
    labels = torch.zeros(SIZE, SIZE, dtype=torch.int64)
    labels[20 : 20 + SIDE, 20 + shift : 20 + shift + SIDE] = 1
    return labels


@pytest.mark.parametrize("shift", [0, 1, 2, 10, 20])
def test_iou_of_a_shifted_square(shift: int):
    expected = (SIDE - shift) / (SIDE + shift)
    assert object_iou([(square(shift), square(0))])[1] == pytest.approx(expected)
    assert mask_iou(square(shift) == 1, square(0) == 1) == pytest.approx(expected)


@pytest.mark.parametrize("shift", [0, 1, 2, 3, 10])
def test_boundary_iou_of_a_shifted_square(shift: int):
    """The bands are frames 3 pixels wide.

    Their upper and lower bars share what the squares share. The left and right bars, 3 wide and 54
    high between the others, share columns while the shift is less than 3.
    """
    band = SIDE**2 - (SIDE - 2 * WIDTH) ** 2
    bars = 2 * WIDTH * (SIDE - shift)
    sides = 2 * max(0, WIDTH - shift) * (SIDE - 2 * WIDTH)
    shared = bars + sides
    found = object_iou([(square(shift), square(0))], boundary=True)[1]
    assert found == pytest.approx(shared / (2 * band - shared))
