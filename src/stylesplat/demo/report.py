"""The demo's report: one HTML file that holds pictures, video and splat and needs no network."""

from base64 import b64encode
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template

from stylesplat.io.files import atomic_path

TEMPLATE = Path(__file__).with_name("report.html")
MIME = {".png": "image/png", ".jpg": "image/jpeg", ".mp4": "video/mp4"}


@dataclass(frozen=True)
class Figure:
    """A picture, a video or a page with a splat, with a caption."""

    path: Path
    """The file."""
    caption: str
    """What it shows."""


@dataclass(frozen=True)
class Section:
    """A heading, a paragraph and figures side by side."""

    title: str
    """The heading."""
    text: str
    """What happens here."""
    figures: tuple[Figure, ...] = ()
    """Pictures, left to right."""


def write_report(
    path: Path,
    *,
    before: Path,
    after: Path,
    cut: float,
    sections: tuple[Section, ...],
    numbers: dict[str, str],
) -> None:
    """Write the report.

    Args:
        path: The HTML file to make.
        before: A view of the scene as it was.
        after: The same view, styled; a slider lies between the two.
        cut: Where the slider is at first, 0 to 1 from left to right.
        sections: The story, in order.
        numbers: A table of what was measured.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    rows = (f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in numbers.items())
    page = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        before=_embed(before),
        after=_embed(after),
        cut=f"{100 * cut:.0f}",
        sections="\n".join(_section(section) for section in sections),
        numbers="\n".join(rows),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _section(section: Section) -> str:
    figures = "\n".join(_figure(figure) for figure in section.figures)
    return (
        f"<section><h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>"
        f'<div class="row">{figures}</div></section>'
    )


def _figure(figure: Figure) -> str:
    caption = escape(figure.caption)
    if figure.path.suffix == ".html":
        page = escape(figure.path.read_text(encoding="utf-8"))
        media = f'<iframe srcdoc="{page}" title="{caption}" loading="lazy"></iframe>'
    elif figure.path.suffix == ".mp4":
        source = _embed(figure.path)
        media = f'<video src="{source}" autoplay loop muted playsinline controls></video>'
    else:
        media = f'<img src="{_embed(figure.path)}" alt="{caption}">'
    return f"<figure>{media}<figcaption>{caption}</figcaption></figure>"


def _embed(path: Path) -> str:
    return f"data:{MIME[path.suffix]};base64,{b64encode(path.read_bytes()).decode()}"
