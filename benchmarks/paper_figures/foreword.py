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
    "This page tests the claims of the StyleSplat paper (Jain et al. 2024) on our own scenes, with "
    "numbers that the paper does not give, and makes its figures again. The appendices list the "
    "numbers for each claim and say how everything was made. The [glossary](glossary.md) explains "
    "*identity*, *label map* and *lift*."
)
DEFINED = (
    "A pixel counts as changed if a channel differs by more than 0.05. Strength is the mean "
    "distance in Lab between the object's colours before and after. The length of a stroke is the "
    "distance at which the autocorrelation of the added detail falls to a half. We do not measure "
    "LPIPS, because neither this package nor its requirements ship the weights."
)
NOT_RUN = (
    "We did not test on the scenes of NeRF, MipNeRF360 and LERF, which the machines that build "
    "this page do not have. We did not run S2RF, and had no A100. To add a scene, train it with "
    "`stylesplat train CAPTURE -o SCENE` and pass `--scene SCENE`."
)

CREDITS = (
    "The photos of fox are instant-ngp's (NVIDIA Source Code License, for non-commercial use "
    "only); those of desk come from a public repository that states no licence for them. Neither "
    "ships with the package: do not use their pictures commercially."
)
RELATED = (
    "Four methods are closest to ours. Instant Colorization of Gaussian Splats ([arXiv "
    "2604.17155](https://arxiv.org/abs/2604.17155)) solves a least-squares problem for each "
    "Gaussian; we lift labels by the adjoint of rendering. SGSST ([arXiv "
    "2412.03371](https://arxiv.org/abs/2412.03371)) matches statistics at several scales at once; "
    "we match neighbours, from coarse to fine. SceneStyler ([arXiv "
    "2606.26754](https://arxiv.org/abs/2606.26754)) balances matches by optimal transport; we "
    "balance kinds of strokes. Style Brush ([arXiv "
    "2510.03433](https://arxiv.org/abs/2510.03433)) paints meshes along contours that the user "
    "draws; our discs turn along the strokes that appear. We ran none of them: [Beside other "
    "methods](related.md) compares what they do."
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
        "`benchmarks/paper.py -o DIR --scene SCENE --effort EFFORT` made this page, with the "
        f"efforts below, on {where}, torch {torch.__version__}. All numbers and pictures come from "
        "files that it wrote.",
        *(f"{name} has no exact label maps, so given ones count as the truth." for name in bare),
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
    ours = f"the default settings, those of {', '.join(drafts)} drafts' (`--quality draft`)"
    return (
        "Painting steps are those of paintings with the paper's settings (the paper takes 500 to "
        f"1,000). Our own paintings have {ours if drafts else 'the default settings'}. The column "
        "*frames* gives the longest side of the pictures on which Figures 2 and 6 optimise. Figure "
        "6 matches at most 4,096 style features, chosen at random."
    )
