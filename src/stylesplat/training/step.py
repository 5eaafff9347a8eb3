"""One step of training: gradients, Adam, noise, and now and then growth."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.training import growth, schedule
from stylesplat.training.adam import adam_step
from stylesplat.training.gradients import fill_gradients
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


def train_step(run: Run, state: State) -> tuple[State, Float[Tensor, "2"]]:
    """The state after one more step, whose tensors are the same ones; and its loss and PSNR."""
    config, decay = run.config, schedule.means_decay(run.progress(state))
    generator = run.generator(state.step)
    seen, scores = fill_gradients(run, state, generator)
    scene = {name: param for name, param in state.params.items() if name not in PER_PHOTO}
    adam_step(scene, state.moments, rates(config, run.extent * decay), state.step + 1, seen)
    step_photo(run, state)
    growth.add_noise(state.params, run.extent, decay, generator)
    if state.step % config.refine_every == config.refine_every - 1:
        state = _refined(run, state, generator)
    return replace(state, step=state.step + 1), scores


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
