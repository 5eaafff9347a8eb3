"""The paper's figures and claims, remade on scenes that anybody can get, with numbers.

    .venv/bin/python benchmarks/paper.py -o DIR [--scene demo SCENE ...] [--effort EFFORT]

For each scene (`demo`, which is made here, or the folder of one that `stylesplat train` made) the
figures of the paper: in its form, with measurements that it does not give. What is computed is
kept in DIR, a file for each part; the same command goes on where it stopped. It ends with a page,
DIR/paper.md, and its pictures; `--docs docs` writes these there as well.
"""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro
from paper_figures import figure1, figure2, figure3, figure5, figure6, figure7, official, segmenting
from paper_figures.book import Book, work_through
from paper_figures.foreword import Run, appendix, foreword
from paper_figures.story import Figure, markdown_page
from paper_figures.subject import EFFORTS, open_subject

from stylesplat.io.atomic import atomic_path

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
    effort: Literal["quick", "medium", "full"] = "medium"
    """quick takes 60 steps, and makes our own paintings as drafts; medium 100, and makes ours as
    users get them; full the paper's 500 on larger frames, all of Figure 6, and trains anew for each
    set of label maps."""
    whole_grid: bool = False
    """All of Figure 6's settings also where the effort takes the lines through its middle."""
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
    options.output.mkdir(parents=True, exist_ok=True)
    figures = [FIGURES[name] for name in options.figures]
    runs = []
    for given in options.scene:
        run = _opened(given, options, figures)
        if not options.only_page:
            _compute(run)
        runs.append(run)
        _write(options, sorted(figures, key=lambda figure: figure.name), runs)
    print(options.output / "paper.md")


def _opened(given: str, options: Options, figures: Sequence[Figure]) -> Run:
    """A scene with what is computed of it, or will be."""
    folder = options.output / (given if given == "demo" else Path(given).name)
    settings = {"effort": options.effort, "features": options.features}
    book = Book(folder, None if options.only_page else settings)
    effort = EFFORTS[book.settings["effort"]]
    effort = replace(effort, whole_grid=effort.whole_grid or options.whole_grid)
    subject = open_subject(given, options.output, effort, book.settings["features"])
    every = replace(subject, effort=replace(effort, whole_grid=True))  # some may be there already
    asked = {cell.name for figure in figures for cell in figure.cells(subject)}
    cells = [cell for figure in figures for cell in figure.cells(every)]
    return Run(subject, book, [cell for cell in cells if cell.name in asked or book.has(cell)])


def _compute(run: Run) -> None:
    start = time.perf_counter()
    for line in work_through(run.book, run.cells):
        print(f"[{time.perf_counter() - start:5.0f} s] {run.subject.name}: {line}", flush=True)


def _write(options: Options, figures: Sequence[Figure], runs: Sequence[Run]) -> None:
    """Write the page and its pictures."""
    chapters = [
        (run.subject.name, [(f, blocks) for f in figures if (blocks := f.told(run.results))])
        for run in runs
    ]
    intro, end = foreword(runs), appendix(runs)
    for folder in filter(None, (options.output, options.docs)):
        shutil.rmtree(folder / "paper", ignore_errors=True)
        text = markdown_page(TITLE, intro, chapters, folder / "paper", end)
        with atomic_path(folder / "paper.md") as temporary:
            temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
