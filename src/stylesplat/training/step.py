"""One round of training: gradients, Adam, noise, and now and then growth."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.training import growth, schedule
from stylesplat.training.adam import adam_step
from stylesplat.training.gradients import Outcome, fill_gradients
from stylesplat.training.object_sizes import growth_preference, limit_sizes
from stylesplat.training.per_photo import step_photo
from stylesplat.training.run import Run
from stylesplat.training.state import CLASSIFIER, PER_PHOTO, State
from stylesplat.training.train_config import TrainConfig

# The official code's learning rates; those of the means, the higher colour bands and the
# classifier are settings.
RATES = {
    "quats": 1e-3,
    "scales": 5e-3,
    "opacities": 5e-2,
    "sh0": 2.5e-3,
    "identities": 2.5e-3,
}
REFINE_END = 0.9  # share of the run after which Gaussians are neither moved nor added


class Look(NamedTuple):
    """What a photo of a round tells."""

    state: State
    """The tensors before the round, with their gradients."""
    outcome: Outcome
    """Which Gaussians are seen, and how well."""
    generator: torch.Generator
    """Randomness of the photo's step."""


def train_step(run: Run, state: State) -> tuple[State, Float[Tensor, "2"]]:
    """The state after the photos of one more round; and the means of their loss and PSNR.

    They are looked at together, each by threads of its own, and then a step of Adam is taken for
    each in turn: the gradients of the later ones are as old as the round. That costs nothing that
    can be measured for a few photos (Langford, Smola and Zinkevich 2009, "Slow learners are fast"),
    and unlike one step for all needs no other rates, as Adam's moments are those of single photos.

    The tensors stay the same ones, unless Gaussians are moved or added.
    """
    looks = [*run.crew.in_order(partial(_look, run, state), run.photos(state))]
    for look in looks:
        _take_step(run, look)
    first, last, every = state.step, looks[-1], run.config.refine_every
    state = replace(state, step=last.state.step)
    if (state.step + 1) // every > first // every:
        state = _refined(run, state, last.generator)
    scores = torch.stack([look.outcome.scores for look in looks]).mean(dim=0)
    return replace(state, step=state.step + 1), scores


def _look(run: Run, state: State, step: int) -> Look:
    own, generator = state.beside(step), run.generator(step)
    return Look(own, fill_gradients(run, own, generator), generator)


def _take_step(run: Run, look: Look) -> None:
    """Adam and noise for one photo, in place."""
    state, decay = look.state, schedule.means_decay(run.progress(look.state))
    scene = {name: param for name, param in state.params.items() if name not in PER_PHOTO}
    now = rates(run.config, run.extent * decay)
    adam_step(scene, state.moments, now, state.step + 1, look.outcome.seen)
    step_photo(run, state)
    growth.add_noise(state.params, run.extent, decay, look.generator)


def rates(config: TrainConfig, unit: float) -> dict[str, float]:
    """The learning rate of each tensor.

    Args:
        config: Settings.
        unit: Of length, smaller as training goes on.
    """
    classifier = dict.fromkeys(CLASSIFIER, config.classifier_rate)
    return RATES | classifier | {"means": config.means_rate * unit, "shN": config.bands_rate}


def _refined(run: Run, state: State, generator: torch.Generator) -> State:
    config, progress = run.config, run.progress(state)
    if config.object_pixels is not None:
        limit_sizes(state.splats.detach(), run.cameras, config.object_pixels)
    if progress >= REFINE_END:
        return state
    params, moments = growth.refine(
        state.params,
        state.moments,
        state.names,
        schedule.gaussian_count(progress, state.first_count, config),
        generator,
        preference=growth_preference(state.splats, config.object_growth),
    )
    return replace(state, params=params, moments=moments)
