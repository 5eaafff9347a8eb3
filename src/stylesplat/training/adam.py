"""Adam over named tensors whose rows come and go (Kingma and Ba 2015).

Rows whose Gaussian is in no view of a step keep their value and moments, as in gsplat's
`SelectiveAdam`.
"""
# pyright: reportCallIssue=false
# (it cannot count the arguments of starred lists)

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.rendering.kernels.jit import kernel

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
) -> None:
    """Update the tensors that have a gradient in place.

    Args:
        params: Tensors, with their gradients in `.grad`.
        moments: Their state, updated in place.
        rates: Learning rate of each.
        step: Number of this step, from 1.
        seen: Rows to update of the tensors with this many rows; None updates all.
    """
    corrections = 1 - BETA1**step, 1 - BETA2**step
    for name, param in params.items():
        if param.grad is None:
            continue
        tensors = param.detach(), param.grad, moments.first[name], moments.second[name]
        rows = seen if seen is not None and len(seen) == len(param) else None
        rate = rates[name] / corrections[0]
        if param.device.type == "cpu":
            _step_cpu(tensors, rate, corrections[1], rows)
        else:
            _step_torch(tensors, rate, corrections[1], rows)


def _step_cpu(tensors: tuple, rate: float, correction: float, rows: Tensor | None) -> None:
    rows = torch.ones(len(tensors[0]), dtype=torch.bool) if rows is None else rows
    arrays = [t.contiguous().view(len(t), -1).numpy() for t in tensors]
    update(*arrays, np.float32(rate), np.float32(correction), rows.numpy())


def _step_torch(tensors: tuple, rate: float, correction: float, rows: Tensor | None) -> None:
    param, grad, first, second = tensors
    new_first = first.lerp(grad, 1 - BETA1)
    new_second = second.lerp(grad * grad, 1 - BETA2)
    change = rate * new_first / ((new_second / correction).sqrt() + EPS)
    if rows is not None:
        kept = ~rows.view(-1, *[1] * (param.ndim - 1))
        new_first, new_second = (
            torch.where(kept, first, new_first),
            torch.where(kept, second, new_second),
        )
        change = change.masked_fill(kept, 0)
    first.copy_(new_first)
    second.copy_(new_second)
    param.sub_(change)


@no_type_check
@kernel
def update(param, grad, first, second, rate, correction, rows):
    """One step for the rows that are True."""
    b1, b2, eps = np.float32(BETA1), np.float32(BETA2), np.float32(EPS)
    one, scale = np.float32(1), np.float32(1) / correction
    for i in numba.prange(param.shape[0]):
        if rows[i]:
            for j in range(param.shape[1]):
                g = grad[i, j]
                m = b1 * first[i, j] + (one - b1) * g
                v = b2 * second[i, j] + (one - b2) * g * g
                first[i, j], second[i, j] = m, v
                param[i, j] -= rate * m / (np.sqrt(v * scale) + eps)
