"""Does training use every core?

    .venv/bin/python benchmarks/cores.py                    # fox, 270x480, 50,000 Gaussians

Photos looked at per second at the end of a training, with identities in every second round: by one
thread; by all, one photo or several at a time; and by as many processes that have nothing to do
with each other, which is all that the machine can do while it runs. The ways take turns,
`--repeats` times; numbers are medians.
"""

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numba
import torch
import tyro
from bench import capture, machine, table

from stylesplat.rendering.view_pool import RenderPool
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.config import TrainConfig
from stylesplat.training.densification import MCMCStrategy
from stylesplat.training.loop import fit
from stylesplat.training.state import State, TrainingRun
from stylesplat.training.step import train_step
from stylesplat.training.views import TrainingViews, split_views

CPU = torch.device("cpu")
FIRST, PHOTOS = 8, 60  # photos that are not counted, and that are


@dataclass(frozen=True)
class Options:
    """What to train."""

    scene: str = "fox"
    """Folder in `../shared/data`."""
    downscale: float = 2
    """How many times smaller the photos shall be."""
    max_gaussians: int = 50_000
    """Gaussians."""
    steps: int = 2000
    """Of the training before anything is measured."""
    repeats: int = 3
    """Turns."""
    state: Path | None = None
    """For a process that is measured: what it trains on from."""
    threads: int = 1
    """Of such a process."""
    batch: int = 1
    """Photos that it looks at together."""


class Way(NamedTuple):
    """How a machine may be used."""

    name: str
    threads: int
    batch: int
    processes: int = 1


def config_of(options: Options, steps: int) -> TrainConfig:
    """Settings of the training, and of what goes on from there."""
    return TrainConfig(steps=steps, max_gaussians=options.max_gaussians, color_correction="off")


def ways() -> list[Way]:
    """Those of this machine."""
    cores = numba.get_num_threads()
    return [
        Way("one thread", 1, 1),
        *(Way(f"{cores} threads, {each} at a time", cores, each) for each in (1, 2, 4)),
        Way(f"{cores} processes apart", 1, 1, cores),
    ]


def measured(options: Options, way: Way, state: Path) -> float:
    """Photos a second of all processes."""
    command = [sys.executable, __file__, "--state", str(state), "--scene", options.scene]
    command += ["--downscale", str(options.downscale), "--threads", str(way.threads)]
    command += ["--batch", str(way.batch), "--max-gaussians", str(options.max_gaussians)]
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        for _ in range(way.processes)
    ]
    return sum(json.loads(each.communicate()[0].split(b"\n")[0]) for each in started)


def rate(options: Options, state: State) -> float:
    """Photos a second of this process."""
    numba.set_num_threads(options.threads)
    torch.set_num_threads(options.threads)
    photos = capture(options.scene, options.downscale, identities=True)
    rows, _ = split_views(photos, 8)
    views = TrainingViews(photos, rows, ids=state.ids, device=CPU, max_memory=1.0)
    config, extent = config_of(options, 5000), scene_extent(photos.cameras)
    pool, batch = RenderPool(options.batch), options.batch
    strategy = MCMCStrategy(config, extent)
    run = TrainingRun(
        config, tuple(rows), views, photos.cameras, extent, CPU, strategy, batch, pool
    )
    state = advanced(run, replace(state, step=4000), FIRST)  # late: photos are whole
    first, start = state.step, time.perf_counter()
    state = advanced(run, state, PHOTOS)
    seconds = time.perf_counter() - start
    pool.end()
    return (state.step - first) / seconds


def advanced(run: TrainingRun, state: State, photos: int) -> State:
    """The state after so many photos, or a few more."""
    end = state.step + photos
    while state.step < end:
        state, _ = train_step(run, state)
    return state


def main(options: Options) -> None:
    """Print a row for each way."""
    if options.state is not None:
        found = rate(options, torch.load(options.state, weights_only=False))
        print(json.dumps(found), flush=True)
        return
    print(machine())
    photos = capture(options.scene, options.downscale, identities=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.pt"
        torch.save(fit(photos, config_of(options, options.steps)), path)
        found = [[measured(options, way, path) for way in ways()] for _ in range(options.repeats)]
    medians = [median(each) for each in zip(*found, strict=True)]
    rows = [
        [way.name, f"{each:.1f}", f"{each / medians[0]:.2f}", f"{each / medians[-1]:.2f}"]
        for way, each in zip(ways(), medians, strict=True)
    ]
    print(table(["how", "photos a second", "times one thread", "of the machine"], rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
