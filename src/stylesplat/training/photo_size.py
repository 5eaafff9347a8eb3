"""The size of photos at which training ends in a time that people accept."""

import math
from collections.abc import Callable
from dataclasses import replace

import torch

from stylesplat.progress import SILENCE, observed, task
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import begin_run, estimate_seconds, warm_up_training

# For the steps, so that 80 photos are posed, trained and painted in 15 minutes on two cores. More
# steps on smaller photos came closer to a toy's photos at full size than the same time on larger
# ones: 5,000 at 492 pixels 27.5 dB, 3,000 at 656 pixels 26.7 dB
ACCEPTED_SECONDS = 300.0
# Pixels of the longer side
SMALLEST, LARGEST = 480, 1600  # of photos trained on; INRIA's code takes at most the latter
TRIED = (480, 960)  # of those that are measured
PAINTED = 960  # at least, of views to paint, if the photos have them
TRIED_PHOTOS = 8
FACTOR_STEP = 4  # factors are quarters


def affordable_downscale(
    capture_at: Callable[[float], Capture],
    *,
    device: torch.device,
    max_seconds: float | None = None,
) -> float:
    """How many times smaller photos must be for a usual run to end in time on this machine.

    A step takes a time for the Gaussians and one for the pixels. Both follow from a few rounds of
    the default training at two small sizes. Photos are as large as the time allows, within
    `SMALLEST` and `LARGEST`.

    Args:
        capture_at: The capture with photos that are so many times smaller.
        device: Where training will be.
        max_seconds: What the default number of steps may take; None: `ACCEPTED_SECONDS`.

    Returns:
        The factor, 1 for all pixels, in quarters.
    """
    whole = capture_at(1.0).cameras
    if whole.shrink_to(SMALLEST) == 1:
        return 1.0
    factors, seconds = [whole.shrink_to(side) for side in TRIED], list[float]()
    with task("choosing the size of photos", len(factors), unit="size") as counted:
        for factor in factors:
            with observed(SILENCE):
                seconds.append(_seconds_at(capture_at(factor), device))
            counted.advance()
    areas = [(float(whole.sizes.max()) / factor) ** 2 for factor in factors]
    rate = (seconds[1] - seconds[0]) / (areas[1] - areas[0])  # per pixel
    left = (ACCEPTED_SECONDS if max_seconds is None else max_seconds) - seconds[0]
    side = LARGEST if rate <= 0 else math.sqrt(max(areas[0] + left / rate, 0.0))
    return _quarters(whole.shrink_to(round(min(max(side, SMALLEST), LARGEST))))


def usual_downscale(photos: Cameras) -> float:
    """How many times smaller photos must be to be no longer than `LARGEST`, in quarters."""
    return _quarters(photos.shrink_to(LARGEST))


def painting_downscale(photos: Cameras, trained: float) -> float:
    """How many times smaller than the photos the views are that a scene is painted in.

    Strokes of the size of large pixels would be soft, so photos may have been smaller in training.
    """
    return min(trained, math.floor(FACTOR_STEP * photos.shrink_to(PAINTED)) / FACTOR_STEP)


def _quarters(factor: float) -> float:
    """The factor, rounded up: photos become no larger than by it."""
    return math.ceil(FACTOR_STEP * factor) / FACTOR_STEP


def _seconds_at(capture: Capture, device: torch.device) -> float:
    """What a default run on such photos takes, by a few of them."""
    few = replace(capture, label_maps=None).only(evenly_spaced(range(len(capture)), TRIED_PHOTOS))
    config = TrainConfig(test_every=0)
    run, state = begin_run(few, config, [*range(len(few))], device)
    try:
        warm_up_training(run, state)
        return estimate_seconds(run, state)
    finally:
        run.pool.end()
        run.views.end()
