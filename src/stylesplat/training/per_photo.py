"""What is learned of each photo and is no part of the splat: its colours, and where it was taken.

The means over the photos are held at nothing, so that the splat has the colours of the typical
photo, and the world frame stays.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.progress import say
from stylesplat.training import schedule
from stylesplat.training.adam import Moments, adam_step
from stylesplat.training.photo_gains import photo_gains
from stylesplat.training.run import Run
from stylesplat.training.state import PER_PHOTO, State

# At first; a gain of 1.6 in light is a change of 0.24, and half a degree is 0.009
RATES = {"color_maps": 5e-3, "pose_shifts": 2e-3}
WEIGHTS = {"color_maps": 0.01, "pose_shifts": 1.0}  # of their squares: what is not told stays 0
DECAY = 0.1  # last rate over the first
# Spread of the logarithms of gains from which on photos differ: real photos of fixed exposure have
# 0.05, exposures of 0.6 to 1.6 in light 0.12 to 0.15, red and blue 0.3 off in turn 0.15
VARIED = 0.09


def first_of_photos(run: Run, points: Float[Tensor, "M 3"] | None) -> dict[str, Tensor]:
    """What is to be learned of the photos, as a run begins; one row per training photo.

    Args:
        run: What stays the same.
        points: Sparse points in the world, from which exposures are told.
    """
    shifts = {"pose_shifts": torch.zeros(len(run.rows), 6)} if run.config.refine_poses else {}
    return {name: each.to(run.device) for name, each in (_first_maps(run, points) | shifts).items()}


def regularizer(params: dict[str, Tensor], row: int) -> Float[Tensor, ""] | float:
    """Pulls what is learned of a photo towards nothing."""
    names = [name for name in PER_PHOTO if name in params]
    return sum((WEIGHTS[name] * params[name][row].square().sum() for name in names), 0.0)


def _first_maps(run: Run, points: Float[Tensor, "M 3"] | None) -> dict[str, Tensor]:
    """Changes of colours to start from; none if they are not wanted."""
    wanted = run.config.color_correction
    if points is None or not len(points):
        points = None
    if wanted == "off" or (wanted == "auto" and points is None):
        return {}
    gains = torch.zeros(len(run.rows), 3)
    if points is not None:
        gains = photo_gains(points, lambda row: run.views(row, _coarsest(run, row)), run.rows)
    spread = gains.std(dim=0, correction=0).max().item()  # of the channel that differs most
    if wanted == "auto" and spread < VARIED:
        return {}
    if wanted == "auto":
        say(
            "The photos differ in exposure or white balance: training learns how, and keeps it out "
            "of the splat."
        )
    factors = gains.exp() - gains.exp().mean(dim=0)
    changes = torch.cat([torch.diag_embed(factors), torch.zeros(len(gains), 3, 1)], dim=2)
    return {"color_maps": changes}


def step_photo(run: Run, state: State) -> None:
    """Adam for what is learned of the photo of a step, in place; each photo has its own clock.

    Args:
        run: What stays the same.
        state: Before the step, with gradients.
    """
    names = [name for name in PER_PHOTO if name in state.params]
    if not names:
        return
    row = run.rows.index(run.row(state.step))
    params = {name: _own_row(state.params[name], row) for name in names}
    rates = {name: RATES[name] * DECAY ** run.progress(state) for name in names}
    visit = state.step // len(run.rows) + 1  # each photo comes once before any comes again
    adam_step(params, _own_moments(state.moments, names, row), rates, visit)
    with torch.no_grad():
        for name in names:
            state.params[name].sub_(state.params[name].mean(dim=0))


def _own_row(param: Tensor, row: int) -> Tensor:
    """One row, which shares its numbers with the tensor, and its gradient."""
    own = param.detach()[row : row + 1]
    own.grad = None if param.grad is None else param.grad[row : row + 1]
    return own


def _own_moments(moments: Moments, names: list[str], row: int) -> Moments:
    first, second = (
        {name: tensors[name][row : row + 1] for name in names}
        for tensors in (moments.first, moments.second)
    )
    return Moments(first, second)


def _coarsest(run: Run, row: int) -> int:
    return schedule.photo_downscale(0.0, run.cameras[row].size, run.config)
