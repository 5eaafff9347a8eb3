"""Measures of small grey pictures: sharpness, missing background, displacement, duplicates."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8

from stylesplat.io.captures.photos import SmallPhoto, same_shape
from stylesplat.photo_libraries import cv2
from stylesplat.progress import track

Grey = UInt8[np.ndarray, "_ _"]

MEASURE_SIDE = 640  # pixels of the longer side at which pictures are compared

# Sharpness
MEASURE_ROUNDING = 1.0  # grey levels squared: what rounding adds to the variance
MEASURE_NEIGHBOURS = 10  # photos whose median sharpness is the typical one
# Relative to typical. Real photos (fox, desk) have 0.40 or more; blur of 1 % of the width 0.17
BLURRED = 0.2
# Relative to typical: too blurred where other frames exist, or where nothing matches
MEASURE_SOFT = 0.5
# Absolute, of the median photo. Fox and desk have 0.015 and 0.007, and 0.0005 after a Gaussian blur
# of 0.3 % of their width
ALL_BLURRED = 0.0007
LAPLACIANS = tuple(
    np.array(kernel, np.float32)
    for kernel in (
        [[-1, 2, -1]],
        [[-1], [2], [-1]],
        [[-1, 0, 0], [0, 2, 0], [0, 0, -1]],
        [[0, 0, -1], [0, 2, 0], [-1, 0, 0]],
    )
)
MEASURE_REACH = np.ones((3, 3), np.uint8)  # of their kernels

# Background
MIN_REMOVED = 0.2  # share of a photo that a removed background covers
MEASURE_RIM = 0.02  # width of the rim, in shorter sides
# Share of the rim of one grey level; the object may reach the rest. Fox and desk have 0.07 at most,
# and an overexposed sky covers half of it
PLAIN_RIM = 0.7
MOSTLY_BACKDROP = 0.3  # share of other photos' rims: .5 of a tankard before white, .0 of rooms
SAME_LEVEL = 1.5  # grey levels: the variation that JPEG gives to one colour

# Displacement
MAX_CORNERS, MIN_QUALITY, CORNER_DISTANCE = 200, 0.01, 8  # of cv2.goodFeaturesToTrack
FLOW_WINDOW, FLOW_LEVELS = (15, 15), 4  # of the Lucas-Kanade tracker
ROUND_TRIP = 1.0  # pixels by which a corner tracked there and back may be off
MIN_TRACKED = 0.3  # share of corners; with fewer the displacement is unknown
GREY_MEAN, DEVIATION = 128.0, 50.0  # grey levels after normalization
# Of the corners: on an orbit the middle stands still while the rest moves, and few may be wrong
QUANTILE = 0.9

# Near duplicates
# In longer sides. Neighbours in desk move by 0.27 % or more, copies and photos from a tripod by
# less than 0.05 %
SAME_VIEW = 0.002
MIN_CORRELATION = 0.9  # of thumbnails; below it two photos are not tracked
THUMBNAIL = (32, 32)  # pixels
MEASURE_CANDIDATES = 3  # photos that each is compared with: its neighbours, or copies of it


def sharpness(
    grey: UInt8[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"] | None = None
) -> float:
    """Energy of the Laplacian along the direction that has least of it, over the variance.

    Motion blurs one direction only, which the full Laplacian hardly shows where edges run along
    it. The variance makes dark and bright photos comparable. The picture has `MEASURE_SIDE` pixels,
    of which all count or the valid ones.
    """
    pixels, counted = grey.astype(np.float32), slice(None)
    if valid is not None:
        counted = cv2.erode(valid.astype(np.uint8), MEASURE_REACH) > 0
        if not counted.any():
            return 0.0
    energies = [cv2.filter2D(pixels, cv2.CV_32F, each)[counted].var() for each in LAPLACIANS]
    return float(min(energies) / (pixels[counted].var() + MEASURE_ROUNDING))


def relative_sharpness(values: Sequence[float]) -> list[float]:
    """Each value over the median of its neighbours in the list: 1 is typical."""

    def relative(index: int) -> float:
        first = max(0, min(index - MEASURE_NEIGHBOURS // 2, len(values) - MEASURE_NEIGHBOURS - 1))
        around = [*values[first:index], *values[index + 1 : first + MEASURE_NEIGHBOURS + 1]]
        typical = float(np.median(around)) if around else values[index]
        return values[index] / typical if typical else 1.0

    return [relative(index) for index in range(len(values))]


def lacks_background(small: SmallPhoto) -> bool:
    """Whether the background is transparent, or of one colour.

    No camera gives a rim of one and the same grey level, so such a photo was masked.
    """
    if small.transparent > MIN_REMOVED:
        return True
    level = np.median(_rim(small.grey))
    share = _share_of_level(small.grey, level)
    return _share_of_level(_rim(small.grey), level) >= PLAIN_RIM and share >= MIN_REMOVED


def shares_backdrop(small: SmallPhoto, others: Sequence[SmallPhoto]) -> bool:
    """Whether the rims of other photos mostly have the one colour that a photo's rim has.

    Then that is no masked photo among ordinary ones, but a backdrop that light has made white, of
    which the others show a little more: a scale, or an edge.
    """
    level = np.median(_rim(small.grey))
    shares = [_share_of_level(_rim(each.grey), level) for each in others]
    return small.transparent <= MIN_REMOVED and float(np.median(shares)) > MOSTLY_BACKDROP


def _rim(grey: Grey) -> UInt8[np.ndarray, " R"]:
    width = max(1, round(MEASURE_RIM * min(grey.shape)))
    on_rim = np.ones(grey.shape, bool)
    on_rim[width:-width, width:-width] = False
    return grey[on_rim]


def _share_of_level(grey: UInt8[np.ndarray, "..."], level: float) -> float:
    return float((np.abs(grey.astype(np.float32) - level) < SAME_LEVEL).mean())


class CornerTracker:
    """Tracks the corners of one picture into others (Lucas-Kanade)."""

    def __init__(self, grey: UInt8[np.ndarray, "h w"]) -> None:
        self.grey = _normalized(grey)
        self.corners = cv2.goodFeaturesToTrack(self.grey, MAX_CORNERS, MIN_QUALITY, CORNER_DISTANCE)

    def displacement(self, grey: UInt8[np.ndarray, "h w"]) -> float | None:
        """How far most corners move, in longer sides; None if too few could be tracked."""
        if self.corners is None or grey.shape != self.grey.shape:
            return None
        other = _normalized(grey)
        there, found = _track_corners(self.grey, other, self.corners)
        back, found_again = _track_corners(other, self.grey, there)
        error = np.linalg.norm((back - self.corners)[:, 0], axis=1)
        good = found & found_again & (error < ROUND_TRIP)
        if good.mean() < MIN_TRACKED:
            return None
        moved = np.linalg.norm((there - self.corners)[:, 0], axis=1)[good]
        return float(np.quantile(moved, QUANTILE)) / max(grey.shape)


def near_duplicates(greys: Sequence[Grey], worth: Sequence[tuple[float, ...]]) -> dict[int, int]:
    """Which photos repeat another one: the row of the kept photo by the row of its duplicate.

    Each photo is compared with those of higher worth that were kept, so a slow walk is thinned to
    photos that differ.
    """
    thumbnails = np.array([_thumbnail(grey) for grey in greys])
    kept, repeats = dict[int, CornerTracker](), dict[int, int]()
    best_first = sorted(range(len(greys)), key=worth.__getitem__, reverse=True)
    for row in track(best_first, "comparing photos", unit="photo"):
        others = np.array([*kept], int)
        correlations = thumbnails[others] @ thumbnails[row]
        closest = np.argsort(-correlations, kind="stable")[:MEASURE_CANDIDATES]
        alike = [int(others[o]) for o in closest if correlations[o] >= MIN_CORRELATION]
        same = next((other for other in alike if _is_same_view(kept[other], greys[row])), None)
        if same is None:
            kept[row] = CornerTracker(greys[row])
        else:
            repeats[row] = same
    return repeats


def _normalized(grey: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """The picture with a fixed mean and contrast, so that the tracker ignores exposure."""
    mean, deviation = cv2.meanStdDev(grey)
    gain = DEVIATION / max(1.0, float(deviation[0, 0]))
    return cv2.convertScaleAbs(np.maximum(0, grey * gain + (GREY_MEAN - float(mean[0, 0]) * gain)))


def _track_corners(
    grey: UInt8[np.ndarray, "h w"],
    other: UInt8[np.ndarray, "h w"],
    corners: Float[np.ndarray, "P 1 2"],
) -> tuple[Float[np.ndarray, "P 1 2"], np.ndarray]:
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        grey, other, corners, np.empty_like(corners), winSize=FLOW_WINDOW, maxLevel=FLOW_LEVELS
    )
    return moved, found[:, 0] > 0


def _thumbnail(grey: UInt8[np.ndarray, "h w"]) -> Float[np.ndarray, " P"]:
    """Centred and of length 1, so that the product of two is their correlation."""
    values = cv2.resize(grey, THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    values -= values.mean()
    return values / (np.linalg.norm(values) or 1)


def _is_same_view(tracker: CornerTracker, grey: UInt8[np.ndarray, "h w"]) -> bool:
    size = tracker.grey.shape[::-1]
    if not same_shape(size, grey.shape[::-1]):
        return False
    moved = tracker.displacement(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
    return moved is not None and moved < SAME_VIEW
