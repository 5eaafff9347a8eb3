"""What training tells of itself while it runs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stylesplat.progress import task
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig

SMOOTHING = 0.98  # of the loss and PSNR told: single photos differ a lot


@contextmanager
def announced(config: TrainConfig, state: State) -> Iterator[Callable[[State, float, float], None]]:
    """A task whose steps, or seconds, are counted; with loss, PSNR and Gaussians as its note.

    Args:
        config: Whether steps or seconds count.
        state: Where training begins, or goes on.

    Yields:
        What is to be told each step: the state after it, its loss, the photo's PSNR.
    """
    timed = config.max_seconds is not None
    total = config.max_seconds if config.max_seconds is not None else config.steps
    done = state.seconds if timed else state.step
    told: dict[str, float] = {"done": done}
    with task("training", total, unit="s" if timed else "step", done=done) as counted:

        def report(state: State, loss: float, psnr: float) -> None:
            for name, value in (("loss", loss), ("psnr", psnr)):
                told[name] = SMOOTHING * told.get(name, value) + (1 - SMOOTHING) * value
            counted.note(
                f"loss {told['loss']:.4f}, PSNR {told['psnr']:.2f} dB, "
                f"{len(state.params['means']):,} Gaussians"
            )
            done = min(state.seconds, total) if timed else state.step
            counted.advance(done - told["done"])
            told["done"] = done

        yield report
