"""The training loop: Gaussians, identities and classifier together (StyleSplat section 3.3)."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import Task, say, task
from stylesplat.rendering.at_once import RenderPool
from stylesplat.scene.capture import Capture, fingerprint
from stylesplat.scene.outliers import scene_extent
from stylesplat.signals import TAKEN
from stylesplat.training.checkpoint import (
    Checkpoint,
    Checkpointer,
    load_checkpoint,
    require_checkpoint,
)
from stylesplat.training.densification import MCMCStrategy, Strategy, accepted
from stylesplat.training.estimate import say_estimate
from stylesplat.training.initialize import first_splats
from stylesplat.training.per_photo import initial_photo_params
from stylesplat.training.runaways import finished
from stylesplat.training.state import ALONE, Ranks, Run, State, first_state
from stylesplat.training.step import train_step
from stylesplat.training.train_config import LEVELS, TrainConfig
from stylesplat.training.training_views import TrainingViews, learned_ids, split_views

MOST_AT_ONCE = 4  # photos in all processes, unless the settings say otherwise
SMOOTHING = 0.98  # per step, of the loss and PSNR shown: single photos differ a lot
GPU_STEPS = 10  # between reports, each of which waits for the GPU; a CPU has done the step anyway
GPU_SECONDS = 1.0  # but slow steps are reported one by one

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
            is to be used with a checkpoint, several photos at once or several processes.
        KeyboardInterrupt: After Ctrl-C, once the step is finished and the checkpoint written;
            SIGTERM waits for them too, before it does what it does in your program.

    Example:
        >>> import stylesplat as ss
        >>> from stylesplat.training.train_config import TrainConfig
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
        saved = Checkpoint(checkpoint, config, mark, len(rows))
        if checkpoint.exists():
            continued = load_checkpoint(saved, device, finish=finish)
            continued = replace(continued, world_offset=capture.world_offset)
            steps = f"{continued.step:,}"
            if finish or config.progress(continued.step, continued.seconds) >= 1:
                say(f"Taking no more steps than the {steps} of {checkpoint}.")
                return continued
            say(f"Continuing from {checkpoint}, after {steps} steps. `--restart` begins anew.")
    run, state = _begin(capture, config, rows, device, continued, strategy)
    try:
        warm_up_training(run, state)
        if continued is None:
            say_estimate(run, state, capture)
        checkpointer = Checkpointer(saved if run.ranks.number == 0 else None)
        bar = (
            task("training", config.steps, unit="step", done=state.step)
            if config.max_seconds is None
            else task("training", config.max_seconds, unit="s", done=state.seconds)
        )
        with bar as bar, deferred_interrupt() as interrupted:
            meter = ProgressMeter(config, state, bar, on_progress)
            state, stopped = _agree(run, state, interrupted=interrupted())
            while run.progress(state) < 1 and not stopped:
                start = time.perf_counter()
                after, scores = train_step(run, state)
                means = meter.add(scores, after.step)
                state = replace(after, seconds=state.seconds + time.perf_counter() - start)
                if means is not None:
                    meter.report(state, means)
                checkpointer.after_step(state)
                state, stopped = _agree(run, state, interrupted=interrupted())
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


def _check_alone(config: TrainConfig, checkpoint: Path | None) -> None:
    """Refuse what goes with no strategy but ours, whose state is the seed and the step."""
    several = (config.photos_at_once or 1) > 1 or Ranks.here().count > 1
    if checkpoint is not None or several:
        fact = "several photos at a time" if several else "a checkpoint"
        raise StyleSplatError(
            f"Cannot train with a strategy and {fact}: it may change the Gaussians after each "
            "photo, and checkpoints do not contain its state. Leave out one of them."
        )


def _begin(
    capture: Capture,
    config: TrainConfig,
    rows: list[int],
    device: torch.device,
    continued: State | None,
    strategy: Strategy | None,
) -> tuple[Run, State]:
    ids = learned_ids(capture, rows) if continued is None else continued.ids
    ranks = Ranks.here()
    most = max(1, MOST_AT_ONCE // ranks.count)
    photos = config.photos_at_once if strategy is None else 1
    pool = RenderPool(photos or most, device)
    # Processes on the CPU send their gradients once a round, so each has as many photos in it
    same = ranks.count > 1 and device.type == "cpu"
    extent = scene_extent(capture.cameras)
    run = Run(
        config=config,
        rows=tuple(rows),
        views=TrainingViews(capture, rows, ids=ids, device=device, max_memory=config.max_memory),
        cameras=capture.cameras,
        extent=extent,
        device=device,
        strategy=strategy or MCMCStrategy(config, extent),
        batch=photos or (most if same else pool.size),
        ranks=ranks,
        pool=pool,
    )
    state = continued or first_state(
        first_splats(
            capture,
            sh_degree=config.sh_degree,
            max_gaussians=config.max_gaussians,
            generator=torch.Generator().manual_seed(config.seed),
            views=run.all_views("comparing colours of points", 1.0),
            ids=ids,
        ).to(device)
    )
    begin = run.strategy.initialize_state
    state = replace(state, strategy_state=begin(**accepted(begin, scene_scale=extent)))
    if continued is None:
        state = state.with_photos(initial_photo_params(run, capture.points))
    return run, state


def warm_up_training(run: Run, state: State) -> None:
    """Compile the kernels before the clock starts, by rounds on a copy of the state.

    The rounds are those of one process; of several processes all photos of a round have one step.
    """
    batch = run.batch if run.ranks.count == 1 else 1
    run = replace(run, batch=batch, ranks=ALONE, pool=RenderPool(1))
    if run.progress(state) < 1:
        for number in range(min(run.config.identity_every, 2)):  # with and without identities
            train_step(run, replace(state.clone(), step=number * batch))


def _agree(run: Run, state: State, *, interrupted: bool) -> tuple[State, bool]:
    """The state with the time of the slowest process; and whether any process is to stop."""
    seconds, stopped = run.ranks.largest(state.seconds, interrupted)
    return replace(state, seconds=seconds), bool(stopped)


class ProgressMeter:
    """Averages loss and PSNR on the device; shows them, and passes them to `on_progress`."""

    def __init__(
        self, config: TrainConfig, state: State, bar: Task, on_progress: Report | None
    ) -> None:
        self._limit, self._bar, self._on_progress = config.max_seconds, bar, on_progress
        self._done = state.step if self._limit is None else state.seconds
        self._step, self._since = state.step, time.monotonic()
        self.scores: list[Float[Tensor, 2]] = []
        self._smooth: Float[Tensor, 2] | None = None

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
        kept = SMOOTHING ** (state.step - self._step)
        self._smooth = means if self._smooth is None else self._smooth.lerp(means, 1 - kept)
        loss, psnr = self._smooth.tolist()
        self._bar.note(f"loss {loss:.4f}, PSNR {psnr:.2f} dB, {len(state.splats):,} Gaussians")
        done = state.step if self._limit is None else min(state.seconds, self._limit)
        self._bar.advance(done - self._done)
        self._done, self._step, self._since = done, state.step, time.monotonic()
        self.scores.clear()
        if self._on_progress is not None:
            self._on_progress(state, *means.tolist())


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Delay Ctrl-C and SIGTERM to the end of the block; the function yielded says if one came.

    Then they do what they would have done. Outside the main thread, where Python handles no
    signals, none comes; ignored signals stay ignored.
    """
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in TAKEN}
    if threading.current_thread() is not threading.main_thread():
        handlers = {}
    taken = {n: h for n, h in handlers.items() if h not in (signal.SIG_IGN, None)}
    try:
        for number in taken:
            signal.signal(number, lambda number, _: came.append(number))
        yield lambda: bool(came)
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(came):
            signal.raise_signal(number)
