"""How an object is painted, coarse first: for every quality a table of stages."""

from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Literal

Quality = Literal["draft", "normal", "high"]

WINDOW = 160  # pixels along the parts that fine stages look at: a step costs what a coarse one does
FINEST = 640.0  # pixels of an object's longer side: for more, parts would be too few to cover it


@dataclass(frozen=True)
class Stage:
    """Some steps, which look at the object in one or several sizes by turns."""

    lengths: tuple[float, ...]
    """Its longer side in pixels, ascending; the style image follows the first."""
    steps: int
    """How many."""
    window: int | None = None
    """Side of the square parts that are looked at, in pixels; None looks at the whole object."""
    rate: float = 1.0
    """Factor of the learning rate."""


@dataclass(frozen=True)
class Row:
    """One stage of a table."""

    steps: int
    """In proportion to those of the others."""
    of_pattern: float | None
    """The object's size as a share of that in which patterns are matched; None is fine: parts
    at half and at full size of the photos."""
    rate: float = 1.0
    """Factor of the learning rate."""


GROWTH = 4.0  # times as many Gaussians by splitting
MOST_GROWTH = 16.0  # of objects that have few
FEW = 25_000  # Gaussians: fewer show no strokes, be they as many times as many as usual
COARSE = 0.6  # of the pattern's size: where the large shapes are found
PLANS: dict[Quality, tuple[Row, ...]] = {
    "draft": (Row(90, COARSE), Row(30, 1.0)),
    "normal": (Row(165, COARSE), Row(55, 1.0), Row(80, None, rate=2.0)),
    "high": (Row(225, COARSE), Row(75, 1.0), Row(300, None, rate=2.0)),
}


def usual_steps(quality: Quality) -> int:
    """The steps of a quality if no number is asked for."""
    return sum(row.steps for row in PLANS[quality])


def usual_growth(quality: Quality, gaussians: int) -> float:
    """How many times as many Gaussians an object may get by splitting, if nothing else is asked.

    For a draft, splitting and fitting what was split would take longer than all else. Smooth
    objects are made of few Gaussians, all of them too large for strokes.

    Args:
        quality: How fine the painting is to be.
        gaussians: How many the object has.
    """
    if quality == "draft":
        return 1.0
    return min(max(GROWTH, 1 + FEW / max(gaussians, 1)), MOST_GROWTH)


def planned(
    quality: Quality, *, pattern_length: float, photo_length: float, steps: int
) -> list[Stage]:
    """The stages of a quality.

    Args:
        quality: Which table.
        pattern_length: The object's longer side where patterns are matched, in pixels.
        photo_length: The same in the photos.
        steps: Of all stages together; those without any are left out.
    """
    finest = max(pattern_length, min(photo_length, FINEST))
    parts = max(pattern_length, finest / 2), finest
    rows, total = PLANS[quality], usual_steps(quality)
    ends = [round(steps * done / total) for done in accumulate((r.steps for r in rows), initial=0)]
    stages = [
        Stage(parts, end - start, WINDOW, row.rate)
        if row.of_pattern is None
        else Stage((row.of_pattern * pattern_length,), end - start, rate=row.rate)
        for row, (start, end) in zip(rows, pairwise(ends), strict=True)
    ]
    return [stage for stage in stages if stage.steps > 0]
