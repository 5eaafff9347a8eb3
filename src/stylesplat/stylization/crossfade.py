"""Blends of an object before and after it was painted."""

import math
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import mixed_colors

UNSEEN = -16.0  # logit of an opacity that no picture shows
THROUGH = 0.003  # of what lies beneath, by a whole canvas: intensities show as they are called


def crossfade(base: Splats, styled: Splats, picked: Bool[Tensor, " N"], intensity: float) -> Splats:
    """The base with picked Gaussians moved towards the styled ones.

    Renders are linear in the colours, so that blending these blends the renders, wherever no colour
    is clamped. A fresh canvas carries its paint from the first; it fades in over what it hides,
    which fades once half of the canvas is there.

    Args:
        base: As they look at intensity 0.
        styled: The same Gaussians as they look at intensity 1.
        picked: Which of them to move.
        intensity: How far; more than 1 goes beyond, in the colours.
    """
    shares = intensity * picked.to(base.means)
    appearing = (styled.opacities > base.opacities) & (shares > 0)
    shares = torch.where(appearing, shares.clamp(min=1), shares)
    opacities = _between(base.opacities, styled.opacities, min(intensity, 1.0))
    opacities = torch.where(picked, opacities, base.opacities)
    return replace(mixed_colors(base, styled, shares), opacities=opacities)


def _between(
    before: Float[Tensor, " N"], after: Float[Tensor, " N"], share: float
) -> Float[Tensor, " N"]:
    """Opacities on the way; to the bit at both ends, and where they are the same.

    Logarithms of what is let through add up along a ray. So a pile of discs that appears shows as
    much as is wanted, and not more for being a pile.
    """
    if share in (0, 1):
        return after if share else before
    appeared = min(1.0, math.log(1 - share) / math.log(THROUGH))
    faded = max(0.0, 2 * share - 1)
    part = torch.where(after > before, appeared, faded)
    # in double precision: logarithms of floats differ in their last bit by the place in a tensor
    start, end = (-F.softplus(each.double()) for each in (before, after))  # log(1 - sigmoid(x))
    mixed = torch.log(torch.expm1(-torch.lerp(start, end, part.double()))).clamp(min=UNSEEN)
    return torch.where(before == after, before, mixed.to(before))
