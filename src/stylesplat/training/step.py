"""One round of training: gradients of some photos, Adam, noise, and now and then densification."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import ceil
from typing import Any

import torch
import torch.distributed as dist
from jaxtyping import Float, Int, Integer
from torch import Tensor

from stylesplat.imaging.similarity import decibels
from stylesplat.rendering.render import rasterize
from stylesplat.scene.projection import depths_of
from stylesplat.training import per_photo
from stylesplat.training.adam import AdamUpdate, adam_steps
from stylesplat.training.config import LEVELS, TrainConfig, means_decay
from stylesplat.training.densification import supported_kwargs
from stylesplat.training.losses import (
    NO_CLASS,
    depth_phases,
    depth_scatter,
    identity_loss,
    neighbor_loss,
    photometric_loss,
    sample_neighbors,
    split_render,
)
from stylesplat.training.state import (
    CLASSIFIER,
    PER_PHOTO,
    PhotoGradients,
    RandomStream,
    State,
    TrainingRun,
)
from stylesplat.training.views import VIEW_AHEAD

# The official code's learning rates; those of the means, the higher colour bands and the
# classifier are settings.
STEP_RATES = {"quats": 1e-3, "scales": 5e-3, "opacities": 5e-2, "sh0": 2.5e-3}
IDENTITY_RATE = 2.5e-3
NEIGHBOR_EVERY = 5  # identity steps between uses of the 3D loss (Gaussian Grouping)
NEIGHBOR_SAMPLES = 1000
STEP_NEIGHBORS = 5
SCATTER_EVERY = 2  # rounds between those that have the loss of depths
SCATTER_START = 0.4  # share of the run from which on: the number of Gaussians has grown


def train_step(run: TrainingRun, state: State) -> tuple[State, Float[Tensor, "2"]]:
    """Train on the photos of one more round.

    Threads compute the photos' gradients in parallel. Then Adam takes one step per photo, with
    gradients that are as old as the round. For a few photos this costs no measurable quality
    (Langford, Smola and Zinkevich 2009, "Slow learners are fast") and needs no other rates. The
    strategy then moves, adds and removes Gaussians. Several GPUs exchange their gradients, and take
    one step for the whole round by the mean. Returns the next state, in the same tensors unless
    Gaussians were moved or added; and the means of loss and PSNR.
    """
    compute = partial(photo_gradients, run, state)
    photos = run.exchange([*run.pool.in_order(compute, run.own_steps(state))])
    apply_gradients(run, photos)
    scores = torch.stack([each.scores for each in photos]).mean(dim=0)
    return densify(run, state, photos), scores


def photo_gradients(run: TrainingRun, state: State, step: int) -> PhotoGradients:
    """Compare a render with the photo of a step.

    Where a photo is transparent, it and the render are laid over the same colour, by default a
    random one: only Gaussians that are as transparent fit all colours.
    """
    state = state.detached_copy(state.step if run.processes > 1 else step)
    config, generator = run.config, run.generator(step)
    params, progress, row = state.params, run.progress(state), run.row(step)
    place = run.rows.index(row)  # in the `PER_PHOTO` tensors
    view = run.views(row, config.photo_downscale(progress, run.cameras[row].size))
    later = run.row(step + VIEW_AHEAD * run.processes)
    run.views.expect(later, config.photo_downscale(progress, run.cameras[later].size))
    learns_identities = run.is_due(config.identity_every, state.step)
    classes = view.classes if learns_identities else None
    splats, changes, camera = state.splats, params.get("color_maps"), view.camera
    if "pose_shifts" in params:
        shifts = params["pose_shifts"][place : place + 1]
        camera = per_photo.shift_cameras(camera, shifts, run.extent)
    background, target = None, view.photo
    if view.alpha is not None:
        level = LEVELS.get(config.background)
        background = torch.rand(3, generator=generator, device=run.device)
        background = background if level is None else torch.full_like(background, level)
        target = target + (1 - view.alpha) * background
    phases = None
    if classes is None and pulls_depths(run, state):
        phases = depth_phases(depths_of(splats.means, camera))
    render, alphas, info = rasterize(
        splats,
        camera,
        features=phases if classes is None else splats.identities,
        features_move_geometry=phases is not None or config.identity_geometry,
        background=background if changes is None else None,
        sh_degree=config.active_sh_degree(progress, state.step),
        raise_clamped=True,
    )
    image, identities, scatter = render.squeeze(0), None, 0.0
    (y, x), stride = run.offset(step), config.identity_stride
    if classes is not None:
        image, identities = split_render(image, (y, x), stride)
    if phases is not None:
        image, composed = image.split([3, 2], dim=-1)
        scatter = SCATTER_EVERY * config.scatter_weight * depth_scatter(composed, alphas[0])
    if changes is not None:
        image = per_photo.apply_color_map(image, alphas[0], changes[place])
        if background is not None:
            image = image + (1 - alphas[0]) * background
        target = per_photo.blown_out_target(image, target)
    loss, error = photometric_loss(image, target, view.valid)
    loss = loss + scatter + per_photo.per_photo_regularizer(params, place)
    if identities is not None and classes is not None:
        sampled = classes[y::stride, x::stride].long()
        if view.valid is not None:
            sampled = sampled.where(view.valid[y::stride, x::stride], NO_CLASS)
        loss = loss + _identity_losses(run, state, (identities, sampled), generator)
    width, height = camera.size
    info = {**info, **_run_info(run, state), "loss": loss, "n_cameras": 1}
    info |= {"width": width, "height": height, "gaussian_ids": None}  # as gsplat's, not packed
    run.strategy.step_pre_backward(*state.gaussians(), state.strategy_state, state.step, info)
    loss = info.pop("loss")
    loss.backward()
    visible = (info["radii"][0] > 0).all(dim=-1)
    scores = torch.stack([loss.detach(), decibels(error)])
    return PhotoGradients(state, visible, scores, info, run.processes, learns_identities)


def pulls_depths(run: TrainingRun, state: State) -> bool:
    """Whether a step draws what each pixel mixes to one depth, unless it learns identities."""
    due = run.is_due(SCATTER_EVERY, state.step + run.batch)  # by turns with identities
    return due and run.config.scatter_weight > 0 and run.progress(state) >= SCATTER_START


def first_pulled(run: TrainingRun, state: State) -> State:
    """The state as it is counted at the first step for which `pulls_depths` may be."""
    config = run.config
    rounds = ceil(SCATTER_START * config.steps / run.batch) // SCATTER_EVERY + 1
    seconds = SCATTER_START * (config.max_seconds or 0.0)
    return replace(state, step=(SCATTER_EVERY * rounds - 1) * run.batch, seconds=seconds)


def _run_info(run: TrainingRun, state: State) -> dict[str, Any]:
    """What a strategy is told of the run; see `Strategy`."""
    return {
        "progress": run.progress(state),
        "first_count": state.first_count,
        "classifier": state.splats.classifier,
        "generator": run.generator(state.step, RandomStream.MOVE),
    }


def _identity_losses(
    run: TrainingRun,
    state: State,
    view: tuple[Float[Tensor, "h w 16"], Integer[Tensor, "h w"]],
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """The loss of sampled pixels, and now and then that of neighbours in 3D."""
    splats = state.splats
    assert splats.identities is not None and splats.classifier is not None
    pixels, targets = (each.flatten(0, 1) for each in view)
    loss = identity_loss(pixels, targets, splats.classifier)
    compares = run.is_due(run.config.identity_every * NEIGHBOR_EVERY, state.step)
    if compares and len(splats) > STEP_NEIGHBORS:
        means, count = splats.means.detach(), min(NEIGHBOR_SAMPLES, len(splats))
        sample, neighbors = sample_neighbors(means, count, STEP_NEIGHBORS, generator)
        own, others = take_rows(splats.identities, sample), take_rows(splats.identities, neighbors)
        loss = loss + neighbor_loss(own, others, splats.classifier)
    return loss


def take_rows(
    table: Float[Tensor, "N D"], rows: Int[Tensor, "*shape"]
) -> Float[Tensor, "*shape D"]:
    """`table[rows]`, whose gradient is added up in order on the CPU; that of indexing is not."""
    return table.index_select(0, rows.flatten()).unflatten(0, rows.shape)


def exchange_gradients(own: Sequence[PhotoGradients]) -> Sequence[PhotoGradients]:
    """The mean gradients over all processes' photos, one of each; changes those of the photo.

    `PER_PHOTO` tensors get sums, because each row has the gradient of its photo alone.
    """
    (photo,) = own
    skipped = () if photo.learns_identities else ("identities", *CLASSIFIER)
    gradients = dict[str, Tensor]()
    for name, param in photo.state.params.items():
        if name not in skipped:
            param.grad = torch.zeros_like(param) if param.grad is None else param.grad
            gradients[name] = param.grad  # zeros without a label map
    visible, scores = photo.visible.int(), photo.scores
    tensors = (*gradients.values(), visible, scores)
    for work in [dist.all_reduce(each, async_op=True) for each in tensors]:
        assert work is not None
        work.wait()
    for name in gradients.keys() - {*PER_PHOTO}:
        gradients[name].div_(photo.photos)
    return [photo._replace(visible=visible > 0, scores=scores / photo.photos)]


def apply_gradients(run: TrainingRun, photos: Sequence[PhotoGradients]) -> None:
    """Adam for each photo in turn, in place."""
    updates = [
        AdamUpdate(
            {name: param for name, param in each.state.params.items() if name not in PER_PHOTO},
            learning_rates(run.config, run.extent, run.progress(each.state)),
            each.state.step + each.photos,
            each.visible,
        )
        for each in photos
    ]
    adam_steps(photos[0].state.moments, updates, photos=photos[0].photos)
    for each in photos:
        for step in range(each.state.step, each.state.step + each.photos):
            per_photo.step_photo(run, replace(each.state, step=step))


def learning_rates(config: TrainConfig, extent: float, progress: float) -> dict[str, float]:
    """The learning rate of each tensor at this share of the run."""
    rates = {name: config.rate_factor * rate for name, rate in STEP_RATES.items()}
    rates |= {"means": config.means_rate * extent * means_decay(progress)}
    rates |= {"shN": config.bands_rate, "identities": IDENTITY_RATE}
    rates |= dict.fromkeys(CLASSIFIER, config.classifier_rate)
    remaining = 1 - progress
    factor = remaining / config.cooldown if remaining < config.cooldown else 1.0
    return {name: factor * rate for name, rate in rates.items()}


def densify(run: TrainingRun, state: State, photos: Sequence[PhotoGradients]) -> State:
    """The state after the round: the strategy has its turn after each step."""
    end = state.step + sum(each.photos for each in photos)
    gaussians, after = state.gaussians(), run.strategy.step_post_backward
    for each in photos:
        info = each.info | _run_info(run, each.state)
        info |= {"photos": each.photos, "round": range(state.step, end), "visible": each.visible}
        info["means_grad"] = each.state.params["means"].grad
        rates = learning_rates(run.config, run.extent, run.progress(each.state))
        rate = supported_kwargs(after, lr=rates["means"])
        after(*gaussians, state.strategy_state, each.state.step, info, **rate)
    return replace(state.with_gaussians(*gaussians), step=end)
