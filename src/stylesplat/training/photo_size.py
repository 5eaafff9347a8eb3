"""The size of photos at which training ends in time, and splats for the full size afterwards."""

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.progress import SILENCE, observed, task
from stylesplat.rendering.reference import EPS2D
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import depths_of, is_in_image
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import begin_run, round_seconds, warm_up_training

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
    capture_at: Callable[[float], Capture], config: TrainConfig, *, device: torch.device
) -> float:
    """How many times smaller photos must be for the default number of steps to fit in the time.

    A step takes a time for the Gaussians and one for the pixels. Both follow from a few rounds of
    training at two small sizes. Photos are as large as the time allows, within `SMALLEST` and
    `LARGEST`. Schedules of a run with a time are shares of it, so most of its steps are the quick
    ones on small photos: it takes more than a run by steps of the same length.

    Args:
        capture_at: The capture with photos that are so many times smaller.
        config: How to train in `max_seconds`. Without these a default run takes
            `ACCEPTED_SECONDS`.
        device: Where training will be.

    Returns:
        The factor, 1 for all pixels, in quarters.
    """
    if config.max_seconds is None:
        config = TrainConfig()
    whole = capture_at(1.0).cameras
    if whole.shrink_to(SMALLEST) == 1:
        return 1.0
    factors, measured = [whole.shrink_to(side) for side in TRIED], list[Tensor]()
    with task("choosing the size of photos", len(factors), unit="size") as counted:
        for factor in factors:
            with observed(SILENCE):
                measured.append(_step_seconds(capture_at(factor), config, device))
            counted.advance()
    small, large = (1 / factor**2 for factor in factors)
    # Not below 0: noise at one point of a run would give a time below 0, and any size would fit
    a_pixel = (measured[1] - measured[0]).clamp(min=0) / (large - small)
    most = _quarters(whole.shrink_to(SMALLEST))
    factor = usual_downscale(whole)
    while factor < most:
        seconds = measured[0] + a_pixel * (1 / factor**2 - small)
        if _fits(seconds, config):
            break
        factor += 1 / FACTOR_STEP
    return factor


def usual_downscale(photos: Cameras) -> float:
    """How many times smaller photos must be to be no longer than `LARGEST`, in quarters."""
    return _quarters(photos.shrink_to(LARGEST))


def painting_downscale(photos: Cameras) -> float:
    """How many times smaller photos are for `PAINTED` pixels or a few more, in quarters."""
    return math.floor(FACTOR_STEP * photos.shrink_to(PAINTED)) / FACTOR_STEP


def for_larger_views(scene: Scene) -> Scene:
    """The scene for views of `PAINTED` pixels, if it was trained on smaller photos.

    Strokes of the size of large pixels would be soft.
    """
    paints = painting_downscale(scene.cameras)
    if paints >= scene.downscale:
        return scene
    base = widened(scene.base, scene.views("train").downscale(paints), scene.downscale / paints)
    return replace(scene, base=base, downscale=paints)


@torch.no_grad()
def widened(splats: Splats, cameras: Cameras, factor: float) -> Splats:
    """Splats trained on photos so many times smaller than these cameras', as wide as these need.

    Each render adds `EPS2D` to the variances of Gaussians, in its pixels, which are smaller in
    larger pictures: there all would be thinner than they were trained, with gaps between. What is
    missing is added to their variances in 3D, by the smallest of the pixels that showed them: the
    3D smoothing filter of Mip-Splatting (Yu et al. 2024). The splats are not antialiased.
    """
    pixels = splats.means.new_full((len(splats),), math.inf)
    for camera in cameras:
        sizes = depths_of(splats.means, camera) / float(camera.Ks[0].diagonal()[:2].mean())
        pixels = torch.where(is_in_image(splats.means, camera), pixels.minimum(sizes), pixels)
    missing = EPS2D * (factor**2 - 1) * pixels.nan_to_num(posinf=0.0).square()
    return replace(splats, scales=((2 * splats.scales).exp() + missing[:, None]).log() / 2)


def _quarters(factor: float) -> float:
    """The factor, rounded up: photos become no larger than by it."""
    return math.ceil(FACTOR_STEP * factor) / FACTOR_STEP


def _step_seconds(
    capture: Capture, config: TrainConfig, device: torch.device
) -> Float[Tensor, " P"]:
    """What a step takes at some points of a run on such photos, by a few of them."""
    few = replace(capture, label_maps=None).only(evenly_spaced(range(len(capture)), TRIED_PHOTOS))
    config = replace(config, test_every=0)
    run, state = begin_run(few, config, [*range(len(few))], device)
    try:
        warm_up_training(run, state)
        return torch.tensor(round_seconds(run, state)) / run.batch
    finally:
        run.pool.end()
        run.views.end()


def _fits(seconds: Float[Tensor, " P"], config: TrainConfig) -> bool:
    """Whether the default number of steps, which take so long in its course, fits in the time."""
    if config.max_seconds is None:
        return float(seconds.mean()) * TrainConfig.steps <= ACCEPTED_SECONDS
    return float((1 / seconds).mean()) * config.max_seconds >= TrainConfig.steps
