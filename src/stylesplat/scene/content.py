"""The content of a splat: what its photos were about, without floaters and far background.

The model: photos show their subject from near, so its Gaussians lie close to each other. Points
coarser than the finest quarter by far are background; the rest falls into connected parts, of which
those belong to the content that are heavy for their distance from it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError
from torch import Tensor

from stylesplat.scene.splats import Splats

# Opacity below which a Gaussian is no surface. In two trained scenes 30 to 70 % of an object's are
# fainter, and many lie far from it: with them, an object measured up to 60 times its size.
FAINT = 0.05
SAMPLE = 30_000  # Gaussians; neighbours among a million would take seconds
NEIGHBOURS = 8  # whose mean distance measures how fine the splat is at a point
FEW = 20  # Gaussians that are all content
FINE = 0.25  # share of the opacity that is surely content
# Times the distances of these, beyond which a point is background. Of a guitar and a figure that
# was cut out, 0.3 % are; of a demo scene's backdrop nearly all.
COARSE = 8.0
NEAR = 0.15  # of the diagonal: closer parts are content, however light
FARTHER = 10.0  # more diagonals of distance for a part, times its share of the opacity
EDGE = 0.001  # share of the opacity outside the bounds, at each end of each axis
# The same for an object, some of whose Gaussians are strays. With 0.001 a toy cube of 0.74 measured
# 1.08 by 0.74, with 0.01 a vase lost 4 % of its height
STRAY = 0.005


@dataclass(frozen=True)
class Extent:
    """A box along the world's axes."""

    low: Float[Tensor, "3"]
    """The corner with the smaller coordinates."""
    high: Float[Tensor, "3"]
    """The one opposite."""

    @property
    def centre(self) -> Float[Tensor, "3"]:
        """Half-way between the corners."""
        return (self.low + self.high) / 2

    @property
    def size(self) -> Float[Tensor, "3"]:
        """Its lengths."""
        return self.high - self.low


@dataclass(frozen=True)
class Content:
    """Samples of a splat's content and of everything else, in 64 bits."""

    points: Float[Tensor, "M 3"]
    """Centres of the content's Gaussians within its extent."""
    weights: Float[Tensor, " M"]
    """Their opacities."""
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
        """Points that lie in a picture only if all content does."""
        return self.outline_of(self.points)

    def outline_of(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "_ 3"]:
        """The outline of some of the points."""
        axes = torch.eye(3).double()
        rims = self.blur * torch.cat([axes, -axes])
        return (_hull(points)[:, None] + rims).flatten(0, 1)


def content_of(splats: Splats) -> Content:
    """Find the content of a splat with at least one Gaussian."""
    rows, points, weights, sizes = _sample_of(splats)
    kept = _content(points, weights)
    blur = weighted_quantile(sizes[kept, 0], weights[kept], 0.5)
    extent = _bounds(points[kept], weights[kept], blur)
    inside = ((points >= extent.low) & (points <= extent.high)).all(dim=1)
    own, apart = kept & inside, ~kept & ~inside
    return Content(
        points=points[own],
        weights=weights[own],
        blur=float(blur),
        extent=extent,
        others=points[apart],
        areas=_areas(splats, rows, weights, sizes)[apart],
        blurs=sizes[apart, 0],
    )


def object_content(splats: Splats, picked: Bool[Tensor, " N"]) -> Content:
    """The content of an object; `others` are all Gaussians outside its box, which may hide it.

    Args:
        splats: The scene.
        picked: At least one of its Gaussians.
    """
    own, rest = content_of(splats[picked]), splats[~picked]
    if not len(rest):
        return own
    extent = extent_of(splats, picked)
    rows, points, weights, sizes = _sample_of(rest)
    apart = ~((points >= extent.low) & (points <= extent.high)).all(dim=1)
    inside = ((own.points >= extent.low) & (own.points <= extent.high)).all(dim=1)
    return replace(
        own,
        points=own.points[inside],
        weights=own.weights[inside],
        extent=extent,
        others=points[apart],
        areas=_areas(rest, rows, weights, sizes)[apart],
        blurs=sizes[apart, 0],
    )


def extent_of(splats: Splats, picked: Bool[Tensor, " N"]) -> Extent:
    """The box around some Gaussians, without faint ones and strays.

    Args:
        splats: The scene.
        picked: At least one of its Gaussians.
    """
    rows = solid(splats, picked)
    points = splats.means[rows].detach().cpu().double()
    weights = torch.sigmoid(splats.opacities[rows]).detach().cpu().double()
    sizes = splats.scales[rows].detach().cpu().double().exp().amax(dim=1)
    return _bounds(points, weights, weighted_quantile(sizes, weights, 0.5), edge=STRAY)


def solid(splats: Splats, picked: Bool[Tensor, " N"]) -> Bool[Tensor, " N"]:
    """The picked Gaussians that are not faint; all of them if none is."""
    solid = picked & (torch.sigmoid(splats.opacities) >= FAINT)
    return solid if solid.any() else picked


def weighted_quantile(
    values: Float[Tensor, " M"], weights: Float[Tensor, " M"], share: float
) -> Float[Tensor, ""]:
    """The value up to which values have this share of the weight."""
    ordered, order = values.sort()
    reached = weights[order].cumsum(0) / weights.sum().clamp(min=1e-12)
    return ordered[min(int((reached < share).sum()), len(values) - 1)]


def _hull(points: Float[Tensor, "M 3"]) -> Float[Tensor, "_ 3"]:
    """The corners of the convex hull; all points if they have none."""
    try:
        rows = ConvexHull(points.numpy(), qhull_options="QJ Pp").vertices  # joggled: may be flat
    except QhullError:
        return points
    return points[torch.from_numpy(rows).long()]


def _sample_of(
    splats: Splats,
) -> tuple[Int[Tensor, " M"], Float[Tensor, "M 3"], Float[Tensor, " M"], Float[Tensor, "M 3"]]:
    """Rows of some solid Gaussians, their centres, opacities and sizes (largest first); 64 bits."""
    everything = torch.ones(len(splats), dtype=torch.bool, device=splats.device)
    rows = solid(splats, everything).nonzero()[:, 0]
    rows = rows[:: -(-len(rows) // SAMPLE)]
    points = splats.means[rows].detach().cpu().double()
    weights = torch.sigmoid(splats.opacities[rows]).detach().cpu().double()
    sizes = splats.scales[rows].detach().cpu().double().exp().sort(dim=1, descending=True).values
    return rows, points, weights, sizes


def _areas(
    splats: Splats,
    rows: Int[Tensor, " M"],
    weights: Float[Tensor, " M"],
    sizes: Float[Tensor, "M 3"],
) -> Float[Tensor, " M"]:
    """The area that each of a sample hides, with all that the sample leaves out."""
    shown = int((torch.sigmoid(splats.opacities) >= FAINT).sum())
    each = max(1.0, shown / len(rows))  # Gaussians per one of the sample
    return each * 2 * torch.pi * weights * sizes[:, :2].prod(dim=1)


def _content(points: Float[Tensor, "M 3"], weights: Float[Tensor, " M"]) -> Bool[Tensor, " M"]:
    """Which points are fine enough, in parts that are heavy enough for their distance."""
    everything = torch.ones(len(points), dtype=torch.bool)
    if len(points) < FEW:
        return everything
    gaps, _ = KDTree(points.numpy()).query(points.numpy(), k=NEIGHBOURS + 1, workers=-1)
    gap = torch.from_numpy(gaps[:, 1:]).mean(dim=1)  # column 0 is the point itself
    coarse = COARSE * float(weighted_quantile(gap, weights, FINE))
    if not coarse:
        return everything
    fine = gap <= coarse
    parts = _parts(points[fine], coarse)
    return fine.masked_scatter(fine, _heavy_parts(points[fine], weights[fine], parts))


def _parts(points: Float[Tensor, "M 3"], reach: float) -> Int[Tensor, " M"]:
    """The connected part of each point: cells that touch are connected."""
    cells, cell_of = np.unique((points / reach).floor().long().numpy(), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(r=1.75, output_type="ndarray")  # corner to corner is 1.73
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=2 * (len(cells),))
    _, parts = connected_components(links, directed=False)
    return torch.from_numpy(parts[cell_of.reshape(-1)]).long()


def _heavy_parts(
    points: Float[Tensor, "M 3"], weights: Float[Tensor, " M"], parts: Int[Tensor, " M"]
) -> Bool[Tensor, " M"]:
    """Which points are of the heaviest part, or of one that is heavy for its distance."""
    count = int(parts.max()) + 1
    shares = weights.new_zeros(count).index_add(0, parts, weights) / weights.sum()
    index = parts[:, None].expand(-1, 3)
    lows = points.new_zeros(count, 3).scatter_reduce(0, index, points, "amin", include_self=False)
    highs = points.new_zeros(count, 3).scatter_reduce(0, index, points, "amax", include_self=False)
    first, *others = shares.argsort(descending=True).tolist()
    low, high, kept = lows[first], highs[first], [first]
    for part in others:
        gap = torch.maximum(low - highs[part], lows[part] - high).clamp(min=0).norm()
        if gap <= (NEAR + FARTHER * shares[part]) * (high - low).norm():
            low, high = torch.minimum(low, lows[part]), torch.maximum(high, highs[part])
            kept.append(part)
    return torch.isin(parts, torch.tensor(kept))


def _bounds(
    points: Float[Tensor, "M 3"],
    weights: Float[Tensor, " M"],
    blur: Float[Tensor, ""],
    *,
    edge: float = EDGE,
) -> Extent:
    low = torch.stack([weighted_quantile(axis, weights, edge) for axis in points.T])
    high = torch.stack([weighted_quantile(axis, weights, 1 - edge) for axis in points.T])
    return Extent(low - blur, high + blur)
