"""Held-out quality at fixed training times: by default, and joint with identities.

    .venv/bin/python benchmarks/training.py                     # fox, 270x480, 60 s and 150 s
    .venv/bin/python benchmarks/training.py --scene desk --downscale 1

The clock counts training steps; compiling, reading photos and evaluating do not count. Every 8th
view is held out, and never trained on. By default colours are trained alone, and labels lifted onto
what comes of it, which changes no colour: that time is told apart.
"""

from dataclasses import dataclass, replace
from time import perf_counter

import tyro
from bench import calibration_ms, capture, machine, table

from stylesplat.evaluation.photos import evaluate_views
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.training.config import TrainConfig
from stylesplat.training.lifting import lift
from stylesplat.training.loop import fit
from stylesplat.training.state import State
from stylesplat.training.views import split_views


@dataclass(frozen=True)
class Options:
    """What to train."""

    scene: str = "fox"
    """Folder in `../shared/data`."""
    downscale: float = 2
    """How many times smaller the photos shall be."""
    seconds: tuple[float, ...] = (60, 150)
    """Training time of each run without identities."""
    joint_factor: float = 1.6
    """Training time of the run with identities over that without; 0 leaves it out."""
    max_gaussians: int = 50_000
    """Gaussians at most."""
    seed: int = 0
    """Seed of everything random."""


def curve(options: Options, seconds: float, *, identities: bool) -> list[list[object]]:
    """Train once; a row of the table at half and at the end of the time."""
    photos = capture(options.scene, options.downscale, identities=identities)
    config = TrainConfig(
        max_seconds=seconds, max_gaussians=options.max_gaussians, seed=options.seed
    )
    rows: list[list[object]] = []
    marks = [seconds / 2, seconds]
    started = perf_counter()

    def report(state: State, loss: float, train_psnr: float) -> None:
        if marks and state.seconds >= marks[0]:
            marks.pop(0)
            rows.append([name, f"{seconds:.0f} s", *_measure(state, photos, config.test_every)])

    name = "joint" if identities else "default"
    splats = fit(photos, config, on_progress=report).splats.detach()
    print(f"{name} {seconds:.0f} s took {perf_counter() - started:.0f} s in all", flush=True)
    if not identities:
        _lift(options, splats, config.test_every)
    return rows


def _lift(options: Options, splats: Splats, test_every: int) -> None:
    photos = capture(options.scene, options.downscale)
    if photos.label_maps is not None:
        started = perf_counter()
        lift(splats, photos, rows=split_views(photos, test_every)[0])
        print(f"its labels lifted in {perf_counter() - started:.1f} s", flush=True)


def _measure(state: State, photos: Capture, test_every: int) -> list[object]:
    _, held_out = split_views(photos, test_every)
    views = replace(photos, label_maps=None)
    quality = evaluate_views(state.splats.detach(), views, held_out)["psnr"]
    count = len(state.params["means"])
    return [f"{state.seconds:.0f} s", state.step, f"{count:,}", f"{quality:.2f} dB"]


def main(options: Options) -> None:
    """Print the curve."""
    width, height = capture(options.scene, options.downscale).cameras[0].size
    print(f"{options.scene} {width}x{height}, {machine()}")
    rows = []
    for seconds in options.seconds:
        before = calibration_ms()
        rows += curve(options, seconds, identities=False)
        if options.joint_factor > 0:
            rows += curve(options, options.joint_factor * seconds, identities=True)
        print(f"calibration loop: {before:.0f} ms before, {calibration_ms():.0f} ms after")
    print(table(["run", "budget", "at", "steps", "Gaussians", "held-out PSNR"], rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
