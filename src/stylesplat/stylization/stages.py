"""How an object is painted, coarse first: for every quality a table of stages."""

from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Literal

Quality = Literal["draft", "normal", "high"]

WINDOW = 160  # pixels along the parts that fine stages look at: a step costs what a coarse one does
FINEST = 640.0  # pixels of an object's longer side: for more, parts would be too few to cover it
LEAST = 48.0  # pixels of it: smaller renders have too few features, however large strokes are to be
SCALE = 2.0  # of the style, for which the tables are made
SMALLEST = 2.0  # times the pattern's size: for small strokes, and more than photos may show


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
    anchored: bool = False
    """Whether the large shapes found before stay."""


@dataclass(frozen=True)
class Row:
    """One stage of a table."""

    steps: int
    """In proportion to those of the others."""
    of_pattern: float | None = None
    """The object's size as a share of that in which patterns are matched."""
    of_photos: float | None = None
    """Or parts of it, in its size as a share of that in the photos."""
    rate: float = 1.0
    """Factor of the learning rate."""


GROWTH = 4.0  # times as many Gaussians with a canvas
MOST_GROWTH = 16.0  # of objects that have few
FEW = 60_000  # Gaussians: fewer show no strokes, be they as many times as many as usual
COARSE = 0.6  # of the pattern's size: where the large shapes are found
FIRST = 25  # steps on the object as it is, where laying a canvas would keep one waiting
PLANS: dict[Quality, tuple[Row, ...]] = {
    "draft": (Row(90, COARSE), Row(30, 1.0)),
    "normal": (
        Row(60, COARSE),
        Row(30, 1.0),
        Row(60, of_photos=0.5, rate=2.0),
        Row(60, of_photos=1.0, rate=2.0),
    ),
    "high": (
        Row(60, COARSE),
        Row(30, 1.0),
        Row(80, of_photos=0.5, rate=2.0),
        Row(200, of_photos=1.0, rate=2.0),
    ),
}


def usual_steps(quality: Quality) -> int:
    """The steps of a quality if no number is asked for."""
    return sum(row.steps for row in PLANS[quality])


def usual_growth(quality: Quality, gaussians: int) -> float:
    """How many times its Gaussians an object may have with its canvas, if nothing else is asked.

    For a draft, laying a canvas would take longer than all else. Smooth objects are made of few
    Gaussians, and need more discs than a multiple of these.

    Args:
        quality: How fine the painting is to be.
        gaussians: How many the object has.
    """
    if quality == "draft":
        return 1.0
    return min(max(GROWTH, 1 + FEW / max(gaussians, 1)), MOST_GROWTH)


def planned(
    quality: Quality,
    *,
    pattern_length: float,
    photo_length: float,
    most: float,
    steps: int,
    scale: float,
    canvas: bool = False,
) -> list[Stage]:
    """The stages of a quality.

    The style image has the same size in pixels whatever its scale, or its strokes would blur or
    lose their place among features: it is the object that becomes smaller beside it, or larger.

    Args:
        quality: Which table.
        pattern_length: The object's longer side where patterns are matched, in pixels, for a
            style of the usual scale.
        photo_length: The same in the photos.
        most: It never exceeds this, be strokes as small as they may.
        steps: Of all stages together; those without any are left out.
        scale: Of the style.
        canvas: Whether a canvas will be laid: after the first stage, which is short then.
    """
    finest = max(pattern_length, min(photo_length, FINEST))
    rows, total = PLANS[quality], usual_steps(quality)
    if canvas:
        first, *rest = rows
        begun = replace(first, steps=FIRST), replace(first, steps=first.steps - FIRST)
        rows = (*begun, *rest)
    ends = [round(steps * done / total) for done in accumulate((r.steps for r in rows), initial=0)]
    stages = []
    for row, (start, end) in zip(rows, pairwise(ends), strict=True):
        if row.of_photos is not None:
            length = max(
                _scaled(pattern_length, scale, most=most),
                row.of_photos * _scaled(finest, scale, most=finest),
            )
            stages.append(Stage((length,), end - start, WINDOW, row.rate, True))
        else:
            assert row.of_pattern is not None
            usual = row.of_pattern * pattern_length
            length = _scaled(usual, scale, most=most)
            window = WINDOW if length > max(usual, WINDOW) else None
            stages.append(Stage((length,), end - start, window, row.rate))
    return [stage for stage in stages if stage.steps > 0]


def _scaled(length: float, scale: float, *, most: float) -> float:
    """The object's longer side beside a style of some scale, of that beside the usual one."""
    return min(max(length * SCALE / scale, min(length, LEAST)), most)
