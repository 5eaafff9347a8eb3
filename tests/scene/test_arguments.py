"""Boxes that were drawn in a picture."""

import math

import pytest

from stylesplat.scene.arguments import cut_to_picture

SIZE = (200, 100)


def test_inside_or_a_little_outside():
    assert cut_to_picture((1.5, 2.0, 3.0, 4.0), SIZE) == (1.5, 2.0, 3.0, 4.0)
    assert cut_to_picture((-10.0, -5.0, 210.0, 105.0), SIZE) == (0, 0, 200, 100)


@pytest.mark.parametrize(
    "box",
    [
        (-10.1, 0.0, 9.0, 9.0),
        (0.0, -5.1, 9.0, 9.0),
        (0.0, 0.0, 9.0, 105.1),
        (5.0, 5.0, 5.0, 9.0),
        (-9.0, 0.0, -1.0, 9.0),
        (math.nan, 0.0, 9.0, 9.0),
        (0.0, 0.0, math.inf, 9.0),
    ],
    ids=str,
)
def test_far_outside_or_empty(box: tuple[float, float, float, float]):
    assert cut_to_picture(box, SIZE) is None
