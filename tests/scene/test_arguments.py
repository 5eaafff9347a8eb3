"""Boxes that were drawn in a picture."""

import math

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import check_box

SIZE = (200, 100)
OUTSIDE = [(-10.1, 0, 9, 9), (0, -5.1, 9, 9), (0, 0, 9, 105.1), (-9, 0, -1, 9)]
UNFIT = [(5, 5, 5, 9), (math.nan, 0, 9, 9), (0, 0, math.inf, 9)]


def test_inside_or_a_little_outside():
    assert check_box((1.5, 2.0, 3.0, 4.0), SIZE, "a.jpg") == (1.5, 2.0, 3.0, 4.0)
    assert check_box((-10.0, -5.0, 210.0, 105.0), SIZE, "a.jpg") == (0, 0, 200, 100)


@pytest.mark.parametrize("box", [*OUTSIDE, *UNFIT], ids=str)
def test_far_outside_or_empty(box: tuple[float | int, ...]):
    with pytest.raises(StyleSplatError, match=r"outside a\.jpg, which is 200x100"):
        check_box(box, SIZE, "a.jpg")
