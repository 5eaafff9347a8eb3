"""One photo's object, cut out by GrabCut (Rother et al. 2004): no model, no weights."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.metrics.iou import mask_iou
from stylesplat.scene.labels import Mask

ROUNDS = 5
SEED = 0  # of OpenCV's clustering
SURE, UNSURE = 0.9, 0.1  # probabilities beyond which a pixel needs no colours to tell
PLAY = 0.006  # of the image's diagonal, by which a contour may be wrong
AROUND = 0.1  # of the diagonal, around the object, that its background is learned from
FEW = 16  # pixels that are too few to learn colours from
PART = 0.2  # of the largest part's area, below which another part is taken for a stray
NECK = 5  # pixels of a bridge between two parts that does not make them one
CHROMA = 2.5  # levels per unit of CIELAB's a and b, which stay within 50 in photos
EXTREMES = (1, 99)  # percentiles that nearness is stretched between
# GrabCut takes three channels, of light, a, b and nearness. Which tell an object from what is
# around it differs: fur before a cream wall by the last three, a mouse on its mat by the first.
LOOKS = ((0, 1, 2), (1, 2, 3), (0, 1, 3), (0, 2, 3))

STROKE = 3  # pixels that a stroke is wide

Box = tuple[float | int, float | int, float | int, float | int]
Look = tuple[int, int, int]


@dataclass(frozen=True)
class Stroke:
    """A line that the user draws in a photo, over the object or over what is not."""

    points: tuple[tuple[float | int, float | int], ...]
    """In the photo's pixels; one is a dot."""
    over_object: bool
    """Or over what is not."""


@dataclass(frozen=True)
class Evidence:
    """What tells objects apart in a photo: light, the two chroma axes of CIELAB, nearness."""

    channels: UInt8[np.ndarray, "H W 4"]

    def look(self, look: Look) -> UInt8[np.ndarray, "H W 3"]:
        """Three of the channels, as OpenCV takes them."""
        return np.ascontiguousarray(self.channels[..., list(look)])


def evidence(photo: UInt8[Tensor, "H W 3"], nearness: Float[Tensor, "H W"]) -> Evidence:
    """What GrabCut goes by.

    Args:
        photo: sRGB.
        nearness: One over the depth of each pixel, in any unit.
    """
    lab = cv2.cvtColor(photo.numpy().astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    low, high = np.percentile(nearness.numpy(), EXTREMES)
    near = 255 * (nearness.numpy() - low) / max(high - low, 1e-12)
    light, chroma = 2.55 * lab[..., :1], 128 + CHROMA * lab[..., 1:]
    stacked = np.concatenate([light, chroma, near[..., None]], axis=2)
    return Evidence(stacked.clip(0, 255).astype(np.uint8))


def refuse_box(box: Box, size: tuple[int, int], photo: str) -> None:
    """Check that a box leaves enough pixels on both sides to learn colours from.

    Args:
        box: Left, top, right, bottom in pixels.
        size: Width and height of the photo.
        photo: Its name.

    Raises:
        StyleSplatError: If it does not.
    """
    inside = _inside(box, size)
    if min(inside.sum(), (~inside).sum()) < FEW:
        raise StyleSplatError(
            f"The box in {photo} is too small, or leaves too little of the photo outside to "
            "compare with. Draw it around the object, with some background left."
        )


def cut_box(
    seen: Evidence, box: Box, photo: str, strokes: Sequence[Stroke] = ()
) -> tuple[Look, Mask]:
    """What a box holds, the rest of the photo being background.

    Of the cuts by different channels the one is taken that agrees with the others most.

    Args:
        seen: Of the photo.
        box: Left, top, right, bottom in its pixels, as `refuse_box` lets pass.
        photo: Its name.
        strokes: What is known to be the object, and what not.

    Returns:
        The channels of that cut, and the object's mask.

    Raises:
        StyleSplatError: If the box holds nothing that differs from what is around it, or strokes
            cover all of one of them.
    """
    height, width, _ = seen.channels.shape
    marks = np.where(_inside(box, (width, height)), cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    for stroke in strokes:
        line = np.array([*stroke.points, stroke.points[-1]]).astype(np.int32)  # a dot has two ends
        value = cv2.GC_FGD if stroke.over_object else cv2.GC_BGD
        cv2.polylines(marks, [line], isClosed=False, color=value, thickness=STROKE)
    over = np.isin(marks, (cv2.GC_FGD, cv2.GC_PR_FGD))
    if min(over.sum(), (~over).sum()) < FEW:
        raise StyleSplatError(
            f"The strokes in {photo} leave nothing of the object, or nothing of what is around it. "
            "Draw less."
        )
    found = {look: torch.from_numpy(_cut(seen.look(look), marks)) for look in LOOKS}
    cuts = {look: mask for look, mask in found.items() if mask.any()}
    if not cuts:
        raise StyleSplatError(
            f"What the box in {photo} holds looks like what is around it. Draw the box tighter, "
            "or choose another photo."
        )
    agreement = {
        look: sum(mask_iou(cut, each) for each in cuts.values()) for look, cut in cuts.items()
    }
    best = max(cuts, key=lambda look: agreement[look])
    return best, cuts[best]


def refine(
    seen: Evidence,
    probability: Float[Tensor, "H W"],
    novelty: Float[Tensor, "H W"],
    look: Look,
) -> Mask:
    """The mask of an object of which a probability is known, its contour moved to an edge.

    Args:
        seen: Of the photo.
        probability: That a pixel shows the object.
        novelty: How much of what it shows is new, from 0 to 1: colours decide where it is.
        look: The channels to go by.
    """
    likely = probability.numpy()
    mask = np.zeros(likely.shape, bool)
    diagonal = float(np.hypot(*likely.shape))
    if not (likely > 0.5).any():
        return torch.from_numpy(mask)
    near = _dilated(likely > UNSURE, PLAY * diagonal)
    novel = novelty.numpy() > 0.5
    if novel.any():
        near |= novel & _dilated(near, AROUND * diagonal)
    window = _window(near, round(AROUND * diagonal))
    likely, near = likely[window], near[window]
    sure = ~_dilated(likely <= SURE, PLAY * diagonal)
    marks = np.where(likely > 0.5, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    marks[sure], marks[~near] = cv2.GC_FGD, cv2.GC_BGD
    inside = likely > 0.5
    enough = min(inside.sum(), (~inside).sum()) >= FEW
    mask[window] = _cut(seen.look(look)[window], marks) if enough else inside
    return torch.from_numpy(mask)


def _inside(box: Box, size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    inside = np.zeros(size[::-1], bool)
    inside[int(box[1]) : round(box[3]), int(box[0]) : round(box[2])] = True
    return inside


def _cut(image: UInt8[np.ndarray, "H W 3"], marks: UInt8[np.ndarray, "H W"]) -> np.ndarray:
    cv2.setRNGSeed(SEED)
    models, marks = np.zeros((2, 1, 65)), marks.copy()
    image = np.ascontiguousarray(image)
    unused = (0, 0, 1, 1)  # a rectangle, which the marks stand for
    cv2.grabCut(image, marks, unused, models[0], models[1], ROUNDS, cv2.GC_INIT_WITH_MASK)
    # What is certain stays certain, and is no stray
    return _without_strays(np.isin(marks, (cv2.GC_FGD, cv2.GC_PR_FGD))) | (marks == cv2.GC_FGD)


def _without_strays(mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """The mask's large parts; what hangs on by a thin bridge is a part of its own."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (NECK, NECK))
    core = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, disc)
    count, parts, stats, _ = cv2.connectedComponentsWithStats(core)
    if count == 1:  # thinner than the bridge
        return mask
    areas = stats[1:, cv2.CC_STAT_AREA]
    large = 1 + np.flatnonzero(areas >= PART * areas.max())
    return mask & (cv2.dilate(np.isin(parts, large).astype(np.uint8), disc) > 0)


def _dilated(mask: np.ndarray, radius: float) -> np.ndarray:
    side = 2 * max(1, round(radius)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return cv2.dilate(mask.astype(np.uint8), disc) > 0


def _window(mask: np.ndarray, margin: int) -> tuple[slice, slice]:
    """The rows and columns that a mask spans, and some around."""
    spans = ((int(places.min()), int(places.max())) for places in np.nonzero(mask))
    rows, columns = (slice(max(0, first - margin), last + 1 + margin) for first, last in spans)
    return rows, columns
