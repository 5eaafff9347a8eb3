"""What a figure says: text, lists, tables and pictures, as Markdown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import table
from PIL import Image

from paper_figures.book import Cell, Results
from paper_figures.pictures import grid, strip
from paper_figures.subject import Subject

QUALITY = 72  # of JPEG in docs
OURS = "demo"  # the scene that is made here
GIVEN = ("photo", "label map")  # what others took: of their scenes docs show renders alone


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Heading:
    """What follows is about."""

    text: str


@dataclass(frozen=True)
class Points:
    """A list."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Table:
    """Numbers."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Row:
    """Pictures side by side."""

    pictures: Mapping[str, Path]
    """Files by caption."""


@dataclass(frozen=True)
class Grid:
    """Square pictures of one size in rows and columns."""

    caption: str
    """What they are."""
    rows: Mapping[str, Mapping[str, Path]]
    """Files by label of the row and caption."""


Block = Text | Heading | Points | Table | Row | Grid


@dataclass(frozen=True)
class Figure:
    """One of the paper's figures."""

    name: str
    """In files."""
    title: str
    """The heading."""
    claim: str
    """What the paper says."""
    cells: Callable[[Subject], list[Cell]]
    """What is computed."""
    told: Callable[[Results], list[Block]]
    """What came of it, of a scene's results."""


Chapters = Sequence[tuple[str, Sequence[tuple[Figure, Sequence[Block]]]]]
"""By scene, its figures."""


def markdown_page(
    title: str,
    intro: Sequence[Block],
    chapters: Chapters,
    pictures: Path,
    appendix: Sequence[Block] = (),
) -> str:
    """A page, and small pictures in a folder beside it, none of them photos of others."""
    pictures.mkdir(parents=True, exist_ok=True)
    parts = [f"# {title}", *(_markdown(block, pictures, "intro") for block in intro)]
    for scene, figures in chapters:
        for figure, blocks in figures:
            parts += [f"## {figure.title} ({scene})", f"The paper: {figure.claim}"]
            for number, block in enumerate(blocks):
                shown = block if scene == OURS else _rendered(block)
                parts.append(_markdown(shown, pictures, f"{scene}-{figure.name}-{number}"))
    parts += (_markdown(block, pictures, "appendix") for block in appendix)
    return "\n\n".join(parts) + "\n"


def _rendered(block: Block) -> Block:
    if not isinstance(block, Row):
        return block
    return Row({name: file for name, file in block.pictures.items() if name not in GIVEN})


def _markdown(block: Block, pictures: Path, stem: str) -> str:
    match block:
        case Text(text):
            return text
        case Heading(text):
            return f"## {text}"
        case Points(lines):
            return "\n".join(f"- {line}" for line in lines)
        case Table(heads, rows):
            return table(heads, rows)
        case Grid(caption, rows):
            shown, said = Image.fromarray(grid(rows).numpy()), f"{caption}."
        case Row(found):
            caption = "; ".join(found)
            shown, said = strip([*found.values()]), f"Left to right: {caption}."
    place = pictures / f"{stem}.jpg"
    shown.save(place, quality=QUALITY, optimize=True)
    return f"![{caption}]({pictures.name}/{place.name})\n\n{said}"


def digits(value: Any, places: int = 3) -> str:
    """A number as a table shows it; what is not known is left empty."""
    return "" if value is None else f"{value:.{places}f}"


def percent(value: Any, places: int = 2) -> str:
    """A share as a table shows it."""
    return "" if value is None else f"{100 * value:.{places}f} %"
