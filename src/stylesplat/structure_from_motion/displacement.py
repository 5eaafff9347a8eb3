"""How far what is seen moves from one small grey picture to another."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

POINTS = 200  # that are followed
QUALITY, APART = 0.01, 8  # of corners, relative to the best one; pixels between them
WINDOW, LEVELS = (15, 15), 4  # of the Lucas-Kanade tracker
THERE_AND_BACK = 1.0  # pixels by which a point that was followed there and back may have moved
FOLLOWED = 0.3  # the share of points without which nothing is known
MIDDLE, CONTRAST = 128.0, 50.0  # grey levels: mean and standard deviation
# Of the points: on an orbit the middle stands still while the rest moves, and few may be wrong
MOST = 0.9


class Tracker:
    """Follows the corners of one picture into others."""

    def __init__(self, grey: UInt8[np.ndarray, "h w"]) -> None:
        self.grey = _levelled(grey)
        self.points = cv2.goodFeaturesToTrack(self.grey, POINTS, QUALITY, APART)

    def to(self, grey: UInt8[np.ndarray, "h w"]) -> float | None:
        """How far most points move at most, as a share of the longer side; None if lost.

        Args:
            grey: Of the same size.
        """
        if self.points is None or grey.shape != self.grey.shape:
            return None
        other = _levelled(grey)
        there, seen = _follow(self.grey, other, self.points)
        back, seen_again = _follow(other, self.grey, there)
        wrong = np.linalg.norm((back - self.points)[:, 0], axis=1)
        good = seen & seen_again & (wrong < THERE_AND_BACK)
        if good.mean() < FOLLOWED:
            return None
        moved = np.linalg.norm((there - self.points)[:, 0], axis=1)[good]
        return float(np.quantile(moved, MOST)) / max(grey.shape)


def _levelled(grey: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """With the same mean and contrast as any other, whatever the exposure; the tracker needs it."""
    mean, deviation = cv2.meanStdDev(grey)
    gain = CONTRAST / max(1.0, float(deviation[0, 0]))
    return cv2.convertScaleAbs(np.maximum(0, grey * gain + (MIDDLE - float(mean[0, 0]) * gain)))


def _follow(
    grey: UInt8[np.ndarray, "h w"],
    other: UInt8[np.ndarray, "h w"],
    points: Float[np.ndarray, "P 1 2"],
) -> tuple[Float[np.ndarray, "P 1 2"], np.ndarray]:
    moved, seen, _ = cv2.calcOpticalFlowPyrLK(
        grey, other, points, np.empty_like(points), winSize=WINDOW, maxLevel=LEVELS
    )
    return moved, seen[:, 0] > 0
