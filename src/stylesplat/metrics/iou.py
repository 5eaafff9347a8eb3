"""Intersection over union of masks."""

import math
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.scene.labels import BACKGROUND, Mask

BOUNDARY = 0.02  # of the image's diagonal: width of the band along a contour

LabelPairs = Iterable[tuple[Int[Tensor, "H W"], Int[Tensor, "H W"]]]
"""Predicted and given label map of each view."""


def mask_iou(one: Bool[Tensor, "..."], other: Bool[Tensor, "..."]) -> float:
    """IoU of two masks; 1 if both are empty."""
    either = int((one | other).sum())
    return int((one & other).sum()) / either if either else 1.0


def pairwise_iou(some: Sequence[Mask], others: Sequence[Mask]) -> Float[Tensor, "A B"]:
    """IoU of each mask of `some` with each of `others`, all of one size; 0 if both are empty."""
    if not some or not others:
        return torch.zeros(len(some), len(others))
    a, b = (torch.stack([*each]).flatten(1).float() for each in (some, others))
    both = a @ b.T
    return both / (a.sum(dim=1)[:, None] + b.sum(dim=1) - both).clamp(min=1)


def object_iou(pairs: LabelPairs, *, boundary: bool = False) -> dict[int, float]:
    """IoU of predicted and given label maps, by object.

    Args:
        pairs: Label maps; pixels are pooled over the views.
        boundary: Compare only the pixels within 2% of the image's diagonal from each one's
            contour (Boundary IoU, Cheng et al. 2021).

    Returns:
        A number for every id that occurs on either side, background left out.
    """
    intersections: dict[int, int] = {}
    unions: dict[int, int] = {}
    for predicted, given in pairs:
        ids = {*predicted.unique().tolist(), *given.unique().tolist()} - {BACKGROUND}
        for id in ids:
            here, there = predicted == id, given == id
            if boundary:
                here, there = _band(here), _band(there)
            intersections[id] = intersections.get(id, 0) + int((here & there).sum())
            unions[id] = unions.get(id, 0) + int((here | there).sum())
    return {id: intersections[id] / unions[id] for id in sorted(unions)}


def _band(mask: Mask) -> Mask:
    """The pixels of a mask that are near its contour; the image's border counts as outside."""
    width = max(1, round(BOUNDARY * math.hypot(*mask.shape)))
    padded = np.pad(mask.numpy().astype(np.uint8), 1)
    inner = cv2.erode(padded, np.ones((3, 3), np.uint8), iterations=width)[1:-1, 1:-1]
    return mask & ~torch.from_numpy(inner).bool()
