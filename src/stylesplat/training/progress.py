"""The progress bar of training."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

from stylesplat.rendering.kernels.compiling import announce_compilation
from stylesplat.training.config import TrainConfig
from stylesplat.training.state import State

SMOOTHING = 0.98  # of the loss and PSNR shown: single photos differ a lot


@contextmanager
def progress_bar(
    config: TrainConfig, *, enabled: bool
) -> Iterator[Callable[[State, float, float], None]]:
    """A bar on stderr with loss, PSNR of the training photos, Gaussians and time left."""
    timed = config.max_seconds is not None
    total = config.max_seconds if config.max_seconds is not None else config.steps
    shown: dict[str, float] = {}
    with tqdm(total=total, unit="s" if timed else "step", disable=not enabled) as bar:
        if enabled:
            announce_compilation()
        bar.set_description("starting")

        def report(state: State, loss: float, psnr: float) -> None:
            for name, value in (("loss", loss), ("psnr", psnr)):
                shown[name] = SMOOTHING * shown.get(name, value) + (1 - SMOOTHING) * value
            bar.set_description("training", refresh=False)
            bar.set_postfix_str(
                f"loss {shown['loss']:.4f}, PSNR {shown['psnr']:.2f} dB, "
                f"{len(state.params['means']):,} Gaussians",
                refresh=False,
            )
            done = min(round(state.seconds, 1), total) if timed else state.step
            bar.update(done - bar.n)

        yield report
