"""The training loop: Gaussians, and identities with their classifier where they are learned.

After StyleSplat, section 3.3; by default identities are lifted afterwards (`lifting.py`).
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from statistics import fmean

import torch
import torch.distributed as dist
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, format_duration
from stylesplat.interrupts import held_signals
from stylesplat.progress import Task, say, task, uncounted
from stylesplat.rendering.render import pick_device
from stylesplat.rendering.view_pool import RenderPool
from stylesplat.scene.capture import Capture, fingerprint
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.checkpoint import (
    Checkpoint,
    Checkpointer,
    load_checkpoint,
    require_checkpoint,
)
from stylesplat.training.config import LEVELS, TrainConfig
from stylesplat.training.densification import MCMCStrategy, Strategy, supported_kwargs
from stylesplat.training.initialize import first_splats, with_swept_points
from stylesplat.training.per_photo import initial_photo_params
from stylesplat.training.state import State, TrainingRun, first_state
from stylesplat.training.step import (
    exchange_gradients,
    first_pulled,
    photo_gradients,
    pulls_depths,
    train_step,
)
from stylesplat.training.views import TrainingViews, learned_ids, split_views

MOST_AT_ONCE = 4  # photos of a round on the CPU, unless the settings say otherwise
TRAINING_SMOOTHING = 0.98  # per step, of the loss and PSNR shown: single photos differ a lot
GPU_STEPS = 10  # between reports, each of which waits for the GPU; a CPU has done the step anyway
GPU_SECONDS = 1.0  # but slow steps are reported one by one
TRAINING_PATIENCE = timedelta(days=7)  # for other processes: torchrun ends all when one fails
ESTIMATE_ROUNDS = 10  # that are timed
# A run of fewer than so many times these gets no estimate: each is taken twice, over 10 % of it
ESTIMATE_LEAST = 20
LONG_SECONDS = 120  # a run that takes longer is offered a first look
# A first look of the fox, on photos of 480 pixels, has 31 dB (README, "How fast")
FIRST_LOOK = "--max-seconds 60 --max-gaussians 50000"

Report = Callable[[State, float, float], None]
"""Takes the state, and the means of loss and PSNR since the last report."""


def fit(
    capture: Capture,
    config: TrainConfig,
    *,
    device: torch.device | str = "cpu",
    checkpoint: Path | None = None,
    finish: bool = False,
    on_progress: Report | None = None,
    strategy: Strategy | None = None,
) -> State:
    """Train until the run is over: the functional core of `train`, for programs of your own.

    Follows StyleSplat and Gaussian Grouping, with 3DGS-MCMC densification. Every
    `config.test_every`-th photo is held out. Where photos are transparent, they and the renders
    are compared over random colours or `config.background`. Pixels that the capture's masks leave
    out are not learned from. Label ids that only held-out photos show are not learned.

    Args:
        capture: Photos, and label maps if identities are wanted.
        config: How to train.
        device: Where to train.
        checkpoint: A file to continue from if it exists. Training writes it every minute, when
            interrupted and at the end, and leaves it there. If it cannot be written, a line says
            so, and training goes on.
        finish: Take no more steps: return the state of the checkpoint, however long its run was
            to be.
        on_progress: Called with the state and the means of loss and PSNR since the last call:
            after each step on the CPU; on a GPU, which the call waits for, after every tenth step,
            when a second has passed, and at the end.
        strategy: Moves, adds and removes Gaussians in place of 3DGS-MCMC, such as gsplat's
            `DefaultStrategy()`, by its own settings and not those of `config`. It gets one photo at
            a time. gsplat's draw from torch's global generator, so seed that; and the noise of its
            `MCMCStrategy` grows with the rate of the means, which is 6 times gsplat's by default.

    Returns:
        The trained tensors, with the optimiser's state; `state.splats.detach()` are the Gaussians.

    Raises:
        StyleSplatError: If the capture leaves nothing to train on, there is no checkpoint to
            finish, or it has other settings or another capture; it is left as it is. If a strategy
            is to be used with a checkpoint, several photos at once or several processes; or several
            photos at once by several processes.
        KeyboardInterrupt: After Ctrl-C, once the step is finished and the checkpoint written;
            SIGTERM waits for them too, before it does what it does in your program.

    Example:
        >>> import stylesplat as ss
        >>> from stylesplat.training.config import TrainConfig
        >>> state = fit(ss.load("garden/"), TrainConfig(max_seconds=120))  # doctest: +SKIP
        >>> splats = state.splats.detach()  # doctest: +SKIP
    """
    if finish:
        require_checkpoint(checkpoint)
    if strategy is not None:
        _check_alone(config, checkpoint)
    device = torch.device(device)
    rows, _ = split_views(capture, config.test_every)
    if not rows:
        raise StyleSplatError("Cannot train: the capture has no photos left to train on.")
    if config.background in LEVELS and capture.alphas is None:
        raise StyleSplatError(
            f"Cannot train over {config.background}: no photo of the capture is transparent. "
            "Leave out the background."
        )
    saved = continued = None
    if checkpoint is not None:
        mark = fingerprint(replace(capture, object_names={}))
        saved = Checkpoint(checkpoint, config, mark, len(rows), capture.downscale)
        if checkpoint.exists():
            continued = load_checkpoint(saved, device, finish=finish)
            continued = replace(continued, world_offset=capture.world_offset)
            steps = f"{continued.step:,}"
            if finish or config.progress(continued.step, continued.seconds) >= 1:
                say(f"Taking no more steps than the {steps} of {checkpoint}.")
                return continued
            say(f"Continuing from {checkpoint}, after {steps} steps. `--restart` begins anew.")
    run, state = begin_run(capture, config, rows, device, continued, strategy)
    try:
        with uncounted("getting ready to train"):
            warm_up_training(run, state)
        if continued is None:
            say_estimate(run, state, capture, advise=checkpoint is not None)
        checkpointer = Checkpointer(saved if run.rank == 0 else None)
        bar = (
            task("training", config.steps, unit="step", done=state.step)
            if config.max_seconds is None
            else task("training", config.max_seconds, unit="s", done=state.seconds)
        )
        with bar as bar, held_signals() as interrupted:
            meter = ProgressMeter(config, state, bar, on_progress)
            state, stopped = stop_together(run, state, stopped=interrupted())
            while run.progress(state) < 1 and not stopped:
                start = time.perf_counter()
                after, scores = train_step(run, state)
                means = meter.add(scores, after.step)
                state = replace(after, seconds=state.seconds + time.perf_counter() - start)
                if means is not None:
                    meter.report(state, means)
                checkpointer.after_step(state)
                state, stopped = stop_together(run, state, stopped=interrupted())
            if meter.scores:
                meter.report(state, meter.means())
            if not stopped:
                state = finished(state)
            checkpointer.save(state, f"The run was at step {state.step:,}.", always=stopped)
        if stopped:  # and the program's own handler has let it pass
            raise KeyboardInterrupt
        return state
    finally:
        run.pool.end()
        run.views.end()


def rank_and_processes() -> tuple[int, int]:
    """Which of the processes that train together this is, by torch.distributed, and their count.

    All begin alike, draw the same random numbers and step by the same mean gradients, so their
    Gaussians stay the same without being sent.
    """
    if dist.is_available() and dist.is_initialized():
        return dist.get_rank(), dist.get_world_size()
    return 0, 1


@contextmanager
def torchrun(device: str) -> Iterator[tuple[int, int]]:
    """Join the processes that `torchrun` has started, if any; yields `rank_and_processes`."""
    if "TORCHELASTIC_RUN_ID" not in os.environ or os.environ.get("WORLD_SIZE", "1") == "1":
        yield rank_and_processes()
        return
    number, count = int(os.environ["LOCAL_RANK"]), int(os.environ["LOCAL_WORLD_SIZE"])
    if pick_device(device).type != "cuda":
        raise StyleSplatError(
            f"Cannot train by {count} processes on the CPU: one process uses all cores. Train "
            "without torchrun, or on GPUs."
        )
    if count > (gpus := torch.cuda.device_count()):
        raise StyleSplatError(
            f"There are {count} processes for {count_noun(gpus, 'GPU')}. Give torchrun "
            f"`--nproc-per-node {gpus}`."
        )
    torch.cuda.set_device(number)
    dist.init_process_group("nccl", timeout=TRAINING_PATIENCE)
    try:
        yield rank_and_processes()
    finally:
        dist.destroy_process_group()


def stop_together(run: TrainingRun, state: State, *, stopped: bool) -> tuple[State, bool]:
    """The state with the time of the slowest process; and whether any process is to stop."""
    if run.processes == 1:
        return state, stopped
    largest = torch.tensor([state.seconds, stopped], dtype=torch.float64, device=run.device)
    dist.all_reduce(largest, dist.ReduceOp.MAX)
    return replace(state, seconds=largest[0].item()), bool(largest[1])


def _check_alone(config: TrainConfig, checkpoint: Path | None) -> None:
    """Refuse what goes with no strategy but ours, whose state is the seed and the step."""
    several = (config.photos_at_once or 1) > 1 or rank_and_processes()[1] > 1
    if checkpoint is not None or several:
        fact = "several photos at a time" if several else "a checkpoint"
        raise StyleSplatError(
            f"Cannot train with a strategy and {fact}: it may change the Gaussians after each "
            "photo, and checkpoints do not contain its state. Leave out one of them."
        )


def begin_run(
    capture: Capture,
    config: TrainConfig,
    rows: list[int],
    device: torch.device,
    continued: State | None = None,
    strategy: Strategy | None = None,
) -> tuple[TrainingRun, State]:
    """The run on these photos, and its first state, or that of a run to continue."""
    ids = learned_ids(capture, rows) if continued is None else continued.ids
    rank, processes = rank_and_processes()
    photos, extent = config.photos_at_once, scene_extent(capture.cameras)
    if processes > 1:
        if photos is not None and photos > 1:
            raise StyleSplatError(
                f"Cannot train on {photos} photos at once by {processes} processes, each of which "
                "takes one: leave out photos_at_once."
            )
        photos = 1
    pool = RenderPool(1 if strategy else photos or MOST_AT_ONCE, device)
    run = TrainingRun(
        config=config,
        rows=tuple(rows),
        views=TrainingViews(capture, rows, ids=ids, device=device, max_memory=config.max_memory),
        cameras=capture.cameras,
        extent=extent,
        device=device,
        strategy=strategy or MCMCStrategy(config, extent),
        batch=processes if processes > 1 else photos or pool.size,
        pool=pool,
        rank=rank,
        processes=processes,
        exchange=exchange_gradients if processes > 1 else tuple,
    )
    begun = capture
    if continued is None:
        generator = torch.Generator().manual_seed(config.seed)
        begun = with_swept_points(capture, rows, run.views, generator)
    state = continued or first_state(
        first_splats(
            begun,
            sh_degree=config.sh_degree,
            max_gaussians=config.max_gaussians,
            generator=torch.Generator().manual_seed(config.seed),
            views=run.all_views("comparing colours of points", 1.0),
            ids=ids,
        ).to(device)
    )
    if continued is None:
        begin = run.strategy.initialize_state
        state = replace(state, strategy_state=begin(**supported_kwargs(begin, scene_scale=extent)))
        # Points that were swept lie in photos that do not show them, too: they tell no exposure
        state = state.with_photos(initial_photo_params(run, capture.points))
    return run, state


def finished(state: State) -> State:
    """The state at the end of a run, without runaways; a line says how many these were."""
    kept = state.without_runaways()
    lost = len(state.splats) - len(kept.splats)
    if not len(kept.splats):
        raise StyleSplatError(
            f"Training failed: all {lost:,} Gaussians have numbers that are not finite. Train "
            "again with a lower means_rate, and check the poses."
        )
    if lost:
        say(f"{count_noun(lost, 'Gaussian')} ran away beyond all bounds, and were left out.")
    return kept


def warm_up_training(run: TrainingRun, state: State) -> None:
    """Compile the kernels before the clock starts, by rounds of one process on a copy."""
    batch = run.batch if run.processes == 1 else 1
    run = replace(run, batch=batch, pool=RenderPool(1), rank=0, processes=1, exchange=tuple)
    if run.progress(state) < 1:
        for number in range(min(run.config.identity_every, 2)):  # with and without identities
            train_step(run, replace(state.clone(), step=number * batch))
        later = first_pulled(run, state.clone())
        if pulls_depths(run, later):  # by kernels of more channels
            photo_gradients(run, later, later.step)


class ProgressMeter:
    """Averages loss and PSNR on the device; shows them, and passes them to `on_progress`."""

    def __init__(
        self, config: TrainConfig, state: State, bar: Task, on_progress: Report | None
    ) -> None:
        self._config, self._bar, self._on_progress = config, bar, on_progress
        self._done = self._spent(state)
        self._step, self._since = state.step, time.monotonic()
        self.scores: list[Float[Tensor, 2]] = []
        self._smooth: Float[Tensor, 2] | None = None

    def _spent(self, state: State) -> int | float:
        """Steps or seconds of what the bar counts."""
        limit = self._config.max_seconds
        return state.step if limit is None else min(state.seconds, limit)

    def add(self, scores: Float[Tensor, "2"], step: int) -> Float[Tensor, "2"] | None:
        """Add the scores of a round; their means if it is time for a report."""
        self.scores.append(scores)
        waits = scores.is_cuda and step % GPU_STEPS != 0
        due = not waits or time.monotonic() - self._since > GPU_SECONDS
        return self.means() if due else None

    def means(self) -> Float[Tensor, "2"]:
        """Means of loss and PSNR since the last report; waits for the device."""
        return torch.stack(self.scores).mean(dim=0).cpu()

    def report(self, state: State, means: Float[Tensor, "2"]) -> None:
        """Show the progress and smoothed means, and start new means."""
        kept = TRAINING_SMOOTHING ** (state.step - self._step)
        self._smooth = means if self._smooth is None else self._smooth.lerp(means, 1 - kept)
        loss, psnr = self._smooth.tolist()
        count = f"{len(state.splats):,} Gaussians"
        is_over = self._config.progress(state.step, state.seconds) == 1
        rises = "" if is_over else " (rises most near the end)"
        self._bar.note(f"loss {loss:.4f}, PSNR {psnr:.2f} dB{rises}, {count}")
        done = self._spent(state)
        self._bar.advance(done - self._done)
        self._done, self._step, self._since = done, state.step, time.monotonic()
        self.scores.clear()
        if self._on_progress is not None:
            self._on_progress(state, *means.tolist())


def round_seconds(run: TrainingRun, state: State) -> list[float]:
    """Seconds of a round at evenly spaced points of a run by steps and `MCMCStrategy`.

    Measured on copies of its first state that have as many Gaussians as the run has by then, and
    photos as small. Each round is taken twice, first to read its photos. Gaussians are repeated
    with their size and opacity: those that densification adds are small and faint, which takes less
    time, but they grow soon. In 1,500 steps the sum was a tenth too long for a toy, and a third for
    a desk that starts from few points.
    """
    steps = ESTIMATE_ROUNDS * run.batch
    config = replace(
        run.config, steps=steps, max_seconds=None, refine_every=steps + 1, sh_degree_every=None
    )
    timed = replace(run, config=config, strategy=MCMCStrategy(config, run.extent))
    seconds, first = list[float](), len(state.splats)
    for step in range(0, steps, run.batch):
        count = config.gaussian_count(step / steps, first)
        later = replace(state.at_rows(torch.arange(count) % first), step=step)
        train_step(timed, later.clone())
        again, start = later.clone(), time.perf_counter()
        train_step(timed, again)
        again.params["means"][0, 0].item()  # waits for the GPU
        seconds.append(time.perf_counter() - start)
    return seconds


def say_estimate(run: TrainingRun, state: State, capture: Capture, *, advise: bool) -> None:
    """Say how long a long run will take, and if asked, what other options of `train` would do."""
    config, ours = run.config, isinstance(run.strategy, MCMCStrategy)
    short = config.steps < ESTIMATE_LEAST * ESTIMATE_ROUNDS * run.batch
    if short or config.max_seconds is not None or run.processes > 1 or not ours:
        return
    seconds = fmean(round_seconds(run, state)) * config.steps / run.batch
    width, height = max((run.cameras[row].size for row in run.rows), key=max)
    advice = ""
    if config.steps < TrainConfig.steps:
        advice = f" Fewer than {TrainConfig.steps:,} steps leave pictures softer."
    if capture.downscale > 1:
        most = format_duration(seconds * capture.downscale**2)
        advice += f" All pixels of the photos would take up to {most}."
    if seconds > LONG_SECONDS:
        advice += f" `{FIRST_LOOK}` gives a first look."
    photos = f"{count_noun(len(run.rows), 'photo')} of {width}x{height}"
    say(
        f"{photos}, at most {config.max_gaussians:,} Gaussians: {config.steps:,} steps take "
        f"about {format_duration(seconds)} on this machine.{advice if advise else ''}"
    )
