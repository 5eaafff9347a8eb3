"""What training learns of each photo apart from the splat: its colours and its camera.

The means over the photos are held at nothing, so that the splat has the colours of the typical
photo, and the world frame stays.

A colour map takes the scene's colours to those of a photo: an affine map of sRGB values, as in
INRIA's code and gsplat, for exposure and white balance. It matches gains of 0.6 to 1.6 in linear
light, with a tint, to 58 dB, as measured on photos; except for what is blown out.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.imaging.color import photo_gains
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.adam import Moments, adam_step
from stylesplat.training.state import PER_PHOTO, State, TrainingRun
from stylesplat.training.views import TrainingView

# First learning rates: a gain of 1.6 in light is a change of 0.24, and half a degree is 0.009
PER_PHOTO_RATES = {"color_maps": 5e-3, "pose_shifts": 2e-3}
WEIGHTS = {"color_maps": 0.01, "pose_shifts": 1.0}  # of their squares, which the loss adds
DECAY = 0.1  # last rate over the first
BLOWN_OUT = 0.99  # of a photo's channel: the photo does not contain how bright the scene was
FIT_PRIOR = 1e-4  # pull towards no change, over the mean square of what is fitted with
# Spread of the logarithms of gains from which on photos differ: real photos of fixed exposure have
# 0.05, exposures of 0.6 to 1.6 in light 0.12 to 0.15, red and blue 0.3 off in turn 0.15
PER_PHOTO_VARIED = 0.09


def initial_photo_params(
    run: TrainingRun, points: Float[Tensor, "M 3"] | None
) -> dict[str, Tensor]:
    """The `PER_PHOTO` tensors that a run learns, as it begins; one row per training photo."""
    first = dict[str, Tensor]()
    if run.config.refine_poses:
        first["pose_shifts"] = torch.zeros(len(run.rows), 6, device=run.device)
    wanted = run.config.color_correction
    has_points = points is not None and len(points) > 0
    if wanted == "off" or (wanted == "auto" and not has_points):
        return first
    gains = torch.zeros(len(run.rows), 3)
    if points is not None and has_points:
        views = run.all_views("comparing exposures", 0.0)
        photos = ((_valid_photo(view), view.camera) for view in views)
        gains = photo_gains(points, photos).nan_to_num()
    if wanted == "auto":
        spread = gains.std(dim=0, correction=0).max()  # of the channel that differs most
        if spread < PER_PHOTO_VARIED:
            return first
        say(
            "The photos differ in exposure or white balance. Training learns these differences "
            "and keeps them out of the splat."
        )
    factors = gains.exp() - gains.exp().mean(dim=0)
    maps = torch.cat([torch.diag_embed(factors), torch.zeros(len(gains), 3, 1)], dim=2)
    return {"color_maps": maps.to(run.device)} | first


def _valid_photo(view: TrainingView) -> Float[Tensor, "H W 3"]:
    """The photo, black where pixels are not to be used: black says nothing about exposure."""
    return view.photo if view.valid is None else view.photo * view.valid[..., None]


def per_photo_regularizer(params: dict[str, Tensor], row: int) -> Float[Tensor, ""] | float:
    """Pulls the `PER_PHOTO` rows of a photo towards 0."""
    names = [name for name in PER_PHOTO if name in params]
    return sum((WEIGHTS[name] * params[name][row].square().sum() for name in names), 0.0)


def step_photo(run: TrainingRun, state: State) -> None:
    """Adam for the `PER_PHOTO` rows of a step's photo, in place; each photo counts its own steps.

    The state is that before the step, with gradients.
    """
    names = [name for name in PER_PHOTO if name in state.params]
    if not names:
        return
    row = run.rows.index(run.row(state.step))
    params, own = dict[str, Tensor](), slice(row, row + 1)
    for name in names:
        param = state.params[name]
        params[name] = param.detach()[own]  # shares its numbers with the tensor
        params[name].grad = None if param.grad is None else param.grad[own]
    first, second = (
        {name: tensors[name][own] for name in names}
        for tensors in (state.moments.first, state.moments.second)
    )
    rates = {name: PER_PHOTO_RATES[name] * DECAY ** run.progress(state) for name in names}
    visit = state.step // len(run.rows) + 1  # each photo comes once before any comes again
    adam_step(params, Moments(first, second), rates, visit)
    with torch.no_grad():
        for name in names:
            state.params[name].sub_(state.params[name].mean(dim=0))


def apply_color_map(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W 1"], change: Float[Tensor, "3 4"]
) -> Float[Tensor, "H W 3"]:
    """A render over black in the colours of a photo; a change of 0 leaves it as it is.

    The coverage scales the offset: black behind everything stays black.
    """
    return image + torch.cat([image, alpha], dim=-1) @ change.mT


def fit_color_map(
    image: Float[Tensor, "H W 3"],
    alpha: Float[Tensor, "H W 1"],
    photo: Float[Tensor, "H W 3"],
    valid: Bool[Tensor, "H W"] | None = None,
) -> Float[Tensor, "3 4"]:
    """The change with which a render is closest to a photo's valid pixels, by ridge regression."""
    inputs = torch.cat([image, alpha], dim=-1).flatten(0, 1).double()
    missing = (photo - image).flatten(0, 1).double()
    counted = (photo < BLOWN_OUT).all(dim=-1)
    counted = counted if valid is None else counted & valid
    weights = counted.flatten()[:, None].to(inputs)
    matrix = (weights * inputs).T @ inputs
    prior = FIT_PRIOR * matrix.trace().clamp(min=1) * torch.eye(4).to(matrix)
    return torch.linalg.solve(matrix + prior, (weights * inputs).T @ missing).T.to(image)


def blown_out_target(
    image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]
) -> Float[Tensor, "H W 3"]:
    """The target, where a blown-out pixel has the value of a brighter image."""
    brighter = torch.maximum(image.detach(), target)
    return torch.where(target >= BLOWN_OUT, brighter, target)


def shift_cameras(cameras: Cameras, shifts: Float[Tensor, "C 6"], unit: float) -> Cameras:
    """Cameras turned about their centres and shifted; differentiable by the shifts.

    A row of shifts is axis times angle in the world, in radians, and the shift in units of length.
    """
    viewmats = cameras.viewmats.to(shifts)
    axes = shifts[:, :3]
    identity = torch.eye(3, dtype=shifts.dtype, device=shifts.device)
    cross = torch.linalg.cross(axes[:, None].expand(-1, 3, -1), identity.expand(len(axes), 3, 3))
    cross = cross.mT  # as the product with it
    # Rodrigues' formula, for which a GPU is not waited for, as for a matrix exponential
    angles = axes.norm(dim=1)[:, None, None] / torch.pi
    turns = identity + angles.sinc() * cross + (angles / 2).sinc() ** 2 / 2 * cross @ cross
    rotations = viewmats[:, :3, :3] @ turns.mT
    positions = cameras.positions.to(shifts) + unit * shifts[:, 3:]
    upper = torch.cat([rotations, -rotations @ positions[:, :, None]], dim=2)
    return replace(cameras, viewmats=torch.cat([upper, viewmats[:, 3:]], dim=1))


def with_refined_cameras(capture: Capture, state: State, rows: Sequence[int]) -> Capture:
    """The capture with refined cameras of the rows trained on; unchanged if none were refined."""
    shifts = state.params.get("pose_shifts")
    if shifts is None:
        return capture
    unit, shifts = scene_extent(capture.cameras), shifts.detach().cpu()

    def found(cameras: Cameras) -> Cameras:
        viewmats = cameras.viewmats.clone()
        viewmats[list(rows)] = shift_cameras(cameras[rows], shifts.to(viewmats), unit).viewmats
        return replace(cameras, viewmats=viewmats)

    full = None if capture.full is None else found(capture.full)
    return replace(capture, cameras=found(capture.cameras), full=full)
