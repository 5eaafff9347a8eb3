"""The demo's report: one HTML file that holds pictures, video and splat and needs no network."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from stylesplat.evaluation.summary import painted_gaussians, style_lines
from stylesplat.figures.html_page import Figure, Section, file_url, page_style, section_html
from stylesplat.figures.pictures import label_colors
from stylesplat.io.atomic import atomic_path
from stylesplat.io.images import write_image
from stylesplat.io.label_maps import read_label_map
from stylesplat.scene.scene import Scene

TEMPLATE = Path(__file__).with_name("report.html")
REPORT = "report.html"
SHEET = "objects.png"  # in the scene's folder
VIEW = "016"  # the held-out view in the report
CUT = 56  # percent of its width, where a line between vase and teapot hardly cuts either


def write_report(
    output: Path,
    capture: Path,
    scene: Scene,
    styled: Scene,
    *,
    paintings: Mapping[str, Path],
    seconds: float,
) -> None:
    """Write the report of a demo whose other results are in `output` already.

    `paintings` are by object. Raises a StyleSplatError if the file cannot be written.
    """
    sections = _sections(output, capture, paintings, style_lines(styled.metrics, paintings))
    numbers = _numbers(scene.metrics, styled.metrics, paintings, seconds)
    page = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        style=page_style(),
        before=file_url(output / "before" / f"{VIEW}.png"),
        after=file_url(output / "after" / f"{VIEW}.png"),
        cut=CUT,
        sections="\n".join(map(section_html, sections)),
        numbers="\n".join(
            f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
            for name, value in numbers.items()
        ),
    )
    with atomic_path(output / REPORT) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _sections(
    output: Path, capture: Path, paintings: Mapping[str, Path], outcome: Sequence[str]
) -> list[Section]:
    maps = {}
    for folder in (capture / "object_mask", output / "labels"):
        maps[folder.name] = output / f"{folder.name}_colors.png"
        write_image(label_colors(read_label_map(folder / f"{VIEW}.png")), maps[folder.name])
    return [
        Section(
            "1. Photos with label maps",
            "48 photos of a ray-traced still life, and label maps with the mistakes that "
            "segmenters make: ragged borders, lost and merged objects.",
            (
                Figure(capture / "images" / f"{VIEW}.jpg", "one of the photos"),
                Figure(maps["object_mask"], "its label map, with mistakes"),
            ),
        ),
        Section(
            "2. Gaussians that know their object",
            "Training fits 3D Gaussians to the photos, each with 16 numbers that say what object "
            "it belongs to. All views together correct the mistakes of each.",
            (
                Figure(output / "before" / f"{VIEW}.png", "a view that was not trained on"),
                Figure(output / "identities" / f"{VIEW}.png", "the identities, as colours"),
                Figure(maps["labels"], "the label map that they give"),
            ),
        ),
        Section(
            "3. Objects to choose from",
            "stylesplat objects draws this sheet; stylesplat select gives an object a name.",
            (Figure(output / "scene" / SHEET, SHEET),),
        ),
        Section(
            "4. Two styles",
            "The vase and the teapot each take on a painting. Their Gaussians take on other "
            "colours, and small discs laid on them carry the strokes. "
            + " ".join(f"{line[:1].upper()}{line[1:]}" for line in outcome),
            tuple(Figure(path, f"for the {name}") for name, path in paintings.items()),
        ),
        Section(
            "5. The splat itself",
            "Drag to turn it; the handle in the middle lies between before and after. styled.ply "
            "opens in any viewer; styled.html holds the splat and this one, a single file to send.",
            (Figure(output / "styled.html", "styled.html"),),
        ),
        Section("6. All around", "A video of it.", (Figure(output / "orbit.mp4", "orbit.mp4"),)),
    ]


def _numbers(
    trained: Mapping[str, Any],
    styled: Mapping[str, Any],
    objects: Mapping[str, Path],
    seconds: float,
) -> dict[str, str]:
    rows = {
        "Gaussians": f"{trained['gaussians']:,}",
        "held-out PSNR": f"{trained['psnr']:.2f} dB",
        "held-out SSIM": f"{trained['ssim']:.3f}",
        "training": f"{trained['steps']:,} steps in {trained['seconds']:.0f} s",
        "stylisation": f"{styled['seconds']:.0f} s",
        "painted Gaussians": painted_gaussians(dict(styled), trained["gaussians"]),
        "the whole demo": f"{seconds:.0f} s",
    }
    for name in objects:
        before, after = styled["nnfm_before"][name], styled["nnfm_after"][name]
        rows[f"style distance (NNFM), {name}"] = f"{before:.3f} before, {after:.3f} after"
    return rows
