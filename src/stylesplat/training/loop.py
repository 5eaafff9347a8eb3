"""Joint training of Gaussians, identities and classifier (StyleSplat section 3.3)."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.device import pick_device
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.reference import Info
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.training import growth, schedule
from stylesplat.training.adam import adam_step
from stylesplat.training.announce import announced
from stylesplat.training.initialize import first_splats, scene_extent
from stylesplat.training.interrupt import deferred_interrupt
from stylesplat.training.losses import identity_loss, neighbor_loss, photometric_loss
from stylesplat.training.object_sizes import growth_preference, limit_sizes
from stylesplat.training.state import (
    CLASSIFIER,
    State,
    first_state,
    load_checkpoint,
    save_checkpoint,
)
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import Views, split_views, training_views

# The official code's learning rates; those of the means, the higher colour bands and the
# classifier are settings.
RATES = {
    "quats": 1e-3,
    "scales": 5e-3,
    "opacities": 5e-2,
    "sh0": 2.5e-3,
    "identities": 2.5e-3,
}
NEIGHBOR_EVERY = 5  # identity steps between looks at the neighbours in 3D (Gaussian Grouping)
NEIGHBOR_SAMPLES = 1000
NEIGHBORS = 5
CHECKPOINT_SECONDS = 60.0
REFINE_END = 0.9  # share of the run after which Gaussians are neither moved nor added


@dataclass(frozen=True)
class Run:
    """What stays the same during training."""

    config: TrainConfig
    rows: tuple[int, ...]
    """Photos to train on."""
    views: Views
    """Loads them."""
    cameras: Cameras
    """Of all photos."""
    extent: float
    """Unit of length of the scene."""
    generator: torch.Generator
    """Randomness of sampling and noise."""

    def progress(self, state: State) -> float:
        """The share of the run that is done."""
        if self.config.max_seconds is not None:
            return min(state.seconds / self.config.max_seconds, 1.0)
        return min(state.step / max(self.config.steps, 1), 1.0)

    def row(self, step: int) -> int:
        """The photo of a step: every photo once, in random order, then all over again."""
        epoch, place = divmod(step, len(self.rows))
        shuffle = torch.Generator().manual_seed(self.config.seed * 1_000_003 + epoch)
        return self.rows[int(torch.randperm(len(self.rows), generator=shuffle)[place])]


def fit(
    capture: Capture,
    config: TrainConfig,
    *,
    device: torch.device | str = "cpu",
    checkpoint: Path | None = None,
    on_progress: Callable[[State, float, float], None] | None = None,
) -> State:
    """Train until the run is over.

    Args:
        capture: Photos, and label maps if identities are wanted.
        config: How to train.
        device: Where to train.
        checkpoint: A file to continue from if it exists; written every minute and when
            interrupted.
        on_progress: Called after each step with the state, its loss and the photo's PSNR.

    Raises:
        StyleSplatError: If the capture leaves nothing to train on, or the checkpoint does not fit.
        KeyboardInterrupt: After Ctrl-C, once the step is finished and the checkpoint written.
    """
    device = torch.device(device)
    generator = torch.Generator().manual_seed(config.seed)
    rows, _ = split_views(capture, config.test_every)
    if not rows:
        raise StyleSplatError("Cannot train: the capture has no photos left to train on.")
    state = _begin(capture, config, device, generator, checkpoint)
    run = Run(
        config=config,
        rows=tuple(rows),
        views=training_views(capture, state.ids, device),
        cameras=capture.cameras,
        extent=scene_extent(capture.cameras),
        generator=generator,
    )
    _warm_up(run, state)
    saved = time.monotonic()
    with deferred_interrupt() as interrupted, announced(config, state) as report:
        while run.progress(state) < 1 and not interrupted():
            state, loss, psnr = _step(run, state)
            report(state, loss, psnr)
            if on_progress is not None:
                on_progress(state, loss, psnr)
            due = interrupted() or time.monotonic() - saved > CHECKPOINT_SECONDS
            if checkpoint is not None and due:
                save_checkpoint(checkpoint, state, config, generator.get_state())
                saved = time.monotonic()
    if run.progress(state) < 1:
        raise KeyboardInterrupt
    return state


def train(
    capture: Capture,
    config: TrainConfig | None = None,
    *,
    device: torch.device | str = "auto",
    **settings: float | int | bool | None,
) -> Splats:
    """Train a splat from posed photos: Gaussians, and identities if there are label maps.

    Follows StyleSplat and Gaussian Grouping, with 3DGS-MCMC densification.

    Args:
        capture: Posed photos, from `load`.
        config: How to train; the default preset if not given.
        device: `auto` takes an NVIDIA GPU where there is one.
        settings: Fields of `TrainConfig` to change, such as `steps=2000`.

    Raises:
        StyleSplatError: If the capture leaves nothing to train on.

    Example:
        >>> import stylesplat as ss
        >>> splats = ss.train(ss.load("garden/"), max_seconds=120)  # doctest: +SKIP
    """
    config = replace(config or TrainConfig(), **settings)
    device = pick_device(device)
    return fit(capture, config, device=device).splats.detach()


def _begin(
    capture: Capture,
    config: TrainConfig,
    device: torch.device,
    generator: torch.Generator,
    checkpoint: Path | None,
) -> State:
    if checkpoint is not None and checkpoint.exists():
        state, random = load_checkpoint(checkpoint, config, device)
        generator.set_state(random)
        return state
    splats = first_splats(
        capture,
        sh_degree=config.sh_degree,
        max_gaussians=config.max_gaussians,
        generator=generator,
    )
    return first_state(splats.to(device))


def _warm_up(run: Run, state: State) -> None:
    """Compile the kernels before the clock starts, by steps on a copy; leaves no trace."""
    if run.progress(state) >= 1:
        return
    random = run.generator.get_state()
    for step in range(min(run.config.identity_every, 2)):  # with and without identities
        _step(run, replace(state.clone(), step=step))
    run.generator.set_state(random)


def _step(run: Run, state: State) -> tuple[State, float, float]:
    start = time.perf_counter()
    progress, config = run.progress(state), run.config
    info, loss, psnr = _gradients(run, state)
    unit = run.extent * schedule.means_decay(progress)
    rates = RATES | dict.fromkeys(CLASSIFIER, config.classifier_rate)
    rates |= {"means": config.means_rate * unit, "shN": config.bands_rate}
    seen = (info["radii"][0] > 0).all(dim=-1)
    adam_step(state.params, state.moments, rates, state.step + 1, seen)
    growth.add_noise(state.params, unit, run.generator)
    params, moments = state.params, state.moments
    refining = state.step % config.refine_every == config.refine_every - 1
    if refining and config.object_pixels is not None:
        limit_sizes(state.splats.detach(), run.cameras, config.object_pixels)
    if refining and progress < REFINE_END:
        count = schedule.gaussian_count(progress, state.first_count, config)
        params, moments = growth.refine(
            *(params, moments, state.names, count, run.generator),
            preference=growth_preference(state.splats, config.object_growth),
        )
    seconds = state.seconds + time.perf_counter() - start
    state = replace(state, params=params, moments=moments, step=state.step + 1, seconds=seconds)
    return state, loss, psnr


def _gradients(run: Run, state: State) -> tuple[Info, float, float]:
    """Fill `.grad` of the parameters for one photo; also its loss and PSNR."""
    progress, config = run.progress(state), run.config
    row = run.row(state.step)
    factor = schedule.photo_downscale(progress, run.cameras[row].size, config)
    camera, photo, classes = run.views(row, factor)
    if state.step % config.identity_every != 0:
        classes = None
    for param in state.params.values():
        param.grad = None
    splats = state.splats
    render, _, info = rasterize(
        splats,
        camera,
        features=None if classes is None else splats.identities,
        features_move_geometry=config.identity_geometry,
        sh_degree=schedule.sh_degree(progress, config),
    )
    image, rendered = render[0].split([3, render.shape[-1] - 3], dim=-1)
    loss, error = photometric_loss(image, photo)
    loss = loss + growth.regularizer(state.params)
    if classes is not None:
        loss = loss + _identity_losses(run, state, rendered, classes)
    loss.backward()
    return info, float(loss.detach()), float(-10 * torch.log10(error.clamp(min=1e-10)))


def _identity_losses(run: Run, state: State, rendered: Tensor, classes: Tensor) -> Tensor:
    splats, stride = state.splats, run.config.identity_stride
    assert splats.identities is not None and splats.classifier is not None
    y, x = torch.randint(stride, (2,), generator=run.generator).tolist()
    pixels, targets = rendered[y::stride, x::stride], classes[y::stride, x::stride]
    loss = identity_loss(pixels.flatten(0, 1), targets.flatten(), splats.classifier)
    if state.step // run.config.identity_every % NEIGHBOR_EVERY == 0 and len(splats) > NEIGHBORS:
        sample, neighbors = _neighbors(splats.means.detach().cpu(), run.generator)
        loss = loss + neighbor_loss(
            splats.identities[sample], splats.identities[neighbors], splats.classifier
        )
    return loss


def _neighbors(means: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Some Gaussians and the nearest others of each."""
    sample = torch.randint(len(means), (min(NEIGHBOR_SAMPLES, len(means)),), generator=generator)
    points = means.numpy()
    nearest = np.asarray(KDTree(points).query(points[sample.numpy()], k=NEIGHBORS + 1)[1])
    return sample, torch.from_numpy(nearest[:, 1:])
