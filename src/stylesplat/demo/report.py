"""The demo's report: one HTML file that holds pictures, video and splat and needs no network."""

from html import escape
from pathlib import Path
from string import Template

from stylesplat.figures.html_page import Section, file_url, page_style, section_html
from stylesplat.io.atomic import atomic_path

TEMPLATE = Path(__file__).with_name("report.html")


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
        style=page_style(),
        before=file_url(before),
        after=file_url(after),
        cut=f"{100 * cut:.0f}",
        sections="\n".join(map(section_html, sections)),
        numbers="\n".join(rows),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
