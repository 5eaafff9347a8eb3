"""Nearest-neighbour feature matching, the loss of ARF (Zhang et al. 2022)."""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

SIMILARITIES_AT_ONCE = 2**23  # bounds the features x style features matrix


def nnfm_loss(
    feats: Float[Tensor, "P D"],
    style_feats: Float[Tensor, "Q D"],
) -> Float[Tensor, ""]:
    """Mean cosine distance from each feature to its nearest style feature.

    The matches are constants to the gradient, as in ARF.

    Args:
        feats: VGG features of the render, one row per pixel.
        style_feats: VGG features of the style image.

    Returns:
        The loss (ARF, Zhang et al. 2022); 0 if every match is exact. The formula printed in the
        StyleSplat paper lacks the "1 -".
    """
    matches = nearest(feats, style_feats)
    return (1 - F.cosine_similarity(feats, style_feats[matches], dim=1)).mean()


@torch.no_grad()
def nearest(feats: Float[Tensor, "P D"], style_feats: Float[Tensor, "Q D"]) -> Int[Tensor, " P"]:
    """The row of the most similar style feature (by cosine) of each feature."""
    directions = F.normalize(style_feats, dim=1).T.contiguous()  # [D, Q]
    rows = max(1, SIMILARITIES_AT_ONCE // len(style_feats))
    return torch.cat([(chunk @ directions).argmax(dim=1) for chunk in feats.split(rows)])
