"""Masks that are widened, narrowed, opened and closed by discs."""

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.photo_libraries import cv2


def disc(width: int) -> Bool[np.ndarray, "W W"]:
    """A filled circle; that of OpenCV (`MORPH_ELLIPSE`), to the pixel."""
    radius = width // 2
    steps = np.arange(width) - radius
    half = np.rint(np.sqrt(radius**2 - steps**2))
    return np.abs(steps) <= half[:, None]


def apply_disc(mask: Bool[Tensor, "H W"], operation: int, width: int) -> Bool[Tensor, "H W"]:
    """A mask after one of OpenCV's morphological operations with a disc, such as `MORPH_OPEN`.

    Faster than SciPy's, which painting uses, where discs are large and photos many.
    """
    kernel = disc(width).astype(np.uint8)
    return torch.from_numpy(cv2.morphologyEx(mask.numpy().astype(np.uint8), operation, kernel) > 0)
