"""Figures of the README: those that a benchmark wrote, rounded, as its file or table has them."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
FOX = json.loads((ROOT / "benchmarks/fox_painting.json").read_text())
CANVAS = FOX["changed_gaussians"] - FOX["painted_gaussians"]


def numbers(text: str) -> list[float]:
    return [float(each.replace(",", "")) for each in re.findall(r"\d[\d,]*(?:\.\d+)?", text)]


def told(pattern: str) -> list[float]:
    """The numbers of a sentence of the README, which says them once."""
    (found,) = re.findall(pattern, README)
    return numbers(found)


def row(page: str, begins: str) -> str:
    """What follows the first cell in the only row of a table that begins so."""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    (found,) = [line for line in lines if line.startswith(f"| {begins}")]
    return found.removeprefix(f"| {begins}")


def is_rounded(stated: float, measured: float) -> bool:
    """Whether a number is another one, with fewer digits."""
    digits = len(f"{stated:g}".partition(".")[2])
    return round(measured, digits) == stated


@pytest.mark.parametrize(
    ("pattern", "begins"),
    [
        (r"fox, 270x480, 50,000 Gaussians \| [^|]* \| ([^|]*)", "the default, labels"),
        (r"\(`--segment joint`\) \| [^|]* \| ([^|]*)", "`--segment joint`"),
    ],
)
def test_training(pattern: str, begins: str):
    cells = row("benchmarks/README.md", begins).split("|")
    measured = [numbers(cell)[0] for cell in cells if " dB " in cell]
    for stated, measured_one in zip(told(pattern), measured, strict=True):
        assert is_rounded(stated, measured_one)


def test_painting():
    thousands = told(r"fox \(([\d,]+) of 100,000 Gaussians and a canvas of [\d,]+")
    assert thousands == [round(FOX["painted_gaussians"], -3)]
    assert told(r"a canvas of ([\d,]+)") == [round(CANVAS / 5000) * 5000]
    assert told(r"takes (\d+) processor seconds") == [round(FOX["processor_seconds"])]
    assert "No pixel outside the fox differs" in README
    assert FOX["outside_max_difference"] == 0 and FOX["changed_outside"] == 0
    scale = (ROOT / "docs/scale.md").read_text(encoding="utf-8")
    assert f"10,000 x {round(FOX['processor_seconds'])} s" in scale


@pytest.mark.parametrize(
    ("pattern", "kind"),
    [
        (r"in 2D changes (\d+) %", "2D, pixels masked at 1"),
        (r"in 3D ([\d.]+) %", "3D, lifted at 1"),
    ],
)
def test_leakage(pattern: str, kind: str):
    """In the part of the page that is about the fox."""
    page = (ROOT / "docs/paper.md").read_text(encoding="utf-8")
    part = page[page.index("## Figure 2: leakage (fox)") :]
    (line,) = re.findall(rf"^\| {kind} x the error(.*)$", part[: part.index("\n## ")], re.MULTILINE)
    (stated,) = told(pattern)
    assert is_rounded(stated, numbers(line.split("|")[3])[0])


@pytest.mark.parametrize(
    ("pattern", "begins", "column"),
    [
        (r"7,000 joint steps in (\d+) s", "fox, 7,000 joint steps beside the tests", 2),
        (r"is painted in (\d+) s", "fox, 300 steps of painting, compact, s", 2),
        (r"render at (\d+) frames", "1920x1080, 1 million Gaussians, frames", 2),
        (r"\(gsplat: (\d+)\)", "1920x1080, 1 million Gaussians, frames", 3),
    ],
)
def test_on_a_gpu(pattern: str, begins: str, column: int):
    cells = row("docs/scale.md", begins).split("|")
    assert is_rounded(told(pattern)[0], numbers(cells[column])[0])
