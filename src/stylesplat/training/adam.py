"""Adam over named tensors whose rows come and go (Kingma and Ba 2015).

Rows whose Gaussian is invisible in a step keep their value and moments, as in gsplat's
`SelectiveAdam`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.rendering.kernels.jit import kernel
from stylesplat.rendering.nvrtc import for_each_row

KERNEL = Path(__file__).with_name("adam.cu")
BETA1, BETA2 = 0.9, 0.999
EPS = 1e-15  # as in the 3D Gaussian splatting code


@dataclass(frozen=True, eq=False)
class Moments:
    """Running means of the gradients and their squares, by name."""

    first: dict[str, Tensor]
    second: dict[str, Tensor]

    @classmethod
    def zeros(cls, params: dict[str, Tensor]) -> "Moments":
        return cls(*({k: torch.zeros_like(v) for k, v in params.items()} for _ in range(2)))

    def clone(self) -> "Moments":
        first, second = ({k: v.clone() for k, v in t.items()} for t in (self.first, self.second))
        return Moments(first, second)

    def optimizers(self, params: dict[str, Tensor]) -> dict[str, "TensorOptimizer"]:
        """The moments of some tensors, in the form in which gsplat's strategies change them."""
        return {
            name: TensorOptimizer(
                [{"params": [param]}],
                {param: {"exp_avg": self.first[name], "exp_avg_sq": self.second[name]}},
            )
            for name, param in params.items()
        }

    def updated(self, optimizers: dict[str, "TensorOptimizer"]) -> "Moments":
        """The moments with those that `optimizers` hold now."""
        found = {name: each.moments for name, each in optimizers.items()}
        first = {name: each["exp_avg"] for name, each in found.items()}
        second = {name: each["exp_avg_sq"] for name, each in found.items()}
        return Moments(self.first | first, self.second | second)


@dataclass(eq=False)
class TensorOptimizer:
    """What gsplat's strategies read and write of the `torch.optim.Adam` of one tensor."""

    param_groups: list[dict[str, list[Tensor]]]
    state: dict[Tensor, dict[str, Tensor]]

    @property
    def moments(self) -> dict[str, Tensor]:
        return self.state[self.param_groups[0]["params"][0]]


class AdamUpdate(NamedTuple):
    """One step of Adam over named tensors."""

    params: dict[str, Tensor]
    """Tensors that share their memory with those that are stepped, gradients in `.grad`."""
    rates: dict[str, float]
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
    """Take several steps, one after the other, in one pass through memory, in place.

    If the gradients are means over several photos, the rate is multiplied by the square root of
    their number, and moments fade as in as many steps (Zhao et al. 2024, "On Scaling Up 3D Gaussian
    Splatting Training").
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
            adam = adam_cuda if stepped.is_cuda else adam_cpu
            changed = stepped.detach(), moments.first[name], moments.second[name]
            adam(changed, turns, kept)


Changed = tuple[Tensor, Tensor, Tensor]
"""A tensor, and the means of its gradients and of their squares."""


class AdamTurn(NamedTuple):
    """One step of one tensor. The moments are divided by the corrections: they started at 0."""

    grad: Tensor
    visible: Bool[Tensor, " N"]
    rate: float
    corrections: tuple[float, float]

    @property
    def factors(self) -> tuple[float, float]:
        """Of the first moment, and of the second."""
        return self.rate / self.corrections[0], 1 / self.corrections[1]


def adam_cuda(changed: Changed, turns: Sequence[AdamTurn], kept: tuple[float, float]) -> None:
    """Step a tensor on a GPU in place; see `adam_cpu`."""
    param, first, second = changed
    assert all(tensor.is_contiguous() for tensor in changed)
    rows, count = len(param), param.numel()
    for turn in turns:
        grad, factor, scale = turn.grad.contiguous(), *turn.factors
        steps = rows, count // max(rows, 1), factor, scale, *kept
        given = param, first, second, grad, turn.visible.contiguous(), *steps
        for_each_row(KERNEL, "adam", param.device, count, *given, ADAM_EPS=EPS)


def adam_cpu(changed: Changed, turns: Sequence[AdamTurn], kept: tuple[float, float]) -> None:
    """Step a tensor in place, all turns in one pass; `kept` are shares of the moments that stay."""
    packed = [tensor.contiguous() for tensor in changed]  # a copy of those that are not contiguous
    arrays = tuple(_rows(tensor) for tensor in packed)
    grads = tuple(_rows(turn.grad) for turn in turns)
    chosen = tuple(turn.visible.numpy() for turn in turns)
    factors = [turn.factors for turn in turns]
    betas = np.float32(kept[0]), np.float32(kept[1])
    _adam(arrays, betas, grads, chosen, np.array(factors, np.float32))
    for tensor, copy in zip(changed, packed, strict=True):
        if copy is not tensor:
            tensor.copy_(copy)


def _rows(tensor: Tensor) -> np.ndarray:
    return tensor.contiguous().view(len(tensor), -1).numpy()


@kernel
def _adam(arrays, kept, grads, chosen, factors):
    param, first, second = arrays
    (b1, b2), eps, one = kept, np.float32(EPS), np.float32(1)
    for i in numba.prange(param.shape[0]):
        for turn in range(len(grads)):
            grad, (rate, scale) = grads[turn], factors[turn]
            if chosen[turn][i]:
                for j in range(param.shape[1]):
                    g = grad[i, j]
                    m = b1 * first[i, j] + (one - b1) * g
                    v = b2 * second[i, j] + (one - b2) * g * g
                    first[i, j], second[i, j] = m, v
                    param[i, j] -= rate * m / (np.sqrt(v * scale) + eps)
