"""Adam over named tensors whose rows come and go (Kingma and Ba 2015).

Rows whose Gaussian is in no view of a step keep their value and moments, as in gsplat's
`SelectiveAdam`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.training.parts import AdamSteps, Turn, parts_for

BETA1, BETA2 = 0.9, 0.999
EPS = 1e-15  # the 3D Gaussian splatting code's


@dataclass(frozen=True)
class Moments:
    """Running means of the gradients and their squares, by name."""

    first: dict[str, Tensor]
    second: dict[str, Tensor]

    @classmethod
    def zeros(cls, params: dict[str, Tensor]) -> "Moments":
        """The state before the first step."""
        return cls(*({k: torch.zeros_like(v) for k, v in params.items()} for _ in range(2)))

    def clone(self) -> "Moments":
        """A copy that shares no tensors."""
        first, second = ({k: v.clone() for k, v in t.items()} for t in (self.first, self.second))
        return Moments(first, second)

    def take(self, rows: Int[Tensor, " M"], names: tuple[str, ...]) -> "Moments":
        """The same state with other rows in the tensors called `names`; row -1 is zero."""

        def taken(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
            fresh = rows < 0
            out = dict(tensors)
            for name in names:
                out[name] = tensors[name][rows.clamp(min=0)]
                out[name][fresh] = 0
            return out

        return Moments(taken(self.first), taken(self.second))


class Update(NamedTuple):
    """One step of Adam over named tensors."""

    params: dict[str, Tensor]
    """Tensors that share their memory with those that are stepped, gradients in `.grad`."""
    rates: dict[str, float]
    """Learning rate of each."""
    step: int
    """Number of the last photo of this step, from 1."""
    seen: Bool[Tensor, " N"] | None = None
    """Rows to update of the tensors with this many rows; None updates all."""

    def turn(self, name: str, photos: int) -> Turn | None:
        """The step of one tensor, if it has a gradient; see `adam_steps`."""
        param, seen = self.params[name], self.seen
        if param.grad is None:
            return None
        some = seen if seen is not None and len(seen) == len(param) else None
        return Turn(
            grad=param.grad,
            rows=param.new_ones(len(param), dtype=torch.bool) if some is None else some,
            rate=self.rates[name] * photos**0.5,
            corrections=(1 - BETA1**self.step, 1 - BETA2**self.step),
        )


def adam_step(
    params: dict[str, Tensor],
    moments: Moments,
    rates: dict[str, float],
    step: int,
    seen: Bool[Tensor, " N"] | None = None,
) -> None:
    """Update the tensors that have a gradient in place.

    Args:
        params: Tensors, with their gradients in `.grad`.
        moments: Their state, updated in place.
        rates: Learning rate of each.
        step: Number of this step, from 1.
        seen: Rows to update of the tensors with this many rows; None updates all.
    """
    adam_steps(moments, [Update(params, rates, step, seen)])


@torch.no_grad()
def adam_steps(moments: Moments, updates: Sequence[Update], *, photos: int = 1) -> None:
    """Several steps, one after the other, in one pass through memory.

    A step for several photos at once, by the mean of their gradients, takes the rate times the
    square root of their number, and moments that fade as in as many steps (Zhao et al. 2024, "On
    Scaling Up 3D Gaussian Splatting Training").

    Args:
        moments: State of the tensors, updated in place.
        updates: What to step by.
        photos: How many the gradients of each are the mean of.
    """
    for name, param in updates[0].params.items():
        turns = [update.turn(name, photos) for update in updates]
        turns = [turn for turn in turns if turn is not None]
        if turns:
            steps = AdamSteps(
                param=param.detach(),
                first=moments.first[name],
                second=moments.second[name],
                turns=turns,
                kept=(BETA1**photos, BETA2**photos),
            )
            parts_for(param.device).adam(steps)
