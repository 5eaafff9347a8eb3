"""Densification as sampling: dead Gaussians move to where opaque ones are (3DGS-MCMC).

Kheradmand et al. 2024. A Gaussian that is joined by copies is made fainter and smaller so that
the sum looks as before; noise in proportion to transparency lets Gaussians explore.
"""

from math import comb, exp
from typing import no_type_check

import numba
import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.rendering.kernels.jit import kernel
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.training.adam import Moments

DEAD_OPACITY = 0.005
MAX_COPIES = 51  # of one Gaussian at a time (official)
NOISE_RATE = 80.0  # official: 5e5 times the learning rate of the means, 1.6e-4
NOISE_SHARPNESS = 100.0
OPAQUE = -1.8  # logit of 0.14; above it the noise is a millionth and not worth its time
OPACITY_WEIGHT = 0.01  # of the regularisers that let Gaussians die
SCALE_WEIGHT = 0.01

Params = dict[str, Tensor]


def regularizer(params: Params) -> Float[Tensor, ""]:
    """Pulls opacities and sizes towards 0."""
    opacity = torch.sigmoid(params["opacities"]).mean()
    return OPACITY_WEIGHT * opacity + SCALE_WEIGHT * params["scales"].exp().mean()


@torch.no_grad()
def add_noise(params: Params, unit: float, generator: torch.Generator) -> None:
    """Move the means at random, along their own covariance, the fainter the more.

    Args:
        params: Trained tensors; the means change in place.
        unit: Of length, smaller as training goes on.
        generator: Source of randomness.
    """
    n = len(params["means"])
    noise = torch.randn(n, 3, generator=generator).to(params["means"])
    names = ("means", "quats", "scales", "opacities")
    tensors = (*(params[name].detach() for name in names), noise)
    if noise.device.type == "cpu":
        _drift_cpu(tuple(t.numpy() for t in tensors), NOISE_RATE * unit)
    else:
        _drift_torch(tensors, NOISE_RATE * unit)


def _drift_torch(tensors: tuple[Tensor, ...], rate: float) -> None:
    means, quats, scales, opacities, noise = tensors
    gate = torch.sigmoid(NOISE_SHARPNESS * (DEAD_OPACITY - torch.sigmoid(opacities)))
    # The covariance times isotropic noise, which may as well be drawn along the axes.
    along_axes = noise * gate[:, None] * (2 * scales).exp()
    means += rate * (rotation_matrices(quats) @ along_axes[..., None])[..., 0]


@no_type_check
@kernel
def _drift_cpu(arrays, rate):
    """`_drift_torch` for those that are faint enough to move."""
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


@torch.no_grad()
def refine(
    params: Params,
    moments: Moments,
    names: tuple[str, ...],
    count: int,
    generator: torch.Generator,
    *,
    preference: Float[Tensor, " N"] | None = None,
) -> tuple[Params, Moments]:
    """Move the dead Gaussians and grow to `count` in all.

    Args:
        params: Trained tensors.
        moments: Their optimiser state.
        names: Which of them have one row per Gaussian.
        count: Gaussians wanted; fewer than there are changes nothing but the dead.
        generator: Source of randomness.
        preference: Factors on the chances, which are the opacities, of being copied.

    Returns:
        The new tensors and state; rows that were moved or copied start from zero moments.
    """
    opacities = torch.sigmoid(params["opacities"])
    alive = (opacities > DEAD_OPACITY).nonzero()[:, 0]
    dead = (opacities <= DEAD_OPACITY).nonzero()[:, 0]
    n = len(opacities)
    needed = len(dead) + max(count - n, 0)
    if needed == 0 or len(alive) == 0:
        return params, moments
    chances = opacities if preference is None else opacities * preference
    drawn = torch.multinomial(chances[alive].cpu(), needed, replacement=True, generator=generator)
    sources = alive[drawn.to(alive.device)]
    rows = torch.cat([torch.arange(n, device=sources.device), sources[len(dead) :]])
    rows[dead] = sources[: len(dead)]
    params = dict(params) | _shrunk_sources(params, sources)
    fresh = rows.clone()
    fresh[dead] = -1
    fresh[n:] = -1
    fresh[sources] = -1
    taken = {name: params[name].detach()[rows].requires_grad_() for name in names}
    return params | taken, moments.take(fresh, names)


def _shrunk_sources(params: Params, sources: Int[Tensor, " M"]) -> Params:
    """Opacities and scales with which a source and its copies together look as before."""
    copies = torch.bincount(sources, minlength=len(params["opacities"])) + 1
    copies = copies.clamp(max=MAX_COPIES)[sources]
    old = torch.sigmoid(params["opacities"][sources])
    new = 1 - (1 - old) ** (1 / copies)
    factor = old / _spread(new, copies)
    opacities, scales = params["opacities"].detach().clone(), params["scales"].detach().clone()
    opacities[sources] = torch.logit(new.clamp(DEAD_OPACITY, 1 - 1e-6))
    scales[sources] += factor.log()[:, None]
    return {"opacities": opacities, "scales": scales}


def _spread(opacity: Float[Tensor, " M"], copies: Int[Tensor, " M"]) -> Float[Tensor, " M"]:
    """Equation 9 of the paper: how much wider n copies spread than one Gaussian."""
    total = torch.zeros_like(opacity)
    for i in range(1, int(copies.max()) + 1):
        for k in range(i):
            term = comb(i - 1, k) * (-1) ** k / (k + 1) ** 0.5 * opacity ** (k + 1)
            total += torch.where(copies >= i, term, 0)
    return total
