"""How sharp pictures are, measured so that motion blur shows and exposure does not."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

SIDE = 640  # pixels of the longer side at which pictures are compared
FLOOR = 1.0  # grey levels squared: what rounding adds to the variance
AROUND = 10  # neighbours that tell what is usual
# Of what is usual. Real photos (fox, desk) have 0.40 or more; blur of 1 % of the width 0.17 or less
BLURRED = 0.2
SOFT = 0.5  # of what is usual: too little where there are others, and when nothing matches
# Of most photos, for none to be of use. Fox and desk have 0.015 and 0.007, and 0.0005 when blurred
# by a Gaussian of 0.3 % of their width
ALL_BLURRED = 0.0007
EDGES = tuple(
    np.array(kernel, np.float32)
    for kernel in (
        [[-1, 2, -1]],
        [[-1], [2], [-1]],
        [[-1, 0, 0], [0, 2, 0], [0, 0, -1]],
        [[0, 0, -1], [0, 2, 0], [-1, 0, 0]],
    )
)


def sharpness(grey: UInt8[np.ndarray, "h w"]) -> float:
    """Energy of the Laplacian along the direction that has least of it, by the picture's variance.

    Motion blurs one direction only, which the Laplacian as a whole hardly shows where edges run
    along it. The variance makes photos of little and of much light comparable.

    Args:
        grey: A picture of `SIDE` pixels at its longer side.
    """
    pixels = grey.astype(np.float32)
    energies = [cv2.filter2D(pixels, cv2.CV_32F, kernel).var() for kernel in EDGES]
    return float(min(energies) / (pixels.var() + FLOOR))


def relative(values: Sequence[float]) -> list[float]:
    """Each by the median of those around it, itself not among them: 1 is typical."""
    return [_by_neighbours(values, index) for index in range(len(values))]


def _by_neighbours(values: Sequence[float], index: int) -> float:
    first = max(0, min(index - AROUND // 2, len(values) - AROUND - 1))
    around = [*values[first:index], *values[index + 1 : first + AROUND + 1]]
    usual = float(np.median(around)) if around else values[index]
    return values[index] / usual if usual else 1.0
