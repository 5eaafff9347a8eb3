"""What our HTML pages are made of: pictures, videos and splats within, tables, one look."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO
from pathlib import Path

from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

STYLE = Path(__file__).with_name("page_style.css")
MIME = {".png": "image/png", ".jpg": "image/jpeg", ".mp4": "video/mp4"}
QUALITY = 90  # of JPEG: pictures to look at, not to measure


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


def page_style() -> str:
    """What all pages look like, as CSS."""
    return STYLE.read_text(encoding="utf-8")


def section_html(section: Section) -> str:
    """A section; its figures' files are within."""
    figures = "\n".join(map(_figure, section.figures))
    return (
        f"<section><h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>"
        f'<div class="row">{figures}</div></section>'
    )


def figure_html(url: str, caption: str) -> str:
    """A picture with a caption."""
    caption = escape(caption)
    return f'<figure><img src="{url}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'


def table_html(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column says what the others are."""
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    lines = [
        f"<tr><th>{escape(first)}</th>" + "".join(f"<td>{escape(c)}</td>" for c in rest) + "</tr>"
        for first, *rest in rows
    ]
    return "\n".join(("<table>", f"<tr>{top}</tr>", *lines, "</table>"))


def file_url(path: Path) -> str:
    """A picture's or video's file as a URL that holds it."""
    return _url(path.read_bytes(), path.suffix)


def picture_url(picture: UInt8[Tensor, "H W 3"]) -> str:
    """A picture as a URL that holds it, as JPEG."""
    content = BytesIO()
    Image.fromarray(picture.cpu().numpy()).save(content, "JPEG", quality=QUALITY)
    return _url(content.getvalue(), ".jpg")


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


def _url(content: bytes, suffix: str) -> str:
    return f"data:{MIME[suffix]};base64,{b64encode(content).decode()}"
