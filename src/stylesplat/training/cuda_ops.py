"""Operations of training on NVIDIA GPUs, where possible gsplat 1.5.3's; see `DeviceOps`.

None of them waits for the device.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import comb

import torch
from gsplat import quat_scale_to_covar_preci
from gsplat.cuda._wrapper import adam as fused_adam
from gsplat.relocation import compute_relocation
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.training.device_ops import (
    DEAD_OPACITY,
    EPS,
    MAX_COPIES,
    NOISE_SHARPNESS,
    AdamTurn,
    Geometry,
)
from stylesplat.training.losses import photometric_spec as photometric_loss

__all__ = ["adam", "add_noise", "nearest", "photometric_loss", "relocate"]

DISTANCES_AT_ONCE = 2**26  # 256 MB of them


def adam(
    param: Tensor,
    first: Tensor,
    second: Tensor,
    turns: Sequence[AdamTurn],
    kept: tuple[float, float],
) -> None:
    """Adam, by the kernel of gsplat's `SelectiveAdam`.

    The kernel divides by sqrt(second) + eps without the corrections, so rate and eps contain them:
    rate / c1 * first / (sqrt(second / c2) + eps) is the same.
    """
    for turn in turns:
        root = turn.corrections[1] ** 0.5
        fused_adam(
            param,
            turn.grad.contiguous(),
            first,
            second,
            valid=turn.visible,
            lr=turn.rate * root / turn.corrections[0],
            b1=kept[0],
            b2=kept[1],
            eps=EPS * root,
        )


def add_noise(geometry: Geometry, noise: Float[Tensor, "N 3"], rate: float) -> None:
    """Move means by a rate times their covariance times noise.

    As gsplat's `inject_noise_to_position`, which draws from the global generator.
    """
    means, quats, scales, opacities = geometry
    covars, _ = quat_scale_to_covar_preci(quats, scales.exp(), compute_preci=False)
    gate = torch.sigmoid(NOISE_SHARPNESS * (DEAD_OPACITY - torch.sigmoid(opacities)))
    means.add_(torch.einsum("nij,nj->ni", covars, rate * gate[:, None] * noise))


def relocate(
    opacities: Float[Tensor, " M"], scales: Float[Tensor, "M 3"], copies: Int[Tensor, " M"]
) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 3"]]:
    """Opacities and scales with which so many copies look like one."""
    ratios = copies.clone()  # which gsplat clamps in place
    return compute_relocation(opacities, scales, ratios, _binomials(opacities.device))


@lru_cache
def _binomials(device: torch.device) -> Float[Tensor, "n n"]:
    """C(n, k), from which gsplat's kernel reads as many rows as there are copies."""
    table = [[float(comb(n, k)) for k in range(MAX_COPIES)] for n in range(MAX_COPIES)]
    return torch.tensor(table, device=device)


def nearest(
    means: Float[Tensor, "N 3"], sample: Int[Tensor, " S"], count: int
) -> Int[Tensor, "S k"]:
    """Rows of the nearest neighbours, from all distances."""
    found = []
    for some in sample.split(max(1, DISTANCES_AT_ONCE // len(means))):
        # Not by a matrix product, which rounds small distances away
        mode = "donot_use_mm_for_euclid_dist"
        distances = torch.cdist(means[some], means, compute_mode=mode)
        distances.scatter_(1, some[:, None], torch.inf)
        found.append(distances.topk(count, dim=1, largest=False).indices)
    return torch.cat(found)
