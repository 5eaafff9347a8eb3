"""The layout of a sheet: one object in a grid of styles and settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from stylesplat.errors import StyleSplatError
from stylesplat.figures.grid import GridPicture, Row
from stylesplat.figures.pictures import to_uint8
from stylesplat.stylization.style import Style
from stylesplat.stylization.style_image import Picture

Variation = tuple[str, tuple[Any, ...]]
"""A setting, or `preset`, and the values that it takes in turn."""
FIELDS = {"stroke_size": "scale"}  # options of `stylize` that settings call otherwise


class SheetCell(NamedTuple):
    """A cell of a sheet, and the intensity that it shows."""

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
        """The styles to paint, at full intensity, and the cells that each painting gives."""
        runs: dict[object, tuple[Style, list[SheetCell]]] = {}
        for number, row in enumerate(self.rows):
            for column, (_, style) in enumerate(row.cells):
                config = replace(style.config, intensity=1.0)
                full = Style(*style.pictures, config=config, preset=style.preset)
                same_pictures = tuple(map(id, style.pictures))  # colours cannot be hashed
                _, cells = runs.setdefault((same_pictures, config, style.network), (full, []))
                cells.append(SheetCell(number, column, style.config.intensity))
        return list(runs.values())


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
    if len(variations) > (1 if len(styles) > 1 else 2):
        keys = ", ".join(key for key, _ in variations)
        raise StyleSplatError(
            f"Got {len(styles)} styles and --vary {keys}. A sheet has rows and columns: one style "
            "and up to two --vary, or several styles and one."
        )
    columns, lines = _choices(variations[:1]), _choices(variations[1:])
    rows = []
    for pictures in styles:
        for label, changed in lines:
            cells = tuple(
                (caption or "styled", Style(*pictures, **{**settings, **changed, **more}))
                for caption, more in columns
            )
            rows.append(PlannedRow(label or " + ".join(map(_picture_title, pictures)), cells))
    return SheetPlan(tuple(rows))


def caption_rows(
    plan: SheetPlan, pictures: Mapping[tuple[int, int], GridPicture], before: GridPicture
) -> list[Row]:
    """The grid's rows, which begin with the object before; style pictures lead where they change.

    Captions begin with the row and the column, counted from 1.
    """
    rows, last = [], None
    for number, row in enumerate(plan.rows):
        cells = [
            (pictures[number, at], f"{number + 1},{at + 1}: {caption}")
            for at, (caption, _) in enumerate(row.cells)
        ]
        style = row.cells[0][1]
        is_new = last is None or style.pictures != last
        leading = [to_uint8(image) for image in Style(*style.pictures).read()] if is_new else []
        rows.append(Row([None if number else (before, "before"), *cells], row.label, leading))
        last = style.pictures
    return rows


def _choices(variations: Sequence[Variation]) -> list[tuple[str, dict[str, Any]]]:
    """Captions and settings by value of a variation; one without any if there is none."""
    if not variations:
        return [("", {})]
    ((key, values),) = variations
    words = key.replace("_", " ")
    return [(f"{words} {_value_text(value)}", {FIELDS.get(key, key): value}) for value in values]


def _value_text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_value_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _picture_title(picture: object) -> str:
    return Path(picture).stem if isinstance(picture, str | Path) else "picture"
