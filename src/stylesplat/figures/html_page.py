"""HTML pages: pictures, videos, tables, sections, and the page that compares scenes."""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from jaxtyping import UInt8
from torch import Tensor

from stylesplat.evaluation.summary import flat
from stylesplat.io.images import jpeg
from stylesplat.scene.scene import Scene

STYLE = Path(__file__).with_name("page_style.css")
MIME = {".png": "image/png", ".jpg": "image/jpeg", ".mp4": "video/mp4"}
HTML_TEMPLATE = Path(__file__).with_name("comparison_page.html")


@dataclass(frozen=True)
class Figure:
    """A picture, a video or a page with a splat, with a caption."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Section:
    title: str
    text: str
    figures: tuple[Figure, ...] = ()


def page_style() -> str:
    return STYLE.read_text(encoding="utf-8")


def section_html(section: Section) -> str:
    """A section that contains the files of its figures."""
    figures = "\n".join(map(_figure, section.figures))
    return (
        f"<section><h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>"
        f'<div class="row">{figures}</div></section>'
    )


def figure_html(url: str, caption: str) -> str:
    caption = escape(caption)
    return f'<figure><img src="{url}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'


def table_html(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column has the names of the rows."""
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    lines = [
        f"<tr><th>{escape(first)}</th>" + "".join(f"<td>{escape(c)}</td>" for c in rest) + "</tr>"
        for first, *rest in rows
    ]
    return "\n".join(("<table>", f"<tr>{top}</tr>", *lines, "</table>"))


def file_url(path: Path) -> str:
    return data_url(path.read_bytes(), path.suffix)


def picture_url(picture: UInt8[Tensor, "H W 3"]) -> str:
    return data_url(jpeg(picture.cpu().numpy()), ".jpg")


def _figure(figure: Figure) -> str:
    caption = escape(figure.caption)
    if figure.path.suffix == ".html":
        page = escape(figure.path.read_text(encoding="utf-8"))
        media = f'<iframe srcdoc="{page}" title="{caption}" loading="lazy"></iframe>'
    elif figure.path.suffix == ".mp4":
        source = file_url(figure.path)
        media = f'<video src="{source}" autoplay loop muted playsinline controls></video>'
    else:
        return figure_html(file_url(figure.path), figure.caption)
    return f"<figure>{media}<figcaption>{caption}</figcaption></figure>"


def data_url(content: bytes, suffix: str) -> str:
    return f"data:{MIME[suffix]};base64,{b64encode(content).decode()}"


@dataclass(frozen=True, eq=False)
class SceneColumn:
    """One scene among others, with its pictures and numbers."""

    name: str
    scene: Scene
    metrics: Mapping[str, Any]
    """The result of `evaluate`; empty if nothing could be measured."""
    differences: Mapping[str, Any]
    """The same numbers minus those of the first scene, where both have them."""
    from_first: Mapping[str, float]
    """How much its pictures differ from those of the first scene (`picture_differences`)."""
    pictures: tuple[UInt8[Tensor, "_ _ 3"], ...]


def comparison_page(
    columns: Sequence[SceneColumn], views: Sequence[str], *, title: str, notes: Sequence[str] = ()
) -> str:
    """An HTML page that compares scenes with the first of them, and needs no other file.

    `views` are the names of the views, in the order of the scenes' pictures; `notes` are sentences
    above the pictures.
    """
    heads = ["", *(column.name for column in columns)]
    rows = []
    for row, view in enumerate(views):
        pictures = (
            figure_html(picture_url(column.pictures[row]), f"{column.name}, {view}")
            for column in columns
        )
        rows.append(f'<div class="wide"><div class="row">{"".join(pictures)}</div></div>')
    gaps = dict.fromkeys(name for column in columns for name in column.from_first)
    gap_rows = [[gap, *(_cell(c.from_first.get(gap), None) for c in columns)] for gap in gaps]
    return Template(HTML_TEMPLATE.read_text(encoding="utf-8")).substitute(
        style=page_style(),
        title=escape(title),
        first=escape(columns[0].name),
        about=escape(", ".join(heads[1:])) + " in the same views.",
        notes="\n".join(f"<p>{escape(note)}</p>" for note in notes),
        pictures="\n".join(rows),
        numbers=table_html(heads, _number_rows(columns)),
        gaps=table_html(heads, gap_rows),
    )


def _number_rows(columns: Sequence[SceneColumn]) -> list[list[str]]:
    """A row per number that any scene has: its name, and each scene's value and difference."""
    values = [dict(flat(column.metrics)) for column in columns]
    gaps = [{}, *(dict(flat(column.differences)) for column in columns[1:])]
    return [
        [name, *(_cell(v.get(name), g.get(name)) for v, g in zip(values, gaps, strict=True))]
        for name in dict.fromkeys(name for each in values for name in each)
    ]


def _cell(value: float | None, gap: float | None) -> str:
    if value is None:
        return ""
    shown = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
    return shown if gap is None else f"{shown} ({gap:+.3g})"
