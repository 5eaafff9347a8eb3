"""Photos that show what another one shows, from where it was taken."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from stylesplat.io.captures.photos import same_shape
from stylesplat.progress import track
from stylesplat.structure_from_motion.displacement import Tracker

# Of the longer side. Neighbours in desk move by 0.27 % or more, copies and photos from a tripod by
# less than 0.05 %
SAME = 0.002
ALIKE = 0.9  # correlation of tiny pictures below which two are not compared closely
TINY = (32, 32)  # pixels
CLOSEST = 3  # photos that each is compared with: its neighbours, or copies of it


def near_duplicates(
    greys: Sequence[UInt8[np.ndarray, "_ _"]], worth: Sequence[tuple[float, ...]]
) -> dict[int, int]:
    """By photo that repeats another, which one that is.

    Photos are compared with those that are kept, so of a slow walk as many are kept as moves tell.

    Args:
        greys: Small pictures of the photos.
        worth: Of two that show the same, the one with more of it is kept, else the first.
    """
    tiny = np.array([_tiny(grey) for grey in greys])
    kept: dict[int, Tracker] = {}
    repeats: dict[int, int] = {}
    for index, grey in enumerate(track(greys, "comparing photos", unit="photo")):
        same = next((o for o in _closest(tiny, index, kept) if _same(kept[o], grey)), None)
        if same is not None and worth[index] <= worth[same]:
            repeats[index] = same
            continue
        if same is not None:
            repeats[same] = index
            del kept[same]
        kept[index] = Tracker(grey)
    return {photo: _end(repeats, photo) for photo in repeats}


def _closest(tiny: Float[np.ndarray, "N P"], index: int, kept: dict[int, Tracker]) -> list[int]:
    others = np.array([*kept], int)
    alike = tiny[others] @ tiny[index]
    order = np.argsort(-alike, kind="stable")[:CLOSEST]
    return [int(others[o]) for o in order if alike[o] >= ALIKE]


def _same(tracker: Tracker, grey: UInt8[np.ndarray, "h w"]) -> bool:
    size = tracker.grey.shape[::-1]
    if not same_shape(size, grey.shape[::-1]):
        return False
    moved = tracker.to(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
    return moved is not None and moved < SAME


def _tiny(grey: UInt8[np.ndarray, "h w"]) -> Float[np.ndarray, " P"]:
    """Such that the product of two is their correlation."""
    values = cv2.resize(grey, TINY, interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    values -= values.mean()
    return values / (np.linalg.norm(values) or 1)


def _end(repeats: dict[int, int], photo: int) -> int:
    while photo in repeats:
        photo = repeats[photo]
    return photo
