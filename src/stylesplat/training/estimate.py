"""How long a training run will take, said before it begins."""

import time
from dataclasses import replace

from stylesplat.errors import counted
from stylesplat.progress import say
from stylesplat.scene.capture import Capture
from stylesplat.training.densification import MCMCStrategy
from stylesplat.training.state import Run, State
from stylesplat.training.step import train_step
from stylesplat.training.train_config import TrainConfig

ROUNDS = 10  # of the copy
LEAST = 20  # a run shorter than so many copies gets no estimate, which would cost over 10 %
LONG = 120  # seconds; a run that takes longer is offered a first look
# A first look of the fox, at this length of the photos' longer side, has 31 dB (README, "How fast")
FIRST_LOOK = "--max-seconds 60 --max-gaussians 50000"
FIRST_LOOK_SIZE = 480


def estimate_seconds(run: Run, state: State) -> float:
    """Seconds that a run by steps and `MCMCStrategy` will take, measured on a copy of its state.

    Schedules are shares of the run. So a run of ten rounds has photos as small and as large, and as
    few and as many Gaussians, as the whole run. Each round is taken twice: first to read its photos
    and to add Gaussians, which the whole run does more seldom, then to measure the rest.
    For the fox, in processor time, this was up to 36 % too short, most at 540x960 in 500 steps.
    """
    config = replace(run.config, steps=ROUNDS * run.batch, refine_every=1, sh_degree_every=None)
    constant = replace(config, refine_every=config.steps + 1)
    growing, timed = (
        replace(run, config=each, strategy=MCMCStrategy(each, run.extent))
        for each in (config, constant)
    )
    seconds = 0.0
    while growing.progress(state) < 1:
        grown, _ = train_step(growing, state.clone())
        again, start = state.clone(), time.perf_counter()
        train_step(timed, again)
        again.params["means"][0, 0].item()  # waits for the GPU
        seconds += time.perf_counter() - start
        state = grown
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
    photos = f"{counted(len(run.rows), 'photo')} of {width}x{height}"
    say(
        f"{photos}, at most {config.max_gaussians:,} Gaussians: {config.steps:,} steps take "
        f"about {_duration(seconds)} on this machine.{quality}{advice}"
    )


def _duration(seconds: float) -> str:
    if seconds < 180:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
