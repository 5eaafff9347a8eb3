"""One round of training: gradients, Adam, noise, and now and then growth."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
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
REFINE_END = 0.9  # share of the run after which Gaussians are neither moved nor added


class Look(NamedTuple):
    """What a photo of a round tells."""

    state: State
    """The tensors before the round, with their gradients; its step is the photo's."""
    outcome: Outcome
    """Which Gaussians are seen, and how well."""
    noise: Float[Tensor, "N 3"]
    """Standard normal: what moves means at random after the steps of the round."""


def train_step(run: Run, state: State) -> tuple[State, Float[Tensor, "2"]]:
    """The state after the photos of one more round; and the means of their loss and PSNR.

    They are looked at together, each by threads of its own, and then a step of Adam is taken for
    each in turn: the gradients of the later ones are as old as the round. That costs nothing that
    can be measured for a few photos (Langford, Smola and Zinkevich 2009, "Slow learners are fast"),
    and unlike one step for all needs no other rates, as Adam's moments are those of single photos.
    Then noise moves the means, once for each photo.

    Of several processes each looks at photos of its own, and a turn's step is for one photo of
    each, by the mean of their gradients.

    The tensors stay the same ones, unless Gaussians are moved or added.
    """
    first, every, count = state.step, run.config.refine_every, run.ranks.count
    looks = _together(run, run.crew.in_order(partial(_look, run, state), run.photos(state)))
    _take_steps(run, state, looks)
    end = first + count * len(looks)
    if end // every > first // every:
        last = end - count
        state = _refined(run, replace(state, step=last), run.generator(last, MOVES))
    scores = torch.stack([look.outcome.scores for look in looks]).mean(dim=0)
    return replace(state, step=end), scores


def _look(run: Run, state: State, step: int) -> Look:
    own, means = state.beside(step), state.params["means"]
    moves = run.generator(step - run.ranks.number, MOVES)  # the turn's, so alike everywhere
    noise = torch.randn(means.shape, generator=moves, device=means.device)
    return Look(own, fill_gradients(run, own, run.generator(step)), noise)


def _together(run: Run, looks: Iterable[Look]) -> list[Look]:
    """The same with the gradients, the Gaussians seen and the scores of all processes.

    What one photo tells is sent while the next one is looked at.
    """
    if run.ranks.count == 1:
        return [*looks]
    return [ended() for ended in [_begin_to_send(run, look) for look in looks]]


def _begin_to_send(run: Run, look: Look) -> Callable[[], Look]:
    """Wait for the result by calling what is returned."""
    ranks, outcome, params = run.ranks, look.outcome, look.state.params
    learned = run.every(run.config.identity_every, look.state.step)
    skipped = () if learned else ("identities", *CLASSIFIER)
    for name, param in params.items():
        if name not in skipped and param.grad is None:  # a photo without a label map
            param.grad = torch.zeros_like(param)
    gradients = {name: p.grad for name, p in params.items() if p.grad is not None}
    seen = outcome.seen.to(torch.int32)
    wait = ranks.add_up([*gradients.values(), seen, outcome.scores])

    def ended() -> Look:
        wait()
        for name, gradient in gradients.items():
            if name not in PER_PHOTO:  # whose rows have one photo each
                gradient.div_(ranks.count)
        return look._replace(outcome=Outcome(seen > 0, outcome.scores.div_(ranks.count)))

    return ended


def _take_steps(run: Run, state: State, looks: Sequence[Look]) -> None:
    """Adam and noise for each turn, in place."""
    count = run.ranks.count
    firsts = range(state.step, state.step + count * len(looks), count)  # photos of the turns
    decays = [schedule.means_decay(run.progress(replace(state, step=step))) for step in firsts]
    turns = [*zip(firsts, decays, looks, strict=True)]
    updates = [
        Update(
            {name: each for name, each in look.state.params.items() if name not in PER_PHOTO},
            rates(run.config, run.extent * decay),
            first + count,
            look.outcome.seen,
        )
        for first, decay, look in turns
    ]
    adam_steps(state.moments, updates, photos=count)
    for first, decay, look in turns:
        for step in range(first, first + count):
            step_photo(run, replace(look.state, step=step))
        growth.add_noise(look.state.params, run.extent, decay, look.noise, photos=count)


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
