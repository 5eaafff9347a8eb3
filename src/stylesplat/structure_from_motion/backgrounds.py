"""Whether photos show the surroundings of what they show, without which no camera can be found."""

import numpy as np

from stylesplat.io.captures.photos import SmallPhoto

LEFT_OUT = 0.2  # of a photo that shows nothing: less is a rim
RIM = 0.02  # of the shorter side
# Of the rim that has one grey level; the object may reach the rest. Fox and desk have 0.07 at most,
# and a burnt-out sky covers half of it
PLAIN_RIM = 0.7
SAME = 1.5  # grey levels: what JPEG makes of one colour


def missing_background(small: SmallPhoto) -> str | None:
    """What there is instead of a background: "transparent", "black", "white" or "of one colour".

    No camera gives a rim of one and the same grey level, so whoever finds it looks at a masked
    photo.

    Args:
        small: How the photo looks.
    """
    if small.transparent > LEFT_OUT:
        return "transparent"
    rim = _rim(small.grey)
    level = float(np.median(rim))
    if _share(rim, level) < PLAIN_RIM or _share(small.grey, level) < LEFT_OUT:
        return None
    return "black" if level <= SAME else "white" if level >= 255 - SAME else "of one colour"


def _rim(grey: np.ndarray) -> np.ndarray:
    width = max(1, round(RIM * min(grey.shape)))
    inside = np.zeros(grey.shape, bool)
    inside[width:-width, width:-width] = True
    return grey[~inside]


def _share(grey: np.ndarray, level: float) -> float:
    return float((np.abs(grey.astype(np.float32) - level) < SAME).mean())
