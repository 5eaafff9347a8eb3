"""Boxes that were drawn in a picture."""

from stylesplat.options import check_box

SIZE = (200, 100)


def test_inside_or_a_little_outside():
    assert check_box((1.5, 2.0, 3.0, 4.0), SIZE, "a.jpg") == (1.5, 2.0, 3.0, 4.0)
    assert check_box((-10.0, -5.0, 210.0, 105.0), SIZE, "a.jpg") == (0, 0, 200, 100)
