"""The paper's figures and claims, remade on scenes that anybody can get, with numbers.

    .venv/bin/python benchmarks/paper.py -o DIR [--scene demo SCENE ...] [--quick]

For each scene (`demo`, which is made here, or the folder of one that `stylesplat train` made) the
figures of the paper: in its form, with measurements that it does not give. What is computed is
kept in DIR, a file for each part; the same command goes on where it stopped. It ends with a page,
DIR/index.html, and with DIR/paper.md and its pictures; `--docs docs` writes these two
there as well.
"""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import torch
import tyro
from bench import machine
from paper_figures import figure1, figure2, figure3, figure5, figure6, figure7, official, segmenting
from paper_figures.book import Book, work_through
from paper_figures.story import Chapters, html_page, markdown_page
from paper_figures.subject import FULL, QUICK, open_subject

from stylesplat.io.files import atomic_path

FIGURES = {
    module.NAME: module.FIGURE
    for module in (figure2, figure3, segmenting, figure5, figure6, figure1, figure7, official)
}
TITLE = "The paper, remade"


@dataclass(frozen=True)
class Options:
    """What to make."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder of all that is made."""
    scene: tuple[str, ...] = ("demo",)
    """`demo`, or folders of trained scenes with objects."""
    quick: bool = False
    """Few steps, small frames, no training but the demo's own."""
    figures: tuple[str, ...] = tuple(FIGURES)
    """Which ones."""
    features: Literal["compact", "vgg19"] = "compact"
    """The network whose features are matched; vgg19 is the development copy of its weights."""
    docs: Path | None = None
    """A folder that gets paper.md and the pictures too."""
    only_page: bool = False
    """Compute nothing; write the page of what is there."""


def main(options: Options) -> None:
    """Compute, then tell."""
    unknown = [name for name in options.figures if name not in FIGURES]
    if unknown:
        raise SystemExit(f"There is no {unknown[0]}. Figures: {', '.join(FIGURES)}.")
    effort = QUICK if options.quick else FULL
    options.output.mkdir(parents=True, exist_ok=True)
    start, chapters, spent, bare = time.perf_counter(), [], 0.0, []
    for given in options.scene:
        subject = open_subject(given, options.output, effort, options.features)
        settings = {"quick": options.quick, "features": options.features}
        book = Book(options.output / subject.name, settings)
        figures = [FIGURES[name] for name in options.figures]
        cells = [cell for figure in figures for cell in figure.cells(subject)]
        if not options.only_page:
            for line in work_through(book, cells):
                print(f"[{time.perf_counter() - start:5.0f} s] {subject.name}: {line}", flush=True)
        results = book.results(cells)
        spent += sum(r.seconds for several in results.values() for r in several.values())
        chapters.append(
            (subject.name, [(f, f.told(results)) for f in sorted(figures, key=lambda f: f.name)])
        )
        if subject.exact is None:
            bare.append(f"{subject.name} has no exact label maps: given ones count as true there.")
        _write(options, [*_intro(options, spent), *bare], chapters)
    print(options.output / "index.html")


def _intro(options: Options, seconds: float) -> list[str]:
    """What was run, and on what."""
    effort = QUICK if options.quick else FULL
    call = f"benchmarks/paper.py -o DIR --scene {' '.join(options.scene)}"
    call += f" --features {options.features}" + " --quick" * options.quick
    ours = "the default" if effort.trained else "drafts (`--quality draft`)"
    return [
        f"Made by `{call}` in {seconds / 60:.0f} minutes, the demo's training aside, on "
        f"{machine()}, torch {torch.__version__}. All numbers and pictures come from files that it "
        "wrote.",
        f"Paintings by the paper's settings take {effort.steps} steps (the paper: 500 to 1,000), "
        f"ours are {ours}. Figure 2's loops take {effort.masked_steps} steps, and like Figure 6 "
        f"frames of {effort.side} pixels. All is judged in {effort.judged} held-out views at most. "
        "A pixel has changed if a channel differs by more than 0.05; strength is the mean distance "
        "of the object's colours in Lab; a stroke is as long as the distance at which the added "
        "detail goes half with itself.",
        "Not run: the scenes of NeRF, MipNeRF360 and LERF, which are not on the machines that "
        "build this. Train one with `stylesplat train CAPTURE -o SCENE` and pass `--scene SCENE`.",
    ]


def _write(options: Options, intro: Sequence[str], chapters: Chapters) -> None:
    """The page, and the Markdown with its pictures."""
    told = [
        (scene, [(f, blocks) for f, blocks in figures if blocks]) for scene, figures in chapters
    ]
    _put(options.output / "index.html", html_page(TITLE, intro, told))
    for folder in filter(None, (options.output, options.docs)):
        shutil.rmtree(folder / "paper", ignore_errors=True)
        _put(folder / "paper.md", markdown_page(TITLE, intro, told, folder / "paper"))


def _put(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
