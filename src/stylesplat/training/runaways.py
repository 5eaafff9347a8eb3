"""Gaussians that have run away: numbers that are not finite, or that no file may hold.

Noise moves large faint Gaussians far; what lies far from everything is never seen, and so never
comes back.
"""

from dataclasses import replace

from stylesplat.errors import StyleSplatError, counted
from stylesplat.progress import say
from stylesplat.training.adam import Moments
from stylesplat.training.densification import sound_rows
from stylesplat.training.state import State


def without_runaways(state: State) -> State:
    """The state without the Gaussians that are not sound, or whose moments are not finite."""
    sound = sound_rows(state.params)
    for moments in (state.moments.first, state.moments.second):
        for name in state.names:
            sound = sound & moments[name][:, None].flatten(1).isfinite().all(dim=1)
    if sound.all():
        return state
    params = {n: state.params[n].detach()[sound].requires_grad_() for n in state.names}
    first, second = (
        moments | {name: moments[name][sound] for name in state.names}
        for moments in (state.moments.first, state.moments.second)
    )
    return replace(state, params=state.params | params, moments=Moments(first, second))


def finished(state: State) -> State:
    """The state at the end of a run, without runaways; a line says how many these were.

    Raises:
        StyleSplatError: If nothing else is left.
    """
    kept = without_runaways(state)
    lost = len(state.splats) - len(kept.splats)
    if not len(kept.splats):
        raise StyleSplatError(
            f"Training came to nothing: no number of its {lost:,} Gaussians is finite. Train again "
            "with a lower means_rate, and check the poses."
        )
    if lost:
        say(f"{counted(lost, 'Gaussian')} ran away beyond all bounds, and were left out.")
    return kept
