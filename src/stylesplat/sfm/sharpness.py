"""How sharp pictures are, measured so that motion blur shows and exposure does not."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

SIDE = 640  # pixels of the longer side at which pictures are compared
COARSE = 8  # times smaller, a picture is as sharp as it would be without blur
FLOOR = 1.0  # grey levels squared: what rounding adds to the energy of a picture without texture
AROUND = 10  # neighbours that tell what is usual
# Of what is usual. Real photos (fox, desk) have 0.44 or more; blur of 1 % of the width 0.17 or less
BLURRED = 0.2
# Of most photos, for none to be of use. Fox and desk have 0.06 and 0.02, and 0.005 or less when
# blurred over 1 % of their width
ALL_BLURRED = 0.005
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
    """Energy of the Laplacian along the direction that has least of it, by that of coarse detail.

    Motion blurs one direction only, which the Laplacian as a whole hardly shows where edges run
    along it. Coarse detail makes photos of little and of much contrast comparable.

    Args:
        grey: A picture of `SIDE` pixels at its longer side.
    """
    pixels = grey.astype(np.float32)
    height, width = grey.shape
    small = (max(3, width // COARSE), max(3, height // COARSE))
    coarse = cv2.resize(pixels, small, interpolation=cv2.INTER_AREA)
    return float(_energies(pixels).min() / (_energies(coarse).mean() + FLOOR))


def relative(values: Sequence[float]) -> list[float]:
    """Each by the median of those around it, itself not among them: 1 is typical."""
    return [_by_neighbours(values, index) for index in range(len(values))]


def _by_neighbours(values: Sequence[float], index: int) -> float:
    first = max(0, min(index - AROUND // 2, len(values) - AROUND - 1))
    around = [*values[first:index], *values[index + 1 : first + AROUND + 1]]
    usual = float(np.median(around)) if around else values[index]
    return values[index] / usual if usual else 1.0


def _energies(pixels: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "4"]:
    return np.array([cv2.filter2D(pixels, cv2.CV_32F, kernel).var() for kernel in EDGES])
