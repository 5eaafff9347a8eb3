"""Giving an object the mean and covariance of a picture's colours, in closed form."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.rendering.sh import SH_C0
from stylesplat.scene.splats import Splats
from stylesplat.stylization.views import ObjectView

NOISE = 1e-3  # variance added to the source: bounds the contrast that flat colours are given


@torch.no_grad()
def transfer_colors(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    style: Float[Tensor, "H W 3"],
    views: Sequence[ObjectView],
    *,
    backend: Backend = "auto",
) -> Splats:
    """Map the colours of picked Gaussians so that the object looks as colourful as the style.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        style: Colours in 0..1.
        views: Where the object's colours are taken from.
        backend: Of the rasteriser.
    """
    colors = []
    for view in views:
        image, _, _ = rasterize(splats, view.camera, backend=backend)
        cells = view.cells[0]
        stride = image.shape[1] // cells.shape[0]
        pooled = F.avg_pool2d(image[0].permute(2, 0, 1), stride).permute(1, 2, 0)
        colors.append(pooled[cells])
    matrix, offset = color_map(torch.cat(colors), style.reshape(-1, 3))
    return map_colors(splats, picked, matrix, offset)


def color_map(
    source: Float[Tensor, "P 3"], target: Float[Tensor, "Q 3"]
) -> tuple[Float[Tensor, "3 3"], Float[Tensor, " 3"]]:
    """The affine map that takes one set of colours to another's mean and covariance.

    Of all such maps it moves the colours least (Pitie & Kokaram 2007, "The linear
    Monge-Kantorovitch linear colour mapping").

    Returns:
        `matrix` and `offset` of `matrix @ color + offset`.
    """
    noise = NOISE * torch.eye(3).to(source)
    root = _matrix_sqrt(source.T.cov(correction=0) + noise)
    inverse = torch.linalg.inv(root)
    matrix = inverse @ _matrix_sqrt(root @ target.T.cov(correction=0) @ root) @ inverse
    return matrix, target.mean(dim=0) - matrix @ source.mean(dim=0)


def map_colors(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    matrix: Float[Tensor, "3 3"],
    offset: Float[Tensor, " 3"],
) -> Splats:
    """Apply an affine map to the colours of picked Gaussians, from wherever they are seen."""
    grey = torch.full((3,), 0.5).to(offset)  # what zero coefficients show
    shift = (matrix @ grey + offset - grey) / SH_C0
    sh0, shN = splats.sh0 @ matrix.T + shift, splats.shN @ matrix.T
    mask = picked[:, None, None]
    return replace(
        splats,
        sh0=torch.where(mask, sh0, splats.sh0),
        shN=torch.where(mask, shN, splats.shN),
    )


def _matrix_sqrt(matrix: Tensor) -> Tensor:
    values, vectors = torch.linalg.eigh(matrix)
    return vectors @ (values.clamp(min=0).sqrt()[:, None] * vectors.T)
