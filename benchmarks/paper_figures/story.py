"""What a figure says: text, tables and rows of pictures, as HTML and as Markdown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import torch
from bench import table
from PIL import Image

from paper_figures.book import Cell, Results
from paper_figures.subject import Subject
from stylesplat.drawing.page_parts import figure_html, page_style, picture_url, table_html

SMALL = 260  # pixels of a picture's longer side in docs
QUALITY = 82  # of JPEG there


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


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


Block = Text | Table | Row


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


def html_page(title: str, intro: Sequence[str], chapters: Chapters) -> str:
    """One page that needs no other file."""
    wide = "body { max-width: 1300px; } .row { flex-wrap: nowrap; overflow-x: auto; }"
    parts = [
        '<!doctype html><html lang="en"><meta charset="utf-8">',
        f"<title>{escape(title)}</title><style>{page_style()}{wide}</style>",
        f"<h1>{escape(title)}</h1>",
        *(f"<p>{escape(line)}</p>" for line in intro),
    ]
    for scene, figures in chapters:
        for figure, blocks in figures:
            parts.append(f"<section><h2>{escape(f'{figure.title} ({scene})')}</h2>")
            parts += [
                f"<p>The paper: {escape(figure.claim)}</p>",
                *map(_html, blocks),
                "</section>",
            ]
    return "\n".join([*parts, "</html>"])


def _html(block: Block) -> str:
    if isinstance(block, Text):
        return f"<p>{escape(block.text)}</p>"
    if isinstance(block, Table):
        return table_html(block.heads, block.rows)
    figures = (figure_html(_url(path), name) for name, path in block.pictures.items())
    return f'<div class="row">{"".join(figures)}</div>'


def _url(file: Path) -> str:
    """A picture as a JPEG that the page holds."""
    return picture_url(torch.from_numpy(np.array(Image.open(file).convert("RGB"))))


def markdown_page(title: str, intro: Sequence[str], chapters: Chapters, pictures: Path) -> str:
    """The same as Markdown, and small pictures in a folder beside it."""
    pictures.mkdir(parents=True, exist_ok=True)
    parts = [f"# {title}", *intro]
    for scene, figures in chapters:
        for figure, blocks in figures:
            parts += [f"## {figure.title} ({scene})", f"The paper: {figure.claim}"]
            for number, block in enumerate(blocks):
                stem = f"{scene}-{figure.name}-{number}"
                parts.append(_markdown(block, pictures, stem))
    return "\n\n".join(parts) + "\n"


def _markdown(block: Block, pictures: Path, stem: str) -> str:
    if isinstance(block, Text):
        return block.text
    if isinstance(block, Table):
        return table(block.heads, block.rows)
    place = pictures / f"{stem}.jpg"
    _strip([*block.pictures.values()]).save(place, quality=QUALITY, optimize=True)
    captions = "; ".join(block.pictures)
    return f"![{captions}]({pictures.name}/{place.name})\n\nLeft to right: {captions}."


def _strip(files: Sequence[Path]) -> Image.Image:
    """Pictures beside each other, each as high as the others."""
    images = [Image.open(file).convert("RGB") for file in files]
    height = min(SMALL * 3 // 4, *(image.height for image in images), 10**6)
    small = [image.resize((round(image.width * height / image.height), height)) for image in images]
    strip = Image.new("RGB", (sum(i.width + 4 for i in small) - 4, height), "white")
    left = 0
    for image in small:
        strip.paste(image, (left, 0))
        left += image.width + 4
    return strip


def digits(value: Any, places: int = 3) -> str:
    """A number as a table shows it; what is not known is left empty."""
    return "" if value is None else f"{value:.{places}f}"


def percent(value: Any, places: int = 2) -> str:
    """A share as a table shows it."""
    return "" if value is None else f"{100 * value:.{places}f} %"
