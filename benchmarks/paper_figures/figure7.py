"""Figure 7 and the text: content kept, discoloration, frames a second, times."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numba
import torch
from bench import machine, processor_ms

from paper_figures import figure1, segmenting
from paper_figures.book import Cell, Outcome, Results
from paper_figures.figure2 import WAYS
from paper_figures.story import Block, Figure, Table, Text, digits, percent
from paper_figures.subject import Subject, shot

NAME = "figure7"
CLAIM = (
    "S2RF discolours other things than the target and loses shapes; on an A100 it renders 15 "
    "frames a second and StyleSplat more than 100; stylising takes less than a minute, after "
    "30,000 steps of training."
)
FAST = "more than 100 a second"
SIDES = (None, 960)  # pixels of the longer side; None is as it was trained


def cells(subject: Subject) -> list[Cell]:
    """Rendering and what the scene says of its photos; the rest is other figures'."""
    return [Cell(NAME, "speed", partial(_speed, subject))]


def _speed(subject: Subject) -> Outcome:
    camera = subject.held_out[0]
    numbers: dict[str, Any] = {"machine": machine(), "gaussians": len(subject.splats), "fps": {}}
    for side in SIDES:
        sized = camera if side is None else camera.downscale(max(camera.size) / side)
        shot(subject.splats, sized)  # warm
        with one_thread():
            milliseconds = processor_ms(lambda sized=sized: shot(subject.splats, sized), repeats=9)
        width, height = sized.size
        numbers["fps"][f"{width}x{height}"] = 1e3 / milliseconds
    trained = subject.scene.metrics.get("train", subject.scene.metrics)
    names = ("psnr", "ssim", "steps")
    return Outcome(numbers | {f"train_{n}": trained.get(n) for n in names})


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one core, whose own time other work beside it hardly lengthens."""
    numba_threads, torch_threads = numba.get_num_threads(), torch.get_num_threads()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(numba_threads)
        torch.set_num_threads(torch_threads)


def told(results: Results) -> list[Block]:
    """Times and rates; content and discoloration of the masked loss and of ours."""
    found = results.get(NAME, {})
    if "speed" not in found:
        return []
    n = found["speed"].numbers
    rows = [
        [f"frames, {size}", f"{digits(fps, 1)} a second of one core", FAST]
        for size, fps in n["fps"].items()
    ]
    rows += [
        ["Gaussians", f"{n['gaussians']:,}", ""],
        ["held-out PSNR, SSIM", f"{digits(n['train_psnr'], 2)} dB, {digits(n['train_ssim'])}", ""],
        *_times(results),
    ]
    heads = ("what", f"on {n['machine']}", "the paper, on an A100")
    blocks: list[Block] = [Table(heads, rows)]
    other = results.get("figure2", {})
    compared = [key for key in (f"{way} at 1" for way in WAYS) if key in other]
    if compared:
        heads = ("loss", "content SSIM", "strength (Lab)", "outside PSNR", "changed outside")
        lines = [
            [
                key,
                digits(other[key].numbers["content_ssim"]),
                digits(other[key].numbers["strength"], 1),
                f"{digits(other[key].numbers['outside_psnr'], 1)} dB",
                percent(other[key].numbers["changed_outside"]),
            ]
            for key in compared
        ]
        blocks.append(Table(heads, lines))
    blocks.append(
        Text(
            "We did not run S2RF, and used no GPU: the loss in 2D is S2RF's, the scene is a splat."
        )
    )
    return blocks


def _times(results: Results) -> list[list[str]]:
    """What other figures took, of one core: other work beside them does not count."""
    trained = [
        [f"training, {name}", _said(n["training"] + n["lifting"], n["steps"]), "30,000 steps"]
        for name, n in _numbers(results, segmenting.NAME, (segmenting.JOINT, segmenting.LIFTED))
    ]
    painted = [
        [f"painting, {name}", _said(n["painting"]), "less than a minute"]
        for name, n in _numbers(results, figure1.NAME, results.get(figure1.NAME, {}))
        if "painting" in n
    ]
    return [*trained, *painted]


def _said(seconds: float, steps: int | None = None) -> str:
    start = "" if steps is None else f"{steps:,} steps in "
    return f"{start}{seconds:.0f} s of one core"


def _numbers(results: Results, figure: str, keys: Iterable[str]) -> list[tuple[str, Any]]:
    found = results.get(figure, {})
    return [(key, found[key].numbers) for key in keys if key in found]


FIGURE = Figure(NAME, "Figure 7 and the text: content, discoloration, speed", CLAIM, cells, told)
