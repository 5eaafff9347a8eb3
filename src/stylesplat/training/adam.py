"""Adam over named tensors whose rows come and go (Kingma and Ba 2015).

Rows whose Gaussian is in no view of a step keep their value and moments, as in gsplat's
`SelectiveAdam`.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.training.parts import AdamStep, parts_for

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


@torch.no_grad()
def adam_step(
    params: dict[str, Tensor],
    moments: Moments,
    rates: dict[str, float],
    step: int,
    seen: Bool[Tensor, " N"] | None = None,
    *,
    photos: int = 1,
) -> None:
    """Update the tensors that have a gradient in place.

    A step for several photos at once, by the mean of their gradients, takes the rate times the
    square root of their number, and moments that fade as in as many steps (Zhao et al. 2024, "On
    Scaling Up 3D Gaussian Splatting Training").

    Args:
        params: Tensors, with their gradients in `.grad`.
        moments: Their state, updated in place.
        rates: Learning rate of each.
        step: Number of the last photo of this step, from 1.
        seen: Rows to update of the tensors with this many rows; None updates all.
        photos: How many the gradients are the mean of.
    """
    corrections, kept = (1 - BETA1**step, 1 - BETA2**step), (BETA1**photos, BETA2**photos)
    for name, param in params.items():
        if param.grad is None:
            continue
        some = seen if seen is not None and len(seen) == len(param) else None
        update = AdamStep(
            param=param.detach(),
            grad=param.grad,
            first=moments.first[name],
            second=moments.second[name],
            rows=param.new_ones(len(param), dtype=torch.bool) if some is None else some,
            rate=rates[name] * photos**0.5,
            corrections=corrections,
            kept=kept,
        )
        parts_for(param.device).adam(update)
