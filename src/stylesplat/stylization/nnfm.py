"""Nearest-neighbour feature matching, the loss of ARF (Zhang et al. 2022)."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.stylization.matching import nearest


def nnfm_loss(
    feats: Float[Tensor, "P D"],
    style_feats: Float[Tensor, "Q D"],
) -> Float[Tensor, ""]:
    """Mean cosine distance from each feature to its nearest style feature, searched exhaustively.

    The matches are constants to the gradient, as in ARF.

    Args:
        feats: VGG features of the render, one row per pixel.
        style_feats: VGG features of the style image.

    Returns:
        The loss (ARF, Zhang et al. 2022); 0 if every match is exact. The formula printed in the
        StyleSplat paper lacks the "1 -".
    """
    matches = nearest(feats, F.normalize(style_feats, dim=1))
    return cosine_distance(feats, style_feats[matches])


def cosine_distance(feats: Float[Tensor, "P D"], others: Float[Tensor, "P D"]) -> Float[Tensor, ""]:
    """The mean over rows of 1 minus the cosine, in float32 or more."""
    dtype = torch.promote_types(feats.dtype, torch.float32)
    return (1 - F.cosine_similarity(feats.to(dtype), others.to(dtype), dim=1)).mean()
