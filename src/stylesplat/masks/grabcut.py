"""One photo's object, cut out by GrabCut (Rother et al. 2004): no model, no weights."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import mask_iou
from stylesplat.masks.contours import ColorLevels, window_around
from stylesplat.photo_libraries import cv2
from stylesplat.scene.capture import Mask

ITERATIONS = 5  # of fitting colours and cutting
SEED = 0  # of OpenCV's clustering
SURE, UNSURE = 0.9, 0.1  # probabilities of the object beyond which colours do not matter
CONTOUR_ERROR = 0.006  # of the image's diagonal, by which a contour may be wrong
GRABCUT_SURROUNDINGS = 0.1  # of the diagonal: how far around an object its background is learned
MIN_PIXELS = 16  # with fewer, GrabCut cannot learn colours
GRABCUT_CHROMA = 2.5  # levels per unit of CIELAB's a and b, which stay within 50 in photos
EXTREMES = (1, 99)  # percentiles that inverse depth is stretched between
STROKE_WIDTH = 3  # pixels of a photo of `DRAWN_BOX_SIZE`
# GrabCut takes three channels, of lightness, a, b and inverse depth. Which tell an object from its
# background differs: fur before a cream wall by the last three, a mouse on its mat by the first. By
# the first set alone an object of a desk falls from an IoU of .58 to .20.
GRABCUT_CHANNELS = ((0, 1, 2), (1, 2, 3), (0, 1, 3), (0, 2, 3))

DrawnBox = tuple[float | int, float | int, float | int, float | int]
Channels = tuple[int, int, int]
"""Lightness and the two chroma axes of CIELAB, some 2.5 levels a unit."""
GrabCutImage = UInt8[np.ndarray, "H W 4"]
"""Color levels and inverse depth."""


@dataclass(frozen=True)
class Stroke:
    """A line that the user draws in a photo, over the object or over its background."""

    points: tuple[tuple[float | int, float | int], ...]
    """In the photo's pixels; one is a dot."""
    over_object: bool
    """False: over the background."""

    def pixels(self, size: tuple[int, int]) -> Mask:
        """What it covers of a photo of this width and height."""
        mask = np.zeros(size[::-1], np.uint8)
        line = np.array([*self.points, self.points[-1]]).astype(np.int32)  # a dot has two ends
        cv2.polylines(mask, [line], isClosed=False, color=1, thickness=STROKE_WIDTH)
        return torch.from_numpy(mask).bool()


def color_levels(photo: UInt8[Tensor, "H W 3"]) -> ColorLevels:
    """The colours of an sRGB photo, where distances are differences that are seen."""
    lab = cv2.cvtColor(photo.numpy().astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    lightness, chroma = 2.55 * lab[..., :1], 128 + GRABCUT_CHROMA * lab[..., 1:]
    return np.concatenate([lightness, chroma], axis=2).clip(0, 255).astype(np.uint8)


def grabcut_image(colors: ColorLevels, inverse_depth: Float[Tensor, "H W"]) -> GrabCutImage:
    """The channels that GrabCut sees; the unit of depth does not matter."""
    low, high = np.percentile(inverse_depth.numpy(), EXTREMES)
    near = 255 * (inverse_depth.numpy() - low) / max(high - low, 1e-12)
    return np.dstack([colors, near.clip(0, 255).astype(np.uint8)])


def refuse_box(box: DrawnBox, size: tuple[int, int], photo: str) -> None:
    """Refuse a box that leaves too few pixels of the photo inside or outside to learn from."""
    inside = pixels_inside(box, size)
    if min(inside.sum(), (~inside).sum()) < MIN_PIXELS:
        raise StyleSplatError(
            f"The box in {photo} is too small, or leaves too little of the photo outside to "
            "compare with. Draw it around the object, with some background left."
        )


def cut_box(
    image: GrabCutImage, box: DrawnBox, photo: str, marks: Sequence[tuple[Mask, Mask]] = ()
) -> tuple[Channels, Mask]:
    """Cut out what a box holds, what is around it being background.

    `marks` are pixels that belong to the object, and that do not: colours are learned from them.
    Farther away many things have the object's colours.

    Returns the mask, of the cuts by different channels the one that agrees with the others most,
    and its channels.
    """
    height, width, _ = image.shape
    inside = pixels_inside(box, (width, height))
    known = np.where(inside, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    meant = inside.copy()
    for own, others in marks:
        known[own.numpy()] = cv2.GC_FGD
        known[others.numpy()] = cv2.GC_BGD
        meant |= (own | others).numpy()
    foreground = np.isin(known, (cv2.GC_FGD, cv2.GC_PR_FGD))
    if min(foreground.sum(), (~foreground).sum()) < MIN_PIXELS:
        raise StyleSplatError(
            f"What is marked in {photo} leaves nothing of the object, or nothing of what is around "
            "it. Mark less."
        )
    window = window_around(meant, round(GRABCUT_SURROUNDINGS * float(np.hypot(height, width))))
    found = {
        each: torch.from_numpy(_grabcut(image[window][..., list(each)], known[window]))
        for each in GRABCUT_CHANNELS
    }
    cuts = {channels: cut for channels, cut in found.items() if cut.any()}
    if not cuts:
        raise StyleSplatError(
            f"What the box in {photo} holds looks like what is around it. Draw the box tighter, "
            "or choose another photo."
        )
    agreement = {each: sum(mask_iou(cut, o) for o in cuts.values()) for each, cut in cuts.items()}
    best = max(cuts, key=lambda channels: agreement[channels])
    mask = torch.zeros(height, width, dtype=torch.bool)
    mask[window] = cuts[best]
    return best, mask


def refine_mask(
    image: GrabCutImage,
    probability: Float[Tensor, "H W"],
    novelty: Float[Tensor, "H W"],
    channels: Channels,
) -> Mask:
    """The mask of an object from its probability in each pixel, with the contour moved to an edge.

    Colours decide where `novelty` is high: the share of surfaces that no known view shows.
    """
    likely = probability.numpy()
    mask = np.zeros(likely.shape, bool)
    if not (likely > 0.5).any():
        return torch.from_numpy(mask)
    diagonal = float(np.hypot(*likely.shape))
    near = _dilate(likely > UNSURE, CONTOUR_ERROR * diagonal)
    novel = novelty.numpy() > 0.5
    if novel.any():
        near |= novel & _dilate(near, GRABCUT_SURROUNDINGS * diagonal)
    window = window_around(near, round(GRABCUT_SURROUNDINGS * diagonal))
    likely, near = likely[window], near[window]
    inside = likely > 0.5
    marks = np.where(inside, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    marks[~_dilate(likely <= SURE, CONTOUR_ERROR * diagonal)] = cv2.GC_FGD
    marks[~near] = cv2.GC_BGD
    enough = min(inside.sum(), (~inside).sum()) >= MIN_PIXELS
    mask[window] = _grabcut(image[window][..., list(channels)], marks) if enough else inside
    return torch.from_numpy(mask)


def pixels_inside(box: DrawnBox, size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    inside = np.zeros(size[::-1], bool)
    inside[int(box[1]) : round(box[3]), int(box[0]) : round(box[2])] = True
    return inside


def _grabcut(image: UInt8[np.ndarray, "H W 3"], marks: UInt8[np.ndarray, "H W"]) -> np.ndarray:
    cv2.setRNGSeed(SEED)
    models, marks = np.zeros((2, 1, 65)), marks.copy()
    image = np.ascontiguousarray(image)
    unused = (0, 0, 1, 1)  # a rectangle; the marks are used instead
    cv2.grabCut(image, marks, unused, models[0], models[1], ITERATIONS, cv2.GC_INIT_WITH_MASK)
    return np.isin(marks, (cv2.GC_FGD, cv2.GC_PR_FGD))


def _dilate(mask: np.ndarray, radius: float) -> np.ndarray:
    side = 2 * max(1, round(radius)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return cv2.dilate(mask.astype(np.uint8), disc) > 0
