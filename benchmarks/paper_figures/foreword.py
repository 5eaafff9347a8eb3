"""What stands before the figures and after them: each claim, what was run, and the numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from paper_figures import figure6
from paper_figures.book import Book, Cell, Results
from paper_figures.claims import verdicts
from paper_figures.story import Block, Heading, Table, Text
from paper_figures.subject import EFFORTS, Subject

ABOUT = (
    "Which claims of the StyleSplat paper (Jain et al. 2024) hold in our own scenes, by numbers "
    "that it does not give, and its figures made again. The appendices at the end have the "
    "numbers of each claim, and say how all of it was made."
)
DEFINED = (
    "A pixel has changed if a channel differs by more than 0.05; strength is the mean distance of "
    "the object's colours in Lab; a stroke is as long as the distance at which the added detail "
    "goes half with itself. LPIPS is not measured: its weights ship neither with this package nor "
    "with anything that it needs."
)
NOT_RUN = (
    "Not run: the scenes of NeRF, MipNeRF360 and LERF, which are not on the machines that build "
    "this, S2RF itself, and an A100. Train a scene with `stylesplat train CAPTURE -o SCENE` and "
    "pass `--scene SCENE`."
)

CREDITS = (
    "The photos of fox are those of instant-ngp (NVIDIA Source Code License, for non-commercial "
    "use only); those of desk are from a public repository that states no licence for them. "
    "Neither ships with the package: do not use their pictures commercially."
)
RELATED = (
    "Closest to what we compute in closed form are Instant Colorization of Gaussian Splats "
    "(arXiv 2604.17155), which solves a least-squares problem for each Gaussian where we lift "
    "labels by the adjoint of rendering; SGSST (arXiv 2412.03371), which matches statistics at "
    "several scales at once where we match neighbours coarse to fine; SceneStyler (arXiv "
    "2606.26754), which balances matches by optimal transport where we balance kinds of strokes; "
    "and Style Brush (arXiv 2510.03433), which paints meshes along contours that the user draws. "
    "None of them was run here: [beside other methods](related.md) compares what they do."
)


@dataclass(frozen=True)
class Run:
    """A scene and what is computed of it."""

    subject: Subject
    """The scene."""
    book: Book
    """Its results."""
    cells: Sequence[Cell]
    """What there is to compute."""

    @cached_property
    def results(self) -> Results:
        """What is there."""
        return self.book.results(self.cells)

    @property
    def minutes(self) -> float:
        """Of a processor core, for what is there."""
        every = (result for several in self.results.values() for result in several.values())
        return sum(result.processor_seconds for result in every) / 60


def foreword(runs: Sequence[Run]) -> list[Block]:
    """Each claim and whether it holds."""
    words, _ = verdicts(_by_scene(runs))
    related = [Heading("Close to it"), Text(RELATED)]
    return [Text(ABOUT), Heading("What the paper says"), words, *related]


def appendix(runs: Sequence[Run]) -> list[Block]:
    """What was run, and on what; then the numbers of each claim."""
    where = runs[0].book.settings["machine"]
    bare = [run.subject.name for run in runs if run.subject.exact is None]
    lines = [
        "Made by `benchmarks/paper.py -o DIR --scene SCENE --effort EFFORT`, EFFORT as below, on "
        f"{where}, torch {torch.__version__}. All numbers and pictures come from files that it "
        "wrote.",
        *(f"{name} has no exact label maps: given ones count as true there." for name in bare),
    ]
    heads = (
        "scene",
        "effort",
        "painting steps",
        "in Figure 2",
        "frames",
        "views judged",
        "computed",
    )
    heads += ("processor minutes",)
    scenes = ("scene", "photos", "Gaussians", "training steps", "objects")
    _, numbers = verdicts(_by_scene(runs))
    return [
        Heading("Appendix: how this was made"),
        *map(Text, lines),
        Table(scenes, [*map(_trained, runs)]),
        Table(heads, [*map(_made, runs)]),
        *map(Text, (_steps(runs), DEFINED, NOT_RUN, CREDITS)),
        Heading("Appendix: the numbers of each claim"),
        numbers,
    ]


def _by_scene(runs: Sequence[Run]) -> dict[str, Results]:
    return {run.subject.name: run.results for run in runs}


def _trained(run: Run) -> list[str]:
    """What the scene's own files say of its training."""
    scene, (width, height) = run.subject.scene, run.subject.training[0].size
    return [
        run.subject.name,
        f"{width}x{height}"
        + (f", 1/{scene.downscale:g} of their size" if scene.downscale > 1 else ""),
        f"{len(scene.splats):,}",
        f"{scene.metrics['steps']:,}",
        "learned with the colours" if run.subject.joint else "lifted",
    ]


def _made(run: Run) -> list[str]:
    """How much of what was computed."""
    effort, there = run.subject.effort, sum(map(len, run.results.values()))
    name = run.book.settings["effort"]
    more = figure6.has_whole_grid(run.results) and not EFFORTS[name].whole_grid
    return [
        run.subject.name,
        f"{name} --whole-grid" if more else name,
        str(effort.steps),
        str(effort.masked_steps),
        f"{effort.side} px",
        str(len(run.subject.held_out)),
        f"{there} of {len(run.cells)} parts",
        f"{run.minutes:.0f}",
    ]


def _steps(runs: Sequence[Run]) -> str:
    drafts = [run.subject.name for run in runs if run.subject.effort.draft]
    ours = f"the default, drafts (`--quality draft`) for {', '.join(drafts)}"
    return (
        "Paintings by the paper's settings take so many steps (the paper: 500 to 1,000); ours are "
        f"{ours if drafts else 'the default'}. Figure 2's loops and Figure 6 see frames of so many "
        "pixels at most; of more than 4,096 style features Figure 6 matches as many at random."
    )
