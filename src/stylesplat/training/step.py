"""One round of training: gradients, Adam, noise, and now and then growth."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial, reduce
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.training import growth, schedule
from stylesplat.training.adam import Update, adam_steps
from stylesplat.training.gradients import Outcome, fill_gradients
from stylesplat.training.object_sizes import growth_preference, limit_sizes
from stylesplat.training.per_photo import step_photo
from stylesplat.training.run import MOVES, Run
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


class Look(NamedTuple):
    """What a photo of a round tells, or some photos together."""

    state: State
    """The tensors before the round, with their gradients; its step is the first photo's."""
    outcome: Outcome
    """Which Gaussians are seen, and how well."""
    noise: Float[Tensor, "N 3"]
    """Standard normal: what moves means at random after the steps of the round."""
    photos: int = 1
    """How many the gradients are the mean of."""


def train_step(run: Run, state: State) -> tuple[State, Float[Tensor, "2"]]:
    """The state after the photos of one more round; and the means of their loss and PSNR.

    They are looked at together, each by threads of its own, and then a step of Adam is taken for
    each in turn: the gradients of the later ones are as old as the round. That costs nothing that
    can be measured for a few photos (Langford, Smola and Zinkevich 2009, "Slow learners are fast"),
    and unlike one step for all needs no other rates, as Adam's moments are those of single photos.
    Then noise moves the means, once for each photo.

    Of several processes each looks at photos of its own, and there is one step for all of a round,
    by the mean of their gradients, so that these are sent once.

    The tensors stay the same ones, unless Gaussians are moved or added.
    """
    first, every = state.step, run.config.refine_every
    looks = [*run.crew.in_order(partial(_look, run, state), run.photos(state))]
    if run.ranks.count > 1:
        looks = [_mean(run, looks)]
    _take_steps(run, looks)
    end = first + sum(look.photos for look in looks)
    if end // every > first // every:
        last = end - looks[-1].photos
        state = _refined(run, replace(state, step=last), run.generator(last, MOVES))
    scores = torch.stack([look.outcome.scores for look in looks]).mean(dim=0)
    return replace(state, step=end), scores


def _look(run: Run, state: State, step: int) -> Look:
    own, means = state.beside(step), state.params["means"]
    moves = run.generator(step - run.ranks.number, MOVES)  # alike in all processes
    noise = torch.randn(means.shape, generator=moves, device=means.device)
    return Look(own, fill_gradients(run, own, run.generator(step)), noise)


def _mean(run: Run, looks: Sequence[Look]) -> Look:
    """What the photos of a round tell in all processes: the mean of their gradients, sent once.

    Of what is learned of each photo they are sums, as a row has those of its photo alone. The
    gradients of the looks are used up.
    """
    first, photos = looks[0], run.ranks.count * len(looks)
    learned = any(run.every(run.config.identity_every, look.state.step) for look in looks)
    skipped = () if learned else ("identities", *CLASSIFIER)
    params = first.state.params
    for name in params.keys() - {*skipped}:
        own = [look.state.params[name].grad for look in looks]
        found = [gradient for gradient in own if gradient is not None]  # else: no label map
        params[name].grad = reduce(Tensor.add_, found or [torch.zeros_like(params[name])])
    gradients = {name: p.grad for name, p in params.items() if p.grad is not None}
    seen = torch.stack([look.outcome.seen for look in looks]).sum(dim=0, dtype=torch.int32)
    scores = torch.stack([look.outcome.scores for look in looks]).sum(dim=0)
    run.ranks.add_up([*gradients.values(), seen, scores])
    for name in gradients.keys() - {*PER_PHOTO}:
        gradients[name].div_(photos)
    start = replace(first.state, step=first.state.step - run.ranks.number)
    return Look(start, Outcome(seen > 0, scores.div_(photos)), first.noise, photos)


def _take_steps(run: Run, looks: Sequence[Look]) -> None:
    """Adam and noise for each turn, in place."""
    decays = [schedule.means_decay(run.progress(look.state)) for look in looks]
    updates = [
        Update(
            {name: each for name, each in look.state.params.items() if name not in PER_PHOTO},
            rates(run.config, run.extent * decay),
            look.state.step + look.photos,
            look.outcome.seen,
        )
        for decay, look in zip(decays, looks, strict=True)
    ]
    adam_steps(looks[0].state.moments, updates, photos=looks[0].photos)
    for decay, look in zip(decays, looks, strict=True):
        first, photos = look.state.step, look.photos
        for step in range(first, first + photos):
            step_photo(run, replace(look.state, step=step))
        growth.add_noise(look.state.params, run.extent, decay, look.noise, photos=photos)


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
    if progress >= config.refine_end:
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
