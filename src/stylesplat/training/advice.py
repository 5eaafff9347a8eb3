"""What a finished training came to, and the one thing to do about it."""

from collections.abc import Mapping
from typing import Any, Literal

from stylesplat.training.train_config import TrainConfig

GOOD, FAIR = 27.0, 22.0  # dB of photos held out: sharp as photos are; soft, with objects in place
ENOUGH = TrainConfig.steps  # shorter runs gain most by more steps
# dB by which photos trained on may be closer than those held out. The fox, of 50 photos, has a gap
# of 2; of 13 photos one of 7.6, where five times the steps gain 0.8 dB, and the other photos 4
GAP = 4.0
FEW = 40  # photos, from which on poses are a likelier fault than their number

Worth = Literal["good", "fair", "poor"]


def judge(
    metrics: Mapping[str, Any], config: TrainConfig, photos: int, *, check: str
) -> tuple[Worth, str]:
    """How good the pictures of held-out photos are, and advice; none where they are good.

    Args:
        metrics: Those of the scene: `psnr`, `train_psnr`, `steps` and `gaussians`.
        config: How it was trained.
        photos: How many photos were trained on.
        check: The command that checks the capture.
    """
    psnr, trained = metrics["psnr"], metrics["train_psnr"]
    if psnr >= GOOD:
        return "good", ""
    worth = "fair" if psnr >= FAIR else "poor"
    if trained - psnr >= GAP:
        fact = f"the photos trained on are matched to {trained:.1f} dB, so training is not at fault"
        if photos < FEW:
            return worth, f"{fact}. Take photos from between these {photos}."
        remedy = "" if config.refine_poses else "`--refine-poses` mends inexact poses; "
        return worth, f"{fact}. {remedy}`{check}` says what is wrong with the photos."
    if metrics["steps"] < ENOUGH:
        return worth, f"the run was short. Train longer, up to --steps {ENOUGH}."
    if metrics["gaussians"] >= config.max_gaussians:
        more = 2 * config.max_gaussians
        return worth, f"it used all Gaussians that it may. Allow more: --max-gaussians {more}."
    return worth, f"more training would hardly help. `{check}` says whether other photos would."
