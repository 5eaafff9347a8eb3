"""Joint training of Gaussians, identities and classifier (StyleSplat section 3.3)."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say
from stylesplat.rendering.at_once import Crew
from stylesplat.scene.capture import Capture
from stylesplat.scene.fingerprint import fingerprint
from stylesplat.training.announce import Report, Tally, announced
from stylesplat.training.checkpoint import (
    Checkpoint,
    load_checkpoint,
    refuse_unbegun,
    remove_leftovers,
)
from stylesplat.training.classes import say_unseen, shown_ids
from stylesplat.training.initialize import first_splats, scene_extent
from stylesplat.training.interrupt import deferred_interrupt
from stylesplat.training.keeper import Keeper
from stylesplat.training.per_photo import first_of_photos
from stylesplat.training.ranks import Ranks
from stylesplat.training.run import Run
from stylesplat.training.state import State, first_state
from stylesplat.training.step import train_step
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import split_views, training_views

MOST_AT_ONCE = 4  # photos in all processes, unless the settings say otherwise


def fit(
    capture: Capture,
    config: TrainConfig,
    *,
    device: torch.device | str = "cpu",
    checkpoint: Path | None = None,
    finish: bool = False,
    on_progress: Report | None = None,
) -> State:
    """Train until the run is over: the functional core of `train`, for programs of your own.

    Follows StyleSplat and Gaussian Grouping, with 3DGS-MCMC densification. Every
    `config.test_every`-th photo is held out. Where photos are transparent, they and the renders
    are compared over random colours. Label ids that only held-out photos show are not learned.

    Args:
        capture: Photos, and label maps if identities are wanted.
        config: How to train.
        device: Where to train.
        checkpoint: A file to continue from if it exists. It is written every minute, when the run
            is interrupted and at its end, and left where it is. If it cannot be written, that is
            said, and the training goes on.
        finish: Take no more steps: return what the checkpoint has, which was of any length.
        on_progress: Told the state, and the means of loss and PSNR since it was told last: after
            each step; on a GPU, which would have to be waited for, after every tenth, when a second
            has passed, and at the end.

    Returns:
        The trained tensors, with the optimiser's state; `state.splats.detach()` are the Gaussians.

    Raises:
        StyleSplatError: If the capture leaves nothing to train on, there is no checkpoint to
            finish, or it is of other settings or another capture; it is left as it is.
        KeyboardInterrupt: After Ctrl-C, once the step is finished and the checkpoint written;
            SIGTERM waits for them too, before it does what it does in your program.

    Example:
        >>> import stylesplat as ss
        >>> from stylesplat.training.train_config import TrainConfig
        >>> state = fit(ss.load("garden/"), TrainConfig(max_seconds=120))  # doctest: +SKIP
        >>> splats = state.splats.detach()  # doctest: +SKIP
    """
    if finish:
        refuse_unbegun(checkpoint)
    device = torch.device(device)
    rows, _ = split_views(capture, config.test_every)
    if not rows:
        raise StyleSplatError("Cannot train: the capture has no photos left to train on.")
    saved = (
        None
        if checkpoint is None
        else Checkpoint(
            checkpoint, config, fingerprint(replace(capture, object_names={})), len(rows)
        )
    )
    continued = _continued(saved, device, finish=finish)
    if continued is not None and (finish or _is_over(continued, config)):
        return continued
    state = continued or _first(capture, rows, config, device)
    run = Run(
        config=config,
        rows=tuple(rows),
        views=training_views(
            capture, rows, ids=state.ids, device=device, max_memory=config.max_memory
        ),
        cameras=capture.cameras,
        extent=scene_extent(capture.cameras),
        device=device,
    )
    if continued is None:
        state = state.with_photos(first_of_photos(run, capture.points))
    ranks = Ranks.here()
    crew = Crew(config.photos_at_once or most_at_once(ranks), device)
    run = replace(run, batch=config.photos_at_once or _photos_at_once(crew, ranks, device))
    try:
        _warm_up(run, state, ranks)
        run = replace(run, crew=crew, ranks=ranks)
        keeper = Keeper(saved if ranks.number == 0 else None, state)
        with announced(config, state, on_progress) as report:
            return _finish(run, state, keeper, report)
    finally:
        crew.end()


def _photos_at_once(crew: Crew, ranks: Ranks, device: torch.device) -> int:
    """Photos of a round of one process, unless the settings say otherwise.

    Of several on the CPU each looks at the same number, however many threads it has: what a round
    tells is sent once.
    """
    sends = ranks.count > 1 and device.type == "cpu"
    return most_at_once(ranks) if sends else crew.size


def most_at_once(ranks: Ranks) -> int:
    """Photos of a round of one process at most, unless the settings say otherwise."""
    return max(1, MOST_AT_ONCE // ranks.count)


def _first(
    capture: Capture, rows: Sequence[int], config: TrainConfig, device: torch.device
) -> State:
    shown = shown_ids(capture, rows)
    say_unseen(shown, capture.object_names)
    splats = first_splats(
        capture,
        sh_degree=config.sh_degree,
        max_gaussians=config.max_gaussians,
        generator=torch.Generator().manual_seed(config.seed),
        ids=shown.trained,
    )
    return first_state(splats.to(device))


def _is_over(state: State, config: TrainConfig) -> bool:
    return config.progress(state.step, state.seconds) >= 1


def _continued(saved: Checkpoint | None, device: torch.device, *, finish: bool) -> State | None:
    """What an earlier run has left, if there was one."""
    if saved is None:
        return None
    exists = saved.path.exists()
    state = load_checkpoint(saved, device, finish=finish) if exists else None
    remove_leftovers(saved.path)
    if state is not None and (finish or _is_over(state, saved.config)):
        say(f"Taking no more steps than the {state.step:,} of {saved.path}.")
    elif state is not None:
        say(f"Continuing from {saved.path}, after {state.step:,} steps. `--restart` begins anew.")
    return state


def _warm_up(run: Run, state: State, ranks: Ranks) -> None:
    """Compile the kernels before the clock starts, by rounds on a copy; leaves no trace.

    The rounds are those of one process; of several processes all photos of a round have one step.
    """
    run = run if ranks.count == 1 else replace(run, batch=1)
    if run.progress(state) < 1:
        for number in range(min(run.config.identity_every, 2)):  # with and without identities
            train_step(run, replace(state.clone(), step=number * run.batch))


def _finish(run: Run, state: State, keeper: Keeper, report: Report) -> State:
    """Train to the end of the run; Ctrl-C and SIGTERM wait for the end of a step."""
    tally = Tally()
    with deferred_interrupt() as interrupted:
        state, stopped = _agreed(run, state, interrupted=interrupted())
        while run.progress(state) < 1 and not stopped:
            start = time.perf_counter()
            after, scores = train_step(run, state)
            tally = tally.plus(scores)
            means = tally.means() if tally.due(after.step, run.device) else None
            state = replace(after, seconds=state.seconds + time.perf_counter() - start)
            if means is not None:
                report(state, *means)
                tally = Tally()
            keeper.after_step(state)
            state, stopped = _agreed(run, state, interrupted=interrupted())
        if tally.steps:
            report(state, *tally.means())
        keeper.at_end(state, interrupted=stopped)
    if stopped:  # and the program's own handler has let it pass
        raise KeyboardInterrupt
    return state


def _agreed(run: Run, state: State, *, interrupted: bool) -> tuple[State, bool]:
    """The state with the time that the slowest process took; and whether any is to stop."""
    seconds, stopped = run.ranks.largest(state.seconds, interrupted)
    return replace(state, seconds=seconds), bool(stopped)
