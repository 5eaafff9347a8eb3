"""Removal of an object's own pattern, which leaves its shading and its large shapes.

Gaussians are pooled into patches of the surface. A fit of colours over normals and positions is the
shading; the residual is smoothed by a rolling guidance filter (Zhang et al. 2014), which removes
small structures and keeps the edges of large ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.sh import SH_C0
from stylesplat.scene.splats import Splats
from stylesplat.stylization.views import ObjectView

RADIUS = 0.08  # deviation of the smoothing, in sizes of the object: patterns are smaller
PATCH = 0.5  # side of a patch, of that deviation
NEIGHBOURS = 96  # patches within about two deviations
BESIDE = 8  # patches that a Gaussian's colour is made of
SAME = 0.1  # difference of smoothed colours (of 1) that is an edge
ROUNDS = 4  # of the filter; after them edges hardly move
RIDGE = 1e-3  # of the fit, of the largest weight
UNSEEN = 1e-4  # weight of Gaussians that no view shows, of a typical one's


@dataclass(frozen=True)
class _Patches:
    """Patches of a surface."""

    positions: Float[Tensor, "P 6"]
    """Position in deviations of the smoothing, and mean direction of view: neighbours are alike in
    both. Normals of single Gaussians are too noisy for that."""
    normals: Float[Tensor, "P 3"]
    """Their mean, of any length."""
    weights: Float[Tensor, " P"]
    """Their contribution to the views."""
    bands: Float[Tensor, "P D"]
    """Mean coefficients of all bands, the constant one first."""


@torch.no_grad()
def remove_pattern(
    splats: Splats, mask: Bool[Tensor, " N"], views: Sequence[ObjectView], share: float
) -> Splats:
    """Remove a share of an object's own pattern; its shading and large shapes stay.

    Args:
        splats: The scene.
        mask: The object's Gaussians.
        views: Of the object; Gaussians count by their contributions to them.
        share: 0 changes nothing, 1 removes all of it.
    """
    if share == 0:
        return splats
    rows = mask.nonzero()[:, 0]
    weights, sides, normals = _visibility(splats, mask, views)
    positions = torch.cat([splats.means[rows] / (RADIUS * _size(splats.means[rows])), sides], dim=1)
    own = torch.cat([splats.sh0[rows], splats.shN[rows]], dim=1)
    patches = _pool(positions, weights, normals, own.flatten(1))
    smooth = _interpolate(patches.positions, _without_pattern(patches), positions).view_as(own)
    mixed = torch.lerp(own, smooth, share)
    return splats.with_rows(rows, {"sh0": mixed[:, :1], "shN": mixed[:, 1:]})


def _size(means: Float[Tensor, "M 3"]) -> Tensor:
    """The diagonal of the object without its outermost Gaussians."""
    ordered = means.sort(dim=0).values
    few = len(means) // 20
    return (ordered[len(means) - 1 - few] - ordered[few]).norm().clamp(min=1e-9)


def _visibility(
    splats: Splats, mask: Tensor, views: Sequence[ObjectView]
) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 3"], Float[Tensor, "M 3"]]:
    """The contribution, the mean direction of view and the normal of each Gaussian."""
    means = splats.means[mask]
    weights, towards = means.new_zeros(len(means)), torch.zeros_like(means)
    for view in views:
        weight = view.weights(splats, mask)[mask]
        weights += weight
        ways = F.normalize(view.camera.positions.to(means) - means, dim=1)
        towards += weight[:, None] * ways
    thinnest = splats.scales[mask].argmin(dim=1)
    axes = rotation_matrices(splats.quats[mask])
    normals = axes.gather(2, thinnest[:, None, None].expand(-1, 3, 1))[:, :, 0]
    facing = (normals * towards).sum(dim=1, keepdim=True) >= 0
    typical = weights[weights > 0].mean() if (weights > 0).any() else 1.0
    sides = F.normalize(towards, dim=1)
    return weights + UNSEEN * typical, sides, torch.where(facing, normals, -normals)


def _pool(positions: Tensor, weights: Tensor, normals: Tensor, bands: Tensor) -> _Patches:
    """The means of Gaussians at the same position that are seen from about the same side."""
    sides = positions[:, 3:]
    side = 2 * sides.abs().argmax(dim=1) + (sides.sum(dim=1) > 0)
    keys = torch.cat([(positions[:, :3] / PATCH).floor().long(), side[:, None]], dim=1)
    _, index = keys.unique(dim=0, return_inverse=True)
    count = int(index.max()) + 1
    total = weights.new_zeros(count).index_add_(0, index, weights)
    weighted = weights[:, None] * torch.cat([positions, normals, bands], dim=1)
    summed = weighted.new_zeros(count, weighted.shape[1]).index_add_(0, index, weighted)
    positions, normals, bands = (summed / total[:, None]).tensor_split((6, 9), dim=1)
    return _Patches(positions, normals, total, bands)


def _without_pattern(patches: _Patches) -> Float[Tensor, "P D"]:
    """The colours of the patches without the pattern."""
    near, weights = _neighbours(patches.positions, patches.positions, NEIGHBOURS, 1.0)
    weights = weights * patches.weights[near]
    normals = F.normalize(_weighted_mean(patches.normals, near, weights), dim=1)
    shading = _shading(replace(patches, normals=normals))
    rest = patches.bands - shading
    guide, alike = _weighted_mean(rest[:, :3], near, weights), weights
    for _ in range(ROUNDS):
        edges = SH_C0 / SAME * (guide[near] - guide[:, None])
        alike = weights * (-edges.square().sum(dim=2) / 2).exp()
        guide = _weighted_mean(rest[:, :3], near, alike)
    return shading + _weighted_mean(rest, near, alike)


def _shading(patches: _Patches) -> Float[Tensor, "P D"]:
    """A ridge fit of the colours by normals (to second order) and positions."""
    centre = (patches.weights[:, None] * patches.positions[:, :3]).sum(
        dim=0
    ) / patches.weights.sum()
    offsets, normals = RADIUS * (patches.positions[:, :3] - centre), patches.normals
    squares = torch.einsum("ni,nj->nij", normals, normals)
    i, j = torch.triu_indices(3, 3)
    bases = torch.cat([torch.ones_like(normals[:, :1]), normals, squares[:, i, j], offsets], dim=1)
    weighted = bases * (patches.weights / patches.weights.max())[:, None]
    normal = weighted.T @ bases
    ridge = RIDGE * normal.diagonal().max() * torch.eye(len(normal)).to(normal)
    return bases @ torch.linalg.solve(normal + ridge, weighted.T @ patches.bands)


def _neighbours(
    patches: Tensor, positions: Tensor, count: int, deviation: float
) -> tuple[Int[Tensor, "M count"], Float[Tensor, "M count"]]:
    """The patches nearest to some positions, and Gaussian weights of their distances."""
    tree = KDTree((patches / deviation).cpu().numpy())
    count = min(count, len(patches))
    found = tree.query((positions / deviation).cpu().numpy(), k=count, workers=-1)
    far, near = (torch.from_numpy(np.reshape(each, (-1, count))) for each in found)
    squares = far.to(positions).square()
    return near.to(positions.device), (-(squares - squares[:, :1]) / 2).exp()


def _weighted_mean(values: Tensor, near: Tensor, weights: Tensor) -> Tensor:
    """Weighted means over neighbours, one at a time to save memory."""
    total = values.new_zeros(len(near), values.shape[1])
    for column in range(near.shape[1]):
        total.addcmul_(weights[:, column, None], values[near[:, column]])
    return total / weights.sum(dim=1, keepdim=True)


def _interpolate(patches: Tensor, colors: Tensor, positions: Tensor) -> Tensor:
    """The colours of the patches at other positions."""
    return _weighted_mean(colors, *_neighbours(patches, positions, BESIDE, PATCH))
