"""Affine maps of colours."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.scene.splats import Splats, map_bands

NOISE = 1e-6  # variance added to both sides, so that flat colours can be inverted


def color_map(source: Float[Tensor, "P 3"], target: Float[Tensor, "Q 3"]) -> Float[Tensor, "3 4"]:
    """The affine map that takes one set of colours to another's mean and covariance.

    Of all such maps it moves the colours least (Pitie & Kokaram 2007, "The linear
    Monge-Kantorovitch linear colour mapping"). The fourth column is the offset.
    """
    noise = NOISE * torch.eye(3).to(source)
    root = _matrix_sqrt(source.T.cov(correction=0) + noise)
    inverse = torch.linalg.inv(root)
    wanted = target.T.cov(correction=0) + noise
    matrix = inverse @ _matrix_sqrt(root @ wanted @ root) @ inverse
    offset = target.mean(dim=0) - matrix @ source.mean(dim=0)
    return torch.cat([matrix, offset[:, None]], dim=1)


def mapped(colors: Float[Tensor, "*P 3"], color_map: Float[Tensor, "3 4"]) -> Float[Tensor, "*P 3"]:
    """Colours after an affine map."""
    return colors @ color_map[:, :3].T + color_map[:, 3]


def map_colors(splats: Splats, mask: Bool[Tensor, " N"], color_map: Float[Tensor, "3 4"]) -> Splats:
    """Apply an affine map to the colours of some Gaussians, in all bands."""
    rows = mask.nonzero()[:, 0]
    sh0, shN = map_bands(splats.sh0[rows], splats.shN[rows], color_map)
    return splats.with_rows(rows, {"sh0": sh0, "shN": shN})


def _matrix_sqrt(matrix: Tensor) -> Tensor:
    values, vectors = torch.linalg.eigh(matrix)
    return vectors @ (values.clamp(min=0).sqrt()[:, None] * vectors.T)
