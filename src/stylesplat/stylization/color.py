"""Colours of an object in closed form: a picture's mean and covariance, mixtures by shares."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.sh import SH_C0
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import ObjectView
from stylesplat.stylization.style_config import StyleConfig

NOISE = 1e-6  # variance added to both sides, so that flat colours can be inverted
VARIATION = 0.08  # deviation of the colours that `vary_colors` adds, of 1
WAVELENGTH = 0.12  # of its pattern, in sizes of the object
WAVES = 48  # that it is made of


@torch.no_grad()
def initial_colors(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    views: Sequence[ObjectView],
    palette: Float[Tensor, "P 3"],
    config: StyleConfig,
) -> Splats:
    """The colours to start from.

    Args:
        splats: The scene, with as much of the object's own pattern as is wanted.
        picked: The object's Gaussians.
        views: Whose pixels tell its colours.
        palette: Colours in 0..1, that it is to have.
        config: The settings.
    """
    if config.color != "free":
        splats = vary_colors(splats, picked, seed=config.seed)
        splats = transfer_colors(splats, picked, palette, views)
    if config.view_dependence == "drop":
        matte = splats.shN.masked_fill(picked[:, None, None], 0)
        splats = replace(splats, shN=matte)
    return splats


@torch.no_grad()
def transfer_colors(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    style: Float[Tensor, "P 3"],
    views: Sequence[ObjectView],
) -> Splats:
    """Map the colours of picked Gaussians so that the object looks as colourful as the style.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        style: Colours in 0..1.
        views: Where the object's colours are taken from.
    """
    matrix, offset = color_map(object_colors(splats, views), style)
    return map_colors(splats, picked, matrix, offset)


@torch.no_grad()
def object_colors(splats: Splats, views: Sequence[ObjectView]) -> Float[Tensor, "P 3"]:
    """The object's colours in some views, one per pixel."""
    images = (view.render(splats) for view in views)
    return torch.cat([image[view.pixels] for image, view in zip(images, views, strict=True)])


@torch.no_grad()
def vary_colors(splats: Splats, picked: Bool[Tensor, " N"], *, seed: int) -> Splats:
    """Add a faint pattern of smooth colours in space, so that flat objects have some to stretch.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        seed: Of the pattern.
    """
    generator = torch.Generator().manual_seed(seed)
    directions = F.normalize(torch.randn(WAVES, 3, generator=generator), dim=1)
    phases = 2 * math.pi * torch.rand(WAVES, generator=generator)
    mixture = torch.randn(WAVES, 3, generator=generator) * math.sqrt(2 / WAVES)
    means = splats.means[picked]
    size = (means.quantile(0.95, dim=0) - means.quantile(0.05, dim=0)).norm()
    waves = directions.to(means) * (2 * math.pi / (WAVELENGTH * size))
    pattern = torch.cos(means @ waves.T + phases.to(means)) @ mixture.to(means)
    sh0 = splats.sh0.clone()
    sh0[picked] += VARIATION / SH_C0 * pattern[:, None]
    return replace(splats, sh0=sh0)


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
    wanted = target.T.cov(correction=0) + noise
    matrix = inverse @ _matrix_sqrt(root @ wanted @ root) @ inverse
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
    rows = picked.nonzero()[:, 0]
    sh0, shN = splats.sh0[rows] @ matrix.T + shift, splats.shN[rows] @ matrix.T
    return splats.with_rows(rows, {"sh0": sh0, "shN": shN})


def _matrix_sqrt(matrix: Tensor) -> Tensor:
    values, vectors = torch.linalg.eigh(matrix)
    return vectors @ (values.clamp(min=0).sqrt()[:, None] * vectors.T)


def mixed_colors(base: Splats, paint: Splats, shares: Float[Tensor, " N"]) -> Splats:
    """The base with the colours of each Gaussian moved by its share towards the paint.

    Where the share is 0 they are the base's to the bit, where it is 1 the paint's.
    """
    rows = (shares > 0).nonzero()[:, 0]
    weights = shares[rows, None, None]

    def mixed(before: Tensor, after: Tensor) -> Tensor:
        return torch.lerp(before[rows], after[rows], weights)

    mixtures = {"sh0": mixed(base.sh0, paint.sh0), "shN": mixed(base.shN, paint.shN)}
    return base.with_rows(rows, mixtures)
