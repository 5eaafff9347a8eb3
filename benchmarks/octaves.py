"""How much detail an object shows, by its size."""

from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.evaluation.statistics import LUMA

OCTAVES = 4  # details of 1, 2, 4 and 8 pixels
LEAST = 1e-6  # of a pixel's surroundings that is the object


def octaves(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]) -> list[float]:
    """The mean square of what each octave adds to an object's luminance, fine first.

    Args:
        image: Colours in 0..1.
        mask: The object; what lies around it does not count, nor does its contour.
    """
    inside = mask.cpu().numpy().astype(np.float32)
    grey = image.cpu().numpy() @ np.array(LUMA, np.float32)
    blurred = [grey, *(_blurred(grey, inside, 2.0**n) for n in range(OCTAVES))]
    bands = (fine - coarse for fine, coarse in pairwise(blurred))
    return [float((band[inside > 0] ** 2).mean()) for band in bands]


def _blurred(grey: np.ndarray, inside: np.ndarray, deviation: float) -> np.ndarray:
    """The mean of what is inside, weighted by a Gaussian."""
    weights = cv2.GaussianBlur(inside, (0, 0), deviation)
    return cv2.GaussianBlur(grey * inside, (0, 0), deviation) / np.maximum(weights, LEAST)
