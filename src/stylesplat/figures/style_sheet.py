"""The layout of a sheet: one object in a grid of styles and settings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.grid import Row
from stylesplat.figures.pictures import to_uint8
from stylesplat.stylization.style import Style
from stylesplat.stylization.style_image import Picture

Variation = tuple[str, tuple[Any, ...]]
"""A setting, or `preset`, and the values that it takes in turn."""
Drawn = UInt8[Tensor, "_ _ 3"]
FIELDS = {"stroke_size": "scale"}  # settings that options of `stylize` call otherwise


class SheetCell(NamedTuple):
    """Where a blend is drawn."""

    row: int
    column: int
    intensity: float


@dataclass(frozen=True)
class PlannedRow:
    """A row of a sheet before it is painted."""

    label: str
    """What its cells have in common."""
    cells: tuple[tuple[str, Style], ...]
    """Captions and styles, all of the same pictures."""


@dataclass(frozen=True)
class SheetPlan:
    """What to draw."""

    rows: tuple[PlannedRow, ...]
    """All of the same length."""

    def runs(self) -> list[tuple[Style, list[SheetCell]]]:
        """What is to be painted, at full intensity, and the cells that each painting gives."""
        runs: list[tuple[Style, list[SheetCell]]] = []
        for number, row in enumerate(self.rows):
            for column, (_, style) in enumerate(row.cells):
                place = SheetCell(number, column, style.config.intensity)
                config = replace(style.config, intensity=1.0)
                full = Style(*style.pictures, config=config, preset=style.preset)
                for known, places in runs:
                    if _same(known, full):
                        places.append(place)
                        break
                else:
                    runs.append((full, [place]))
        return runs


def _same(one: Style, other: Style) -> bool:
    """Whether two styles give the same painting."""
    pairs = (one.pictures, other.pictures), (one.config, other.config), (one.network, other.network)
    return all(mine == others for mine, others in pairs)


def plan_sheet(
    styles: Sequence[Sequence[Picture]],
    variations: Sequence[Variation] = (),
    *,
    settings: Mapping[str, Any],
) -> SheetPlan:
    """Lay out a sheet: the first variation makes columns, the second or several styles rows.

    Raises:
        StyleSplatError: If there is more than rows and columns can show, or a value is out of
            range.
    """
    if not styles:
        raise StyleSplatError("A sheet shows at least one style. Pass --style OBJECT=IMAGE.")
    _refuse_crowded(styles, [key for key, _ in variations])
    columns, downwards = [*_choices(variations[:1])], [*_choices(variations[1:])]
    rows = []
    for pictures in styles:
        for label, varied in downwards:
            cells = tuple(
                (caption or "styled", Style(*pictures, **{**settings, **varied, **more}))
                for caption, more in columns
            )
            rows.append(PlannedRow(label or " + ".join(map(_title, pictures)), cells))
    return SheetPlan(tuple(rows))


def captioned(
    plan: SheetPlan, pictures: Mapping[tuple[int, int], Drawn], before: Drawn
) -> list[Row]:
    """The grid's rows, led by the object as it is; style pictures are shown where they change.

    Captions begin with the row and the column, counted from 1.
    """
    rows, last = [], None
    for number, row in enumerate(plan.rows):
        first = (before, "before") if number == 0 else None
        cells = [
            (pictures[number, at], f"{number + 1},{at + 1}: {caption}")
            for at, (caption, _) in enumerate(row.cells)
        ]
        style = row.cells[0][1]
        new = last is None or style.pictures != last
        shown = [to_uint8(image) for image in Style(*style.pictures).read()] if new else []
        rows.append(Row([first, *cells], row.label, shown))
        last = style.pictures
    return rows


def _refuse_crowded(styles: Sequence[object], keys: Sequence[str]) -> None:
    if len(keys) > (1 if len(styles) > 1 else 2):
        raise StyleSplatError(
            f"Got {len(styles)} styles and --vary {', '.join(keys)}. A sheet has rows and columns: "
            "one style and up to two --vary, or several styles and one."
        )


def _choices(variations: Sequence[Variation]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Captions and settings of the values of one variation; one without any if there is none."""
    if not variations:
        yield "", {}
    for key, values in variations:
        for value in values:
            yield f"{key.replace('_', ' ')} {_shown(value)}", {FIELDS.get(key, key): value}


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _title(picture: object) -> str:
    return Path(picture).stem if isinstance(picture, str | Path) else "picture"
