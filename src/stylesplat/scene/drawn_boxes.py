"""Boxes that were drawn in a picture."""

from collections.abc import Sequence

OVERSHOOT = 0.05  # of a side, that a box may reach beyond: `sfm` cuts photos as it undistorts them


def cut_to_picture(
    box: Sequence[float | int], size: tuple[int, int]
) -> tuple[float, float, float, float] | None:
    """The part of a box inside its picture; None if it reaches far outside, or is empty.

    Args:
        box: Left, upper, right and lower edge, in pixels.
        size: The picture's width and height.
    """
    (x0, y0, x1, y1), (width, height) = map(float, box), map(float, size)
    over, under = OVERSHOOT * width, OVERSHOOT * height
    if not (-over <= x0 and x1 <= width + over and -under <= y0 and y1 <= height + under):
        return None
    x0, y0, x1, y1 = max(x0, 0.0), max(y0, 0.0), min(x1, width), min(y1, height)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None
