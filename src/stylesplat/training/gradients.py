"""The losses of one step and their gradients (StyleSplat section 3.3)."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int, Integer
from torch import Tensor

from stylesplat.metrics.psnr import decibels
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.training import growth, per_photo, schedule
from stylesplat.training.color_maps import aim, mapped
from stylesplat.training.losses import identity_loss, neighbor_loss, photometric_loss
from stylesplat.training.parts import parts_for
from stylesplat.training.pose_shifts import moved
from stylesplat.training.run import Run
from stylesplat.training.state import State
from stylesplat.training.taken_apart import taken_apart
from stylesplat.training.training_views import View

NEIGHBOR_EVERY = 5  # identity steps between looks at the neighbours in 3D (Gaussian Grouping)
NEIGHBOR_SAMPLES = 1000
NEIGHBORS = 5


class Outcome(NamedTuple):
    """What a step finds; nothing of it has been waited for."""

    seen: Bool[Tensor, " N"]
    """Which Gaussians the camera sees."""
    scores: Float[Tensor, "2"]
    """Loss and PSNR."""


def fill_gradients(run: Run, state: State, generator: torch.Generator) -> Outcome:
    """Compare a render with the photo of the step, and fill `.grad` of the parameters.

    Where a photo is transparent, it and the render are laid over the same random colour: only
    Gaussians that are as transparent fit all colours.

    Args:
        run: What stays the same.
        state: Before the step.
        generator: Source of randomness, on the device.
    """
    progress, config = run.progress(state), run.config
    row = run.row(state.step)
    place = run.rows.index(row)  # in what is learned of each photo
    factor = schedule.photo_downscale(progress, run.cameras[row].size, config)
    view = run.views(row, factor)
    classes = view.classes if run.every(config.identity_every, state.step) else None
    for param in state.params.values():
        param.grad = None
    splats, changes = state.splats, state.params.get("color_maps")
    background, target = _behind(view, generator)
    render, alphas, info = rasterize(
        splats,
        _camera(run, view, state.params.get("pose_shifts"), place),
        features=None if classes is None else splats.identities,
        features_move_geometry=config.identity_geometry,
        background=background if changes is None else None,
        sh_degree=schedule.sh_degree(progress, state.step, config),
    )
    image, sampled = render.squeeze(0), None
    if classes is not None:
        (y, x), stride = run.offset(state.step), config.identity_stride
        image, identities = taken_apart(image, (y, x), stride)
        sampled = identities, classes[y::stride, x::stride]
    if changes is not None:
        image = mapped(image, alphas[0], changes[place])
        if background is not None:
            image = image + (1 - alphas[0]) * background
        target = aim(image, target)
    loss, error = photometric_loss(image, target)
    loss = loss + per_photo.regularizer(state.params, place)
    loss = loss + growth.regularizer(state.params, run.extent)
    if sampled is not None:
        loss = loss + _identity_losses(run, state, sampled, generator)
    loss.backward()
    seen = (info["radii"][0] > 0).all(dim=-1)
    return Outcome(seen, torch.stack([loss.detach(), decibels(error)]))


def _camera(run: Run, view: View, shifts: Float[Tensor, "R 6"] | None, place: int) -> Cameras:
    """Of the photo of a step, as far as it is known by now."""
    return (
        view.camera if shifts is None else moved(view.camera, shifts[place : place + 1], run.extent)
    )


def _behind(
    view: View, generator: torch.Generator
) -> tuple[Float[Tensor, "3"] | None, Float[Tensor, "H W 3"]]:
    """The colour behind everything, None for black; and the photo before it."""
    if view.alpha is None:
        return None, view.photo
    color = torch.rand(3, generator=generator, device=view.photo.device)
    return color, view.photo + (1 - view.alpha) * color


def _identity_losses(
    run: Run,
    state: State,
    view: tuple[Float[Tensor, "h w 16"], Integer[Tensor, "h w"]],
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Of some pixels' rendered identities and classes; now and then of neighbours in 3D too."""
    splats = state.splats
    assert splats.identities is not None and splats.classifier is not None
    pixels, targets = (each.flatten(0, 1) for each in view)
    loss = identity_loss(pixels, targets.long(), splats.classifier)
    looks = run.every(run.config.identity_every * NEIGHBOR_EVERY, state.step)
    if looks and len(splats) > NEIGHBORS:
        sample, neighbors = neighbors_of_some(splats.means.detach(), generator)
        own, others = rows_of(splats.identities, sample), rows_of(splats.identities, neighbors)
        loss = loss + neighbor_loss(own, others, splats.classifier)
    return loss


def rows_of(table: Float[Tensor, "N D"], rows: Int[Tensor, "*shape"]) -> Float[Tensor, "*shape D"]:
    """`table[rows]`, whose gradient is added up in order on the CPU; that of indexing is not."""
    return table.index_select(0, rows.flatten()).unflatten(0, rows.shape)


def neighbors_of_some(
    means: Float[Tensor, "N 3"], generator: torch.Generator
) -> tuple[Int[Tensor, " S"], Int[Tensor, "S k"]]:
    """Rows of random Gaussians, and of the nearest others of each.

    Args:
        means: More of them than neighbours.
        generator: Source of randomness, on their device.
    """
    count = min(NEIGHBOR_SAMPLES, len(means))
    sample = torch.randint(len(means), (count,), generator=generator, device=means.device)
    return sample, parts_for(means.device).nearest(means, sample, NEIGHBORS)
