"""The layout of a sheet: one object in a grid of styles and settings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stylesplat.errors import StyleSplatError
from stylesplat.figures.grid import GridPicture, Row
from stylesplat.figures.pictures import to_uint8
from stylesplat.stylization.style import Style
from stylesplat.stylization.style_image import Picture

Variation = tuple[str, tuple[Any, ...]]
"""A setting, or `preset`, and the values that it takes in turn."""
FIELDS = {"stroke_size": "scale"}  # options of `stylize` that settings call otherwise


@dataclass(frozen=True)
class SheetCell:
    """A cell of a sheet, counted from 0: what to paint there, and its caption."""

    row: int
    column: int
    caption: str
    style: Style


@dataclass(frozen=True)
class SheetPlan:
    """What to draw."""

    labels: tuple[str, ...]
    """What the cells of each row have in common."""
    cells: tuple[SheetCell, ...]
    """Row by row; the cells of a row are styles of the same pictures."""

    def runs(self) -> list[tuple[Style, list[SheetCell]]]:
        """The styles to paint, at full intensity, and the cells that each painting gives."""
        runs: dict[object, tuple[Style, list[SheetCell]]] = {}
        for cell in self.cells:
            style, config = cell.style, replace(cell.style.config, intensity=1.0)
            full = Style(*style.pictures, config=config, preset=style.preset)
            same_pictures = tuple(map(id, style.pictures))  # colours cannot be hashed
            runs.setdefault((same_pictures, config, style.network), (full, []))[1].append(cell)
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
    columns, rows = (list(_choices(some)) for some in (variations[:1], variations[1:]))
    labels, cells = list[str](), list[SheetCell]()
    for pictures in styles:
        for label, changed in rows:
            for column, (caption, more) in enumerate(columns):
                style = Style(*pictures, **{**settings, **changed, **more})
                cells.append(SheetCell(len(labels), column, caption or "styled", style))
            labels.append(label or " + ".join(map(_picture_title, pictures)))
    return SheetPlan(tuple(labels), tuple(cells))


def caption_rows(
    plan: SheetPlan, pictures: Mapping[tuple[int, int], GridPicture], before: GridPicture
) -> list[Row]:
    """The grid's rows, which begin with the object before; style pictures lead where they change.

    Captions begin with the row and the column, counted from 1.
    """
    rows, last = list[Row](), ()
    for number, label in enumerate(plan.labels):
        cells = [cell for cell in plan.cells if cell.row == number]
        captioned = [
            (pictures[number, at], f"{number + 1},{at + 1}: {cell.caption}")
            for at, cell in enumerate(cells)
        ]
        own = cells[0].style.pictures
        is_new = [*map(id, own)] != [*map(id, last)]
        leading = [to_uint8(image) for image in Style(*own).read()] if is_new else []
        rows.append(Row([None if rows else (before, "before"), *captioned], label, leading))
        last = own
    return rows


def _choices(variations: Sequence[Variation]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Captions and settings by value of a variation; one without any if there is none."""
    if not variations:
        yield "", {}
    for key, values in variations:
        for value in values:
            yield f"{key.replace('_', ' ')} {_value_text(value)}", {FIELDS.get(key, key): value}


def _value_text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_value_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _picture_title(picture: object) -> str:
    return Path(picture).stem if isinstance(picture, str | Path) else "picture"
