"""How much a picture changed inside or outside a mask: leakage and strength of an edit."""

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.metrics.lab import lab_from_rgb
from stylesplat.metrics.psnr import decibels
from stylesplat.scene.labels import Mask

CHANGED = 0.05  # of a channel's range: what changed by more is seen beside what did not


def changed_share(
    before: Float[Tensor, "H W 3"], after: Float[Tensor, "H W 3"], mask: Mask
) -> float:
    """The share of a mask's pixels that changed by more than 0.05 in a channel.

    Args:
        before: Colours in 0..1.
        after: Colours in 0..1.
        mask: Which pixels count.

    Returns:
        0..1; 0 if the mask is empty.
    """
    gaps = (after - before)[mask].abs().amax(dim=-1)
    return float((gaps > CHANGED).float().mean()) if len(gaps) else 0.0


def masked_psnr(before: Float[Tensor, "H W 3"], after: Float[Tensor, "H W 3"], mask: Mask) -> float:
    """PSNR in decibels over a mask's pixels alone, 120 at most and of none at all.

    Args:
        before: Colours in 0..1.
        after: Colours in 0..1.
        mask: Which pixels count.
    """
    squares = (after - before)[mask].square()
    return float(decibels(squares.sum() / max(1, squares.numel())))


def strength(before: Float[Tensor, "H W 3"], after: Float[Tensor, "H W 3"], mask: Mask) -> float:
    """The mean distance in Lab (CIE 1976) between colours before and after, over a mask.

    Args:
        before: Colours in 0..1.
        after: Colours in 0..1.
        mask: Which pixels count.

    Returns:
        0 if nothing changed; 2.3 is just seen, 100 is from black to white.
    """
    if not mask.any():
        return 0.0
    gaps = lab_from_rgb(after[mask]) - lab_from_rgb(before[mask])
    return float(gaps.norm(dim=-1).mean())


def farther_than(mask: Mask, reach: float) -> Mask:
    """The pixels of the picture that lie farther than `reach` pixels from all pixels of a mask."""
    if not mask.any():
        return torch.ones_like(mask)
    away = cv2.distanceTransform(
        (~mask).cpu().numpy().astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    return torch.from_numpy(away > reach).to(mask.device)
