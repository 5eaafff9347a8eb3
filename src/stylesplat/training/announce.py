"""What training tells of itself while it runs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import monotonic

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.progress import task
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig

SMOOTHING = 0.98  # per step, of the loss and PSNR told: single photos differ a lot

GPU_STEPS = 10  # between reports, each of which waits for the GPU; a CPU has done the step anyway
GPU_SECONDS = 1.0  # but slow steps are reported one by one

Report = Callable[[State, float, float], None]
"""Is told the state, after each step or few, and the means of loss and PSNR since the last time."""


@dataclass(frozen=True)
class Tally:
    """Loss and PSNR of some steps, added up on the device."""

    scores: Float[Tensor, "2"] | None = None
    """Their sums."""
    steps: int = 0
    """How many."""
    since: float = field(default_factory=monotonic)
    """When counting began."""

    def plus(self, scores: Float[Tensor, "2"]) -> "Tally":
        """With one more step."""
        total = scores if self.scores is None else self.scores + scores
        return Tally(total, self.steps + 1, self.since)

    def due(self, step: int, device: torch.device) -> bool:
        """Whether it is time to tell: each step on a CPU, every few on a GPU."""
        if device.type == "cpu" or step % GPU_STEPS == 0:
            return True
        return monotonic() - self.since > GPU_SECONDS

    def means(self) -> tuple[float, float]:
        """Of loss and PSNR; waits for the device."""
        assert self.scores is not None
        loss, psnr = (self.scores / self.steps).tolist()
        return loss, psnr


@contextmanager
def announced(config: TrainConfig, state: State, also: Report | None = None) -> Iterator[Report]:
    """A task whose steps, or seconds, are counted; with loss, PSNR and Gaussians as its note.

    Args:
        config: Whether steps or seconds count.
        state: Where training begins, or goes on.
        also: Who else is to be told.

    Yields:
        What is to be told every few steps.
    """
    timed = config.max_seconds is not None
    total = config.max_seconds if config.max_seconds is not None else config.steps
    done = state.seconds if timed else state.step
    told: dict[str, float] = {"done": done, "step": state.step}
    with task("training", total, unit="s" if timed else "step", done=done) as counted:

        def report(state: State, loss: float, psnr: float) -> None:
            kept = SMOOTHING ** (state.step - told["step"])
            for name, value in (("loss", loss), ("psnr", psnr)):
                told[name] = kept * told.get(name, value) + (1 - kept) * value
            counted.note(
                f"loss {told['loss']:.4f}, PSNR {told['psnr']:.2f} dB, "
                f"{len(state.params['means']):,} Gaussians"
            )
            done = min(state.seconds, total) if timed else state.step
            counted.advance(done - told["done"])
            told.update(done=done, step=state.step)
            if also is not None:
                also(state, loss, psnr)

        yield report
