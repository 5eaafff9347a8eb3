"""An object without its own pattern: its light and its large shapes, in closed form.

Gaussians are pooled into patches of the surface. A fit over their normals and places is the light;
what remains is smoothed by a rolling guidance filter, which levels what is small and keeps the
edges of what is large.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.sh import SH_C0
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import ObjectView

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
    """Pieces of a surface."""

    places: Float[Tensor, "P 6"]
    """Positions, in deviations of the smoothing, and where they are seen from: near ones are alike
    in both. Normals of single Gaussians are too noisy for that."""
    normals: Float[Tensor, "P 3"]
    """Of any length: their mean."""
    weights: Float[Tensor, " P"]
    """How much of the object they are."""
    bands: Float[Tensor, "P D"]
    """Their mean colours: all bands, the constant one first."""


@torch.no_grad()
def soften(
    splats: Splats, picked: Bool[Tensor, " N"], views: Sequence[ObjectView], share: float
) -> Splats:
    """Take away some of an object's own pattern; its light and large shapes stay.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        views: That show it: what they see counts.
        share: How much to take away: 0 changes nothing, 1 leaves none.
    """
    if share == 0:
        return splats
    rows = picked.nonzero()[:, 0]
    weights, sides, normals = _seen(splats, picked, views)
    places = torch.cat([splats.means[rows] / (RADIUS * _size(splats.means[rows])), sides], dim=1)
    own = torch.cat([splats.sh0[rows], splats.shN[rows]], dim=1)
    patches = _pooled(places, weights, normals, own.flatten(1))
    calm = _interpolated(patches.places, _calm(patches), places).view_as(own)
    mixed = torch.lerp(own, calm, share)
    return splats.with_rows(rows, {"sh0": mixed[:, :1], "shN": mixed[:, 1:]})


def _size(means: Float[Tensor, "M 3"]) -> Tensor:
    """The diagonal of nearly all of the object."""
    ordered = means.sort(dim=0).values
    few = len(means) // 20
    return (ordered[len(means) - 1 - few] - ordered[few]).norm().clamp(min=1e-9)


def _seen(
    splats: Splats, picked: Tensor, views: Sequence[ObjectView]
) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 3"], Float[Tensor, "M 3"]]:
    """How much each picked Gaussian shows, to which side, and its normal there."""
    means = splats.means[picked]
    weights, towards = means.new_zeros(len(means)), torch.zeros_like(means)
    for view in views:
        weight = view.weights(splats, picked)[picked]
        weights += weight
        ways = F.normalize(view.camera.positions.to(means) - means, dim=1)
        towards += weight[:, None] * ways
    thinnest = splats.scales[picked].argmin(dim=1)
    axes = rotation_matrices(splats.quats[picked])
    normals = axes.gather(2, thinnest[:, None, None].expand(-1, 3, 1))[:, :, 0]
    facing = (normals * towards).sum(dim=1, keepdim=True) >= 0
    typical = weights[weights > 0].mean() if (weights > 0).any() else 1.0
    sides = F.normalize(towards, dim=1)
    return weights + UNSEEN * typical, sides, torch.where(facing, normals, -normals)


def _pooled(places: Tensor, weights: Tensor, normals: Tensor, bands: Tensor) -> _Patches:
    """The means of Gaussians of the same place that are seen from about the same side."""
    sides = places[:, 3:]
    side = 2 * sides.abs().argmax(dim=1) + (sides.sum(dim=1) > 0)
    keys = torch.cat([(places[:, :3] / PATCH).floor().long(), side[:, None]], dim=1)
    _, index = keys.unique(dim=0, return_inverse=True)
    count = int(index.max()) + 1
    total = weights.new_zeros(count).index_add_(0, index, weights)
    weighted = weights[:, None] * torch.cat([places, normals, bands], dim=1)
    summed = weighted.new_zeros(count, weighted.shape[1]).index_add_(0, index, weighted)
    places, normals, bands = (summed / total[:, None]).tensor_split((6, 9), dim=1)
    return _Patches(places, normals, total, bands)


def _calm(patches: _Patches) -> Float[Tensor, "P D"]:
    """The patches' colours without the pattern."""
    near, weights = _near(patches.places, patches.places, NEIGHBOURS, 1.0)
    weights = weights * patches.weights[near]
    normals = F.normalize(_average(patches.normals, near, weights), dim=1)
    light = _light(replace(patches, normals=normals))
    rest = patches.bands - light
    guide, alike = _average(rest[:, :3], near, weights), weights
    for _ in range(ROUNDS):
        edges = SH_C0 / SAME * (guide[near] - guide[:, None])
        alike = weights * (-edges.square().sum(dim=2) / 2).exp()
        guide = _average(rest[:, :3], near, alike)
    return light + _average(rest, near, alike)


def _light(patches: _Patches) -> Float[Tensor, "P D"]:
    """What colours have in common that face the same way or lie at the same height."""
    centre = (patches.weights[:, None] * patches.places[:, :3]).sum(dim=0) / patches.weights.sum()
    spots, normals = RADIUS * (patches.places[:, :3] - centre), patches.normals
    squares = torch.einsum("ni,nj->nij", normals, normals)
    i, j = torch.triu_indices(3, 3)
    bases = torch.cat([torch.ones_like(normals[:, :1]), normals, squares[:, i, j], spots], dim=1)
    weighted = bases * (patches.weights / patches.weights.max())[:, None]
    normal = weighted.T @ bases
    ridge = RIDGE * normal.diagonal().max() * torch.eye(len(normal)).to(normal)
    return bases @ torch.linalg.solve(normal + ridge, weighted.T @ patches.bands)


def _near(
    patches: Tensor, places: Tensor, count: int, deviation: float
) -> tuple[Int[Tensor, "M count"], Float[Tensor, "M count"]]:
    """The patches nearest to some places, and how near."""
    from scipy.spatial import KDTree  # few ask for a texture, and it takes a while to import

    tree = KDTree((patches / deviation).cpu().numpy())
    count = min(count, len(patches))
    found = tree.query((places / deviation).cpu().numpy(), k=count, workers=-1)
    far, near = (torch.from_numpy(np.reshape(each, (-1, count))) for each in found)
    squares = far.to(places).square()
    return near.to(places.device), (-(squares - squares[:, :1]) / 2).exp()


def _average(values: Tensor, near: Tensor, weights: Tensor) -> Tensor:
    """Means over neighbours, which would take much memory side by side."""
    total = values.new_zeros(len(near), values.shape[1])
    for column in range(near.shape[1]):
        total.addcmul_(weights[:, column, None], values[near[:, column]])
    return total / weights.sum(dim=1, keepdim=True)


def _interpolated(patches: Tensor, colors: Tensor, places: Tensor) -> Tensor:
    """The patches' colours at other places."""
    return _average(colors, *_near(patches, places, BESIDE, PATCH))
