"""The surface that an object stands on, whose Gaussians a pick often contains (its shadow).

The model: the surface is a plane that goes on around the object's foot, with nearly all of the
object on one side. RANSAC finds the plane (Fischler and Bolles 1981); what lies as close to it as
its own Gaussians do is part of it, except the foot of what rises above.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.scene.content import FAINT, solid
from stylesplat.scene.splats import Splats
from stylesplat.selection.shapes import extent, near

# Lengths are shares of the object's extent
AROUND = 0.2  # how close the Gaussians lie that may be of the surface
THICK = 0.02  # half of a surface's thickness while RANSAC looks for one
TOUCHING = 0.08  # how high above the surface the object may begin
FEW = 50  # Gaussians that make up no surface
SAMPLE = 4000  # Gaussians that planes are tried on
PLACES, EACH = 300, 10  # Gaussians, and planes through each and two of its neighbours
ATTEMPTS = 10  # surfaces to examine before there is none
ABOVE = 0.95  # share of the object on one side of the surface
SECTORS, BEYOND = 16, 0.6  # directions along the surface, and the share in which it has to go on
ROUGH = 2.0  # standard deviations from the surface that are still on it
FOOT = 4.0  # times the tolerance: how low the foot is of what rises above the surface
NEIGHBOURS = 9  # most of which rise above the surface where something rises
# Share of the object's area that may lie on the surface; else the object itself lies there.
# Measured: a keyboard 0.33 to 0.38, the largest contact of the demo 0.19
MOST = 0.25


@dataclass(frozen=True)
class Surface:
    """A plane that an object stands on."""

    normal: Float[Tensor, "3"]
    """On the object's side."""
    offset: float
    """Along the normal from the origin."""
    tolerance: float
    """How far from the plane its own Gaussians lie."""

    def heights(self, points: Float[Tensor, "*M 3"]) -> Float[Tensor, "*M"]:
        """Signed distances of points."""
        return points @ self.normal - self.offset


@torch.no_grad()
def on_support(splats: Splats, picked: Bool[Tensor, " N"], *, seed: int = 0) -> Bool[Tensor, " N"]:
    """Picked Gaussians that belong to the surface the object stands on.

    There are none if the object stands on nothing, or mostly lies in the plane, as a sheet of paper
    does.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        seed: Of the planes that are tried.
    """
    nothing = torch.zeros_like(picked)
    surface = find_support(splats, picked, seed=seed)
    if surface is None:
        return nothing
    means, own = splats.means.cpu(), picked.cpu()
    heights = surface.heights(means)
    rows = (own & (heights <= surface.tolerance)).nonzero()[:, 0]
    foot = _foot(means[solid(splats, picked).cpu()], surface)
    if len(foot):
        flat = means[rows] - heights[rows, None] * surface.normal
        rows = rows[~near(flat, foot, surface.tolerance)]
    found = nothing.index_fill(0, rows.to(picked.device), True)
    areas = _areas(splats)
    return found if areas[found].sum() <= MOST * areas[picked].sum() else nothing


@torch.no_grad()
def find_support(splats: Splats, picked: Bool[Tensor, " N"], *, seed: int = 0) -> Surface | None:
    """The plane that an object stands on; None if there is none.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        seed: Of the planes that are tried.
    """
    generator = torch.Generator().manual_seed(seed)
    areas = _areas(splats).cpu()
    own = solid(splats, picked).cpu()
    others = (~picked & (torch.sigmoid(splats.opacities) >= FAINT)).cpu()
    if int(own.sum()) < FEW or int(others.sum()) < FEW:
        return None
    means = splats.means.cpu()
    size = extent(means[own])
    around = others.masked_scatter(others, near(means[others], means[own], AROUND * size))
    if int(around.sum()) < FEW or size == 0:
        return None
    body = means[_sample(own, areas, generator)]
    left = points = means[_sample(around, areas, generator)]
    planes = _one_sided(_planes(points, generator), body, THICK * size)
    for _ in range(ATTEMPTS):
        surface = _best(planes, left, THICK * size)
        if surface is None:
            return None
        if _supports(surface, body, size) and _goes_on(surface, points, body, size):
            return surface
        left = left[surface.heights(left).abs() > THICK * size]
    return None


def _sample(
    mask: Bool[Tensor, " N"], areas: Float[Tensor, " N"], generator: torch.Generator
) -> Tensor:
    """Rows of a mask, drawn in proportion to their areas, up to ten times the median."""
    rows = mask.nonzero()[:, 0]
    weights = areas[rows].clamp(max=10 * float(areas[rows].median()))
    return rows[torch.multinomial(weights, SAMPLE, replacement=True, generator=generator)]


def _areas(splats: Splats) -> Float[Tensor, " N"]:
    """Opacity times the area of each Gaussian's largest side."""
    return torch.sigmoid(splats.opacities) * splats.scales.sort(dim=1).values[:, 1:].sum(1).exp()


def _planes(points: Float[Tensor, "M 3"], generator: torch.Generator) -> Float[Tensor, "P 4"]:
    """Normals and offsets of planes through three points that lie near each other."""
    first = points[torch.randint(len(points), (PLACES,), generator=generator)]
    count = len(points) // 4
    _, close = KDTree(points.double().numpy()).query(first.double().numpy(), k=count)
    others = torch.randint(1, count, (PLACES, 2 * EACH), generator=generator)
    b, c = points[torch.from_numpy(close).gather(1, others)].view(-1, 2, 3).unbind(1)
    a = first.repeat_interleave(EACH, dim=0)
    normals = torch.linalg.cross(b - a, c - a)
    lengths = normals.norm(dim=1, keepdim=True)
    normals = normals / lengths.clamp(min=1e-30)
    planes = torch.cat([normals, (a * normals).sum(dim=1, keepdim=True)], dim=1)
    return planes[lengths[:, 0] > 0]  # the same Gaussian may have been drawn twice


def _one_sided(
    planes: Float[Tensor, "P 4"], body: Float[Tensor, "L 3"], thick: float
) -> Float[Tensor, "_ 4"]:
    """The planes with nearly all of the object on one side, which their normals point to."""
    heights = body @ planes[:, :3].T - planes[:, 3]
    above = (heights > -thick).float().mean(dim=0) >= ABOVE
    below = (heights < thick).float().mean(dim=0) >= ABOVE
    return torch.cat([planes[above], -planes[below & ~above]])


def _best(
    planes: Float[Tensor, "P 4"], points: Float[Tensor, "M 3"], thick: float
) -> Surface | None:
    """The plane with most points on it and few beneath, fitted to the former."""
    if not len(planes):
        return None
    heights = points @ planes[:, :3].T - planes[:, 3]
    held = (heights.abs() < thick).sum(dim=0) - (heights < -2 * thick).sum(dim=0)
    best = planes[held.argmax()]
    if int(held.max()) < FEW:
        return None
    normal, offset = best[:3], float(best[3])
    chosen = points[heights[:, held.argmax()].abs() < thick]
    for _ in range(5):  # each fit to the points near the one before
        middle = chosen.mean(dim=0)
        fitted = torch.linalg.svd(chosen - middle, full_matrices=False).Vh[2]
        normal = fitted if fitted @ normal > 0 else -fitted
        offset = float(middle @ normal)
        chosen = points[(points @ normal - offset).abs() < thick]
    sigma = 1.4826 * float((chosen @ normal - offset).abs().median())
    return Surface(normal, offset, max(ROUGH * sigma, thick / 5))


def _supports(surface: Surface, body: Float[Tensor, "L 3"], size: float) -> bool:
    """Whether the object's foot is close to the surface, and hardly anything beneath it."""
    heights = surface.heights(body)
    below = float((heights < -max(surface.tolerance, THICK * size)).float().mean())
    return below <= 1 - ABOVE and float(heights.quantile(0.01)) <= TOUCHING * size


def _goes_on(
    surface: Surface, points: Float[Tensor, "M 3"], body: Float[Tensor, "L 3"], size: float
) -> bool:
    """Whether the surface has Gaussians in most directions from the object's foot."""
    heights = surface.heights(body)
    low = body[heights <= heights.quantile(1 - ABOVE).clamp(min=0) + THICK * size]
    away = points[surface.heights(points).abs() <= surface.tolerance] - low.median(dim=0).values
    _, _, axes = torch.linalg.svd(surface.normal[None])
    x, y = (away @ axes[1:].T).unbind(1)
    sectors = ((torch.atan2(y, x) / (2 * math.pi) + 0.5) * SECTORS).long().clamp(max=SECTORS - 1)
    return int((torch.bincount(sectors, minlength=SECTORS) > 1).sum()) >= BEYOND * SECTORS


def _foot(body: Float[Tensor, "L 3"], surface: Surface) -> Float[Tensor, "_ 3"]:
    """Where, on the surface, the lowest Gaussians lie of what rises above it.

    A single Gaussian above the surface may belong to it: without the vote of neighbours a desk's
    mat kept 8 % of what lies under it.
    """
    heights = surface.heights(body)
    rises = heights > surface.tolerance
    low = (rises & (heights <= FOOT * surface.tolerance)).nonzero()[:, 0]
    if not len(low):
        return body[:0]
    points = body.double().numpy()
    _, rows = KDTree(points).query(points[low.numpy()], k=min(NEIGHBOURS, len(body)))
    low = low[rises[torch.from_numpy(rows)].float().mean(dim=1) > 0.5]
    return body[low] - heights[low, None] * surface.normal
