"""How long a training run will take, said before it begins."""

import time
from dataclasses import replace

from stylesplat.progress import say
from stylesplat.scene.capture import Capture
from stylesplat.training.densification import MCMCStrategy
from stylesplat.training.state import Run, State
from stylesplat.training.step import train_step
from stylesplat.training.train_config import TrainConfig

ROUNDS = 10  # of the copy
LEAST = 20  # a run shorter than so many copies gets no estimate, which would cost over 5 %
LONG = 120  # seconds; a run that takes longer is offered a first look
# A first look of the fox, at this length of the photos' longer side, has 31 dB (README, "How fast")
FIRST_LOOK = "--max-seconds 60 --max-gaussians 50000"
FIRST_LOOK_SIZE = 480


def estimate_seconds(run: Run, state: State) -> float:
    """Seconds that a run by steps and `MCMCStrategy` will take, measured on a copy of its state.

    Schedules are shares of the run. So a run of ten rounds has photos as small and as large, and as
    few and as many Gaussians, as the whole run. Reading photos is left out, because the whole run
    reads them once. Densification in each round makes up for Gaussians that have hardly spread: for
    the fox at three sizes the estimate was between 14 % below and 26 % above the time of the CPU.
    """
    config = replace(run.config, steps=ROUNDS * run.batch, refine_every=1, sh_degree_every=None)
    short = replace(run, config=config, strategy=MCMCStrategy(config, run.extent))
    state, seconds = state.clone(), 0.0
    while (progress := short.progress(state)) < 1:
        for row in map(short.row, short.photos(state)):
            short.views(row, config.photo_downscale(progress, run.cameras[row].size))
        start = time.perf_counter()
        state, _ = train_step(short, state)
        state.params["means"][0, 0].item()  # waits for the GPU
        seconds += time.perf_counter() - start
    return seconds * run.config.steps / config.steps


def say_estimate(run: Run, state: State, capture: Capture) -> None:
    """Say in one line how long a run will take, if it is not a short one or limited by time.

    For a long run the line has settings for a first look as well.
    """
    config, ours = run.config, isinstance(run.strategy, MCMCStrategy)
    short = config.steps < LEAST * ROUNDS * run.batch
    if short or config.max_seconds is not None or run.ranks.count > 1 or not ours:
        return
    seconds = estimate_seconds(run, state)
    width, height = max((run.cameras[row].size for row in run.rows), key=max)
    quality = advice = ""
    if config.steps < TrainConfig.steps:
        quality = f" Fewer than {TrainConfig.steps:,} steps leave pictures softer."
    if seconds > LONG:
        factor = round(max(width, height) / FIRST_LOOK_SIZE) * capture.downscale
        smaller = f" --downscale {factor:g}" if factor > capture.downscale else ""
        advice = f" `{FIRST_LOOK}{smaller}` gives a first look."
    say(
        f"{len(run.rows)} photos of {width}x{height}, at most {config.max_gaussians:,} Gaussians: "
        f"{config.steps:,} steps take about {_duration(seconds)} on this machine.{quality}{advice}"
    )


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
