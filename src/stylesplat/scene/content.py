"""The content of a splat: the subject of its photos, without floaters and far background.

The model: photos are taken close to their subject, so at least half of a splat's opacity lies in
dense content. Gaussians much sparser than the median are background. The rest falls into connected
parts, and a part belongs to the content if it is heavy for its distance from the heaviest part.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError
from torch import Tensor

from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.splats import Splats

# Opacity below which a Gaussian is no surface. In two trained scenes 30 to 70 % of an object's are
# fainter; with them, an object measured up to 60 times its size.
EXTENT_FAINT = 0.05
EXTENT_SAMPLE = 30_000  # Gaussians; neighbours among a million would take seconds
EXTENT_NEIGHBOURS = 8  # whose mean distance measures the density at a point
# Times the median of these distances, beyond which a point is background. Of the opacity of the
# trained fox 99 % are content, of the desk 55 % and of the demo 93 %, all but its backdrop.
SPARSE = 7.0
# Diagonals of the heaviest part, times a part's share of the opacity: how far away it may be
EXTENT_FARTHEST = 10.0
# Share of the opacity outside the bounds, at each end of each axis, as some Gaussians are strays.
# With 0.001 a toy cube of 0.74 measured 1.08 by 0.74, with 0.01 a vase lost 4 % of its height
EXTENT_EDGE = 0.005


@dataclass(frozen=True, eq=False)
class Extent:
    """A box along the world's axes, by two opposite corners."""

    low: Float[Tensor, "3"]
    high: Float[Tensor, "3"]

    @property
    def centre(self) -> Float[Tensor, "3"]:
        return (self.low + self.high) / 2

    @property
    def size(self) -> Float[Tensor, "3"]:
        return self.high - self.low

    def contains(self, points: Float[Tensor, "M 3"]) -> Bool[Tensor, " M"]:
        return ((points >= self.low) & (points <= self.high)).all(dim=1)


@dataclass(frozen=True, eq=False)
class Content:
    """Samples of a splat's content and of everything else, in 64 bits."""

    points: Float[Tensor, "M 3"]
    """Centres of the content's Gaussians within its extent."""
    blur: float
    """The median of their largest standard deviations, in world units."""
    extent: Extent
    """The box around them, widened by `blur`."""
    others: Float[Tensor, "L 3"]
    """Centres of the other Gaussians outside the extent."""
    areas: Float[Tensor, " L"]
    """The area that each hides, with all that the sample leaves out; square units."""
    blurs: Float[Tensor, " L"]
    """Their largest standard deviations."""

    @cached_property
    def outline(self) -> Float[Tensor, "_ 3"]:
        """The convex hull of the content, widened by its blur."""
        return self.outline_of(self.points)

    def outline_of(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "_ 3"]:
        """The convex hull of some of the points, widened by the blur."""
        try:
            hull = ConvexHull(points.numpy(), qhull_options="QJ Pp")  # joggled: may be flat
            points = points[torch.from_numpy(hull.vertices).long()]
        except QhullError:  # too few points
            pass
        axes = self.blur * torch.eye(3).double()
        return (points[:, None] + torch.cat([axes, -axes])).flatten(0, 1)


def content_of(splats: Splats, picked: Bool[Tensor, " N"] | None = None) -> Content:
    """The content of a splat, or of a picked object; `others` are what may hide it."""
    if picked is None:
        everything = torch.ones(len(splats), dtype=torch.bool, device=splats.device)
        sample, step = _sample(splats, everything)
        kept = _is_content(sample.means, sample.opacities.sigmoid())
        own, rest = sample[kept], sample[~kept]
    else:
        own, _ = _sample(splats, picked)
        rest, step = _sample(splats, ~picked)
    extent, blur = _bounds(own)
    others = rest[~extent.contains(rest.means)]
    sizes = others.scales.exp().sort(dim=1, descending=True).values
    return Content(
        points=own.means[extent.contains(own.means)],
        blur=blur,
        extent=extent,
        others=others.means,
        areas=step * 2 * torch.pi * others.opacities.sigmoid() * sizes[:, :2].prod(dim=1),
        blurs=sizes[:, 0],
    )


def extent_of(splats: Splats, picked: Bool[Tensor, " N"]) -> Extent:
    """The box around some Gaussians, without faint ones and strays."""
    return _bounds(_sample(splats, picked)[0])[0]


def opaque_rows(splats: Splats, picked: Bool[Tensor, " N"]) -> Bool[Tensor, " N"]:
    """The picked Gaussians that are not faint; all of them if none is."""
    solid = picked & (torch.sigmoid(splats.opacities) >= EXTENT_FAINT)
    return solid if solid.any() else picked


def _sample(splats: Splats, picked: Bool[Tensor, " N"]) -> tuple[Splats, int]:
    """Some of the picked solid Gaussians in 64 bits, and how many each stands for."""
    rows = opaque_rows(splats, picked).nonzero()[:, 0]
    step = max(1, -(-len(rows) // EXTENT_SAMPLE))
    return splats[rows[::step]].map(lambda tensor: tensor.detach().cpu().double()), step


def _bounds(splats: Splats) -> tuple[Extent, float]:
    """The box around Gaussians, and the median of their largest standard deviations in it."""
    weights = splats.opacities.sigmoid()
    blur = _quantile(splats.scales.exp().amax(dim=1), weights, 0.5)
    low, high = (
        torch.stack([_quantile(axis, weights, share) for axis in splats.means.T])
        for share in (EXTENT_EDGE, 1 - EXTENT_EDGE)
    )
    return Extent(low - blur, high + blur), float(blur)


def _quantile(
    values: Float[Tensor, " M"], weights: Float[Tensor, " M"], share: float
) -> Float[Tensor, ""]:
    """The value up to which values have this share of the weight."""
    ordered, order = values.sort()
    reached = weights[order].cumsum(0) / weights.sum().clamp(min=1e-12)
    return ordered[min(int((reached < share).sum()), len(values) - 1)]


def _is_content(points: Float[Tensor, "M 3"], weights: Float[Tensor, " M"]) -> Bool[Tensor, " M"]:
    """Which points are dense, in parts that are heavy for their distance."""
    everything = torch.ones(len(points), dtype=torch.bool)
    if len(points) <= EXTENT_NEIGHBOURS:
        return everything
    distances, _ = nearest_points(points, points, EXTENT_NEIGHBOURS + 1)
    gaps = distances[:, 1:].mean(dim=1)  # column 0 is the point itself
    reach = SPARSE * float(_quantile(gaps, weights, 0.5))
    if not reach:
        return everything
    dense = gaps <= reach
    points, weights = points[dense], weights[dense]
    parts = _connected_parts(points, reach)
    shares = parts.bincount(weights) / weights.sum()
    heaviest = points[parts == shares.argmax()]
    low, high = heaviest.amin(dim=0), heaviest.amax(dim=0)
    away = torch.maximum(low - points, points - high).clamp(min=0).norm(dim=1)
    near = away <= EXTENT_FARTHEST * shares[parts] * (high - low).norm()
    return dense.masked_scatter(dense, near)


def _connected_parts(points: Float[Tensor, "M 3"], cell: float) -> Tensor:
    """The number of the connected part of each point: cells that touch are connected."""
    cells, cell_of = np.unique((points / cell).floor().long().numpy(), axis=0, return_inverse=True)
    tree = KDTree(cells)
    touching = tree.sparse_distance_matrix(tree, 1.75, output_type="coo_matrix")  # corners: 1.73
    _, parts = connected_components(touching, directed=False)
    return torch.from_numpy(parts[cell_of.reshape(-1)]).long()
