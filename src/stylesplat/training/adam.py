"""Adam over named tensors whose rows come and go (Kingma and Ba 2015).

Rows whose Gaussian is invisible in a step keep their value and moments, as in gsplat's
`SelectiveAdam`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.training.device_ops import AdamTurn, device_ops

BETA1, BETA2 = 0.9, 0.999


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
        """The state with other rows in the tensors called `names`; row -1 is zero."""

        def taken(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
            out = dict(tensors)
            for name in names:
                out[name] = tensors[name][rows.clamp(min=0)]
                out[name][rows < 0] = 0
            return out

        return Moments(taken(self.first), taken(self.second))


class AdamUpdate(NamedTuple):
    """One step of Adam over named tensors."""

    params: dict[str, Tensor]
    """Tensors that share their memory with those that are stepped, gradients in `.grad`."""
    rates: dict[str, float]
    """Learning rate of each."""
    step: int
    """Number of the last photo of this step, from 1."""
    visible: Bool[Tensor, " N"] | None = None
    """Rows to update of the tensors with this many rows; None updates all."""


def adam_step(
    params: dict[str, Tensor],
    moments: Moments,
    rates: dict[str, float],
    step: int,
    visible: Bool[Tensor, " N"] | None = None,
) -> None:
    """Update the tensors that have a gradient, and their moments, in place; see `AdamUpdate`."""
    adam_steps(moments, [AdamUpdate(params, rates, step, visible)])


@torch.no_grad()
def adam_steps(moments: Moments, updates: Sequence[AdamUpdate], *, photos: int = 1) -> None:
    """Take several steps, one after the other, in one pass through memory.

    A step for several photos at once, by the mean of their gradients, takes the rate times the
    square root of their number, and moments that fade as in as many steps (Zhao et al. 2024, "On
    Scaling Up 3D Gaussian Splatting Training").

    Args:
        moments: State of the tensors, updated in place.
        updates: The steps.
        photos: The gradients of each are the mean over so many photos.
    """
    kept = BETA1**photos, BETA2**photos
    for name, stepped in updates[0].params.items():
        turns = []
        for params, rates, step, visible in updates:
            param = params[name]
            if param.grad is None:
                continue
            if visible is None or len(visible) != len(param):
                visible = param.new_ones(len(param), dtype=torch.bool)
            corrections = 1 - BETA1**step, 1 - BETA2**step
            turns.append(AdamTurn(param.grad, visible, rates[name] * photos**0.5, corrections))
        if turns:
            adam = device_ops(stepped.device).adam
            adam(stepped.detach(), moments.first[name], moments.second[name], turns, kept)
