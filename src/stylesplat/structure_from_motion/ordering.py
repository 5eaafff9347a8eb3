"""In which order photos were taken, and whether that tells which of them overlap."""

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import cv2
import numpy as np
from jaxtyping import UInt8

from stylesplat.progress import track

FEATURES = 500  # ORB features a photo
ALIKE = 64  # bits of 256 in which two descriptors may differ
EPIPOLAR = 2.0  # pixels off its epipolar line that a match may be
# Matches that agree with one motion. Neighbours in fox and desk have 25 or more but for 1 in 50 and
# 1 in 25; of far photos less than 1 in 30 (fox) and 1 in 4 (desk) do
OVERLAP = 25
NEIGHBOURS = 0.85  # of all, that have to overlap
MOST_MISSING = 4  # numbers from the first to the last, by photos: more is no series


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """What names are sorted by, so that numbers count as such.

    Example:
        >>> sorted(["b10.jpg", "b9.jpg", "B1.JPG"], key=natural_key)
        ['B1.JPG', 'b9.jpg', 'b10.jpg']
    """
    parts = re.split(r"(\d+)", name.casefold())
    keys = [(0, int(p)) if i % 2 else (1, p) for i, p in enumerate(parts) if p]
    return (*keys, (1, name))


def is_series(names: Sequence[str]) -> bool:
    """Whether names in order differ by a running number only, with few gaps.

    Example:
        >>> is_series(["IMG_8.jpg", "IMG_9.jpg", "IMG_12.JPG"]), is_series(["a1.jpg", "b2.jpg"])
        (True, False)
    """
    matches = [re.fullmatch(r"(.*?)(\d+)\D*", _stem(name)) for name in names]
    found = [match for match in matches if match]
    if len(found) < len(names) or len({match[1] for match in found}) != 1:
        return False
    numbers = [int(match[2]) for match in found]
    return numbers[-1] - numbers[0] < MOST_MISSING * len(numbers)


def neighbours_overlap(greys: Sequence[UInt8[np.ndarray, "_ _"]]) -> bool:
    """Whether nearly every photo shows something of what the one before it shows.

    Args:
        greys: Small pictures of the photos in order.
    """
    orb = cv2.ORB.create(FEATURES)
    before, overlapping = None, 0
    for grey in track(greys, "looking at neighbours", unit="photo"):
        now = orb.detectAndCompute(grey, None)
        overlapping += before is not None and _matches(before, now) >= OVERLAP
        before = now
    return overlapping >= NEIGHBOURS * (len(greys) - 1)


def _matches(one: Sequence, other: Sequence) -> int:
    """How many features agree with one motion of the camera."""
    (points, codes), (points_b, codes_b) = one, other
    if codes is None or codes_b is None:
        return 0
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(codes, codes_b)
    matches = [match for match in matches if match.distance < ALIKE]
    if len(matches) < OVERLAP:
        return 0
    there = np.array([points[match.queryIdx].pt for match in matches], np.float32)
    here = np.array([points_b[match.trainIdx].pt for match in matches], np.float32)
    _, agreeing = cv2.findFundamentalMat(there, here, cv2.FM_RANSAC, EPIPOLAR, 0.99, FEATURES)
    return 0 if agreeing is None else int(agreeing.sum())


def _stem(name: str) -> str:
    return PurePosixPath(name).with_suffix("").as_posix().casefold()
