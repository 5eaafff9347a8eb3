"""Operations of training on the CPU: numba kernels and a KD-tree; see `DeviceOps`."""

from collections.abc import Sequence
from functools import lru_cache
from math import comb, exp
from typing import no_type_check

import numba
import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.rendering.kernels.jit import kernel
from stylesplat.training.device_ops import (
    DEAD_OPACITY,
    EPS,
    MAX_COPIES,
    NOISE_SHARPNESS,
    AdamTurn,
    Geometry,
)
from stylesplat.training.photometric_cpu import photometric_loss

__all__ = ["adam", "add_noise", "nearest", "photometric_loss", "relocate"]

OPAQUE = -1.8  # logit of 0.14; above it the noise is a millionth and not worth its time


def adam(
    param: Tensor,
    first: Tensor,
    second: Tensor,
    turns: Sequence[AdamTurn],
    kept: tuple[float, float],
) -> None:
    """Adam, all turns in one pass through memory, whose speed is the limit."""
    changed = (param, first, second)
    packed = [tensor.contiguous() for tensor in changed]  # a copy of those that are not contiguous
    arrays = tuple(_rows(tensor) for tensor in packed)
    grads = tuple(_rows(turn.grad) for turn in turns)
    chosen = tuple(turn.visible.numpy() for turn in turns)
    factors = [(turn.rate / turn.corrections[0], 1 / turn.corrections[1]) for turn in turns]
    betas = np.float32(kept[0]), np.float32(kept[1])
    _adam(arrays, betas, grads, chosen, np.array(factors, np.float32))
    for tensor, copy in zip(changed, packed, strict=True):
        if copy is not tensor:
            tensor.copy_(copy)


@no_type_check
def _rows(tensor: Tensor) -> np.ndarray:
    return tensor.contiguous().view(len(tensor), -1).numpy()


@no_type_check
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


def add_noise(geometry: Geometry, noise: Float[Tensor, "N 3"], rate: float) -> None:
    """Move means by a rate times their covariance times noise drawn along the axes."""
    _add_noise(tuple(t.numpy() for t in (*geometry, noise)), rate)


@no_type_check
@kernel
def _add_noise(arrays, rate):
    means, quats, scales, opacities, noise = arrays
    for i in numba.prange(means.shape[0]):
        if opacities[i] > OPAQUE:
            continue
        opacity = 1 / (1 + exp(-opacities[i]))
        step = rate / (1 + exp(-NOISE_SHARPNESS * (DEAD_OPACITY - opacity)))
        a = step * noise[i, 0] * exp(2 * scales[i, 0])
        b = step * noise[i, 1] * exp(2 * scales[i, 1])
        c = step * noise[i, 2] * exp(2 * scales[i, 2])
        w, x, y, z = quats[i]
        double = 2 / max(w * w + x * x + y * y + z * z, 1e-24)
        # the rotation as v + 2 w (q x v) + 2 q x (q x v)
        d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
        means[i, 0] += a + double * (w * d + y * f - z * e)
        means[i, 1] += b + double * (w * e + z * d - x * f)
        means[i, 2] += c + double * (w * f + x * e - y * d)


def relocate(
    opacities: Float[Tensor, " M"], scales: Float[Tensor, "M 3"], copies: Int[Tensor, " M"]
) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 3"]]:
    """Opacities and scales with which so many copies look like one."""
    old = opacities.double()
    new = 1 - (1 - old) ** (1 / copies)
    terms = _spread_terms()[copies] * new[:, None] ** torch.arange(1, MAX_COPIES + 1)
    factor = old / terms.sum(dim=1)
    return new.to(opacities), scales * factor.to(scales)[:, None]


@lru_cache
def _spread_terms() -> Float[Tensor, "n k"]:
    """By copies n and power k of the opacity, the factor of the paper's double sum.

    The inner binomials C(i - 1, k - 1) add up to C(n, k) over i.
    """
    table = torch.zeros(MAX_COPIES + 1, MAX_COPIES, dtype=torch.float64)
    for n in range(1, MAX_COPIES + 1):
        for k in range(1, n + 1):
            table[n, k - 1] = comb(n, k) * (-1) ** (k - 1) / k**0.5
    return table


def nearest(
    means: Float[Tensor, "N 3"], sample: Int[Tensor, " S"], count: int
) -> Int[Tensor, "S k"]:
    """Rows of the nearest neighbours, by a KD-tree: 17 times faster for 50,000 points."""
    points = means.numpy()
    tree = KDTree(points, balanced_tree=False, compact_nodes=False)  # asked once: quick to build
    found = np.asarray(tree.query(points[sample.numpy()], k=count + 1)[1])
    own = found == sample.numpy()[:, None]
    own[~own.any(axis=1), -1] = True  # of twins at one place, it itself may not be among them
    return torch.from_numpy(found[~own].reshape(len(found), count))
