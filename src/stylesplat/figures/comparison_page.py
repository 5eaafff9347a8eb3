"""A page that shows scenes side by side: the same views, their numbers, how these differ."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from jaxtyping import UInt8
from torch import Tensor

from stylesplat.evaluation.summary import flat
from stylesplat.figures.page_parts import figure_html, page_style, picture_url, table_html

TEMPLATE = Path(__file__).with_name("comparison_page.html")


@dataclass(frozen=True)
class Column:
    """One scene on the page."""

    name: str
    """What it is called."""
    metrics: Mapping[str, Any]
    """Numbers, nested."""
    differences: Mapping[str, Any]
    """The same less the first scene's."""
    from_first: Mapping[str, float]
    """How far its pictures are from the first scene's."""
    pictures: Sequence[UInt8[Tensor, "_ _ 3"]]
    """One per view."""


def comparison_page(
    columns: Sequence[Column], views: Sequence[str], *, title: str, notes: Sequence[str] = ()
) -> str:
    """The page as HTML that needs no other file.

    Args:
        columns: The scenes; the first is what others are compared with.
        views: What the pictures are of.
        title: Of the page.
        notes: Sentences to read before the numbers.
    """
    first = escape(columns[0].name)
    rows = [
        '<div class="wide"><div class="row">'
        + "".join(
            figure_html(picture_url(column.pictures[row]), f"{column.name}, {view}")
            for column in columns
        )
        + "</div></div>"
        for row, view in enumerate(views)
    ]
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        style=page_style(),
        title=escape(title),
        first=first,
        about=escape(", ".join(column.name for column in columns)) + " in the same views.",
        notes="\n".join(f"<p>{escape(note)}</p>" for note in notes),
        pictures="\n".join(rows),
        numbers=table_html(["", *(column.name for column in columns)], number_rows(columns)),
        gaps=table_html(["", *(column.name for column in columns)], _gap_rows(columns)),
    )


def number_rows(columns: Sequence[Column]) -> list[list[str]]:
    """A row per number that any scene has: its name, and for each scene value and difference.

    The first scene's differences are 0 and not shown.
    """
    values = [dict(flat(column.metrics)) for column in columns]
    gaps = [dict(flat(column.differences)) for column in columns]
    names = dict.fromkeys(name for each in values for name in each)
    return [
        [
            name,
            *(
                _cell(value.get(name), None if row == 0 else gap.get(name))
                for row, (value, gap) in enumerate(zip(values, gaps, strict=True))
            ),
        ]
        for name in names
    ]


def _gap_rows(columns: Sequence[Column]) -> list[list[str]]:
    names = dict.fromkeys(name for column in columns for name in column.from_first)
    return [[name, *(_cell(c.from_first.get(name), None) for c in columns)] for name in names]


def _cell(value: float | None, gap: float | None) -> str:
    if value is None:
        return ""
    shown = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
    return shown if gap is None else f"{shown} ({gap:+.3g})"
