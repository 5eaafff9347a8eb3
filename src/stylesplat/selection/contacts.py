"""What of a pick lies on the surface that the object stands on, such as its shadow."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.scene.content import FAINT, solid
from stylesplat.scene.splats import Splats
from stylesplat.selection.margins import extent, near

# Lengths are shares of the object's extent
AROUND = 0.2  # how close Gaussians are that may be of what it stands on
THICK = 0.02  # half of a surface's thickness while one is looked for
SMOOTH = 0.004  # what no surface is taken to be smoother than
TOUCHING = 0.08  # how high above a surface the object may begin
FEW = 50  # Gaussians that make up no surface
SAMPLE = 4000  # Gaussians that planes are tried on
PLACES, EACH = 300, 10  # Gaussians, and planes through each and two others that are tried
FITS = 5  # each to what is near the one before
TRIES = 10  # times that the best of them is looked at closely
LARGE = 10.0  # times the median area, beyond which a Gaussian counts no more
ABOVE, LOWEST = 0.95, 0.01  # share of the object on one side of what it stands on; of its foot
SECTORS = 16  # directions from the object's foot, along the surface
BEYOND = 0.6  # share of the directions in which a surface has to go on
ROUGH = 2.0  # standard deviations from the surface that are still on it
FOOT = 4.0  # times the tolerance: how low what rises above the surface is its foot
NEIGHBOURS = 9  # most of which rise above where something rises above
# Share of the object's area that may lie on the surface; else the object itself does. Measured: a
# keyboard 0.33 to 0.38, the largest contact of the demo 0.19
MOST = 0.25


@dataclass(frozen=True)
class Surface:
    """A plane that an object stands on."""

    normal: Float[Tensor, "3"]
    """On the object's side."""
    offset: float
    """How far along the normal it lies from the origin."""
    tolerance: float
    """How far from it its own Gaussians lie."""

    def heights(self, points: Float[Tensor, "*M 3"]) -> Float[Tensor, "*M"]:
        """How far points lie above it."""
        return points @ self.normal - self.offset


@torch.no_grad()
def on_support(splats: Splats, picked: Bool[Tensor, " N"], *, seed: int = 0) -> Bool[Tensor, " N"]:
    """Picked Gaussians that lie on a plane which goes on around the object.

    What lies as close to the plane as its own Gaussians do is part of it, but for the foot of what
    rises above. An object that mostly lies in the plane, as a sheet of paper does, is kept, and so
    is one that stands on nothing.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        seed: Of the planes that are tried (RANSAC, Fischler and Bolles 1981).
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

    Others' Gaussians lie in it in most directions from the object's foot, and nearly all of the
    object lies on one side.

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
    rows = _some(own, areas, generator)
    left = points = means[_some(around, areas, generator)]
    planes = _beside(_planes(points, generator), means[rows], THICK * size)
    for _ in range(TRIES):
        surface = _best(planes, left, THICK * size)
        if surface is None:
            return None
        if _stands_on(surface, means[rows], size) and _goes_on(surface, points, means[rows], size):
            return surface
        left = left[surface.heights(left).abs() > THICK * size]
    return None


def _some(
    mask: Bool[Tensor, " N"], areas: Float[Tensor, " N"], generator: torch.Generator
) -> Tensor:
    """Rows of a mask, each as often as it is large."""
    rows = mask.nonzero()[:, 0]
    weights = areas[rows].clamp(max=LARGE * float(areas[rows].median()))
    return rows[torch.multinomial(weights, SAMPLE, replacement=True, generator=generator)]


def _areas(splats: Splats) -> Float[Tensor, " N"]:
    """How much each Gaussian hides where its largest sides are seen."""
    return torch.sigmoid(splats.opacities) * splats.scales.sort(dim=1).values[:, 1:].sum(1).exp()


def _planes(points: Float[Tensor, "M 3"], generator: torch.Generator) -> Float[Tensor, "P 4"]:
    """Normals and offsets of planes through three of the points, each near the others."""
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


def _beside(
    planes: Float[Tensor, "P 4"], own: Float[Tensor, "L 3"], thick: float
) -> Float[Tensor, "_ 4"]:
    """Those with nearly all of the object on one side, which their normals are turned to."""
    heights = own @ planes[:, :3].T - planes[:, 3]
    above = (heights > -thick).float().mean(dim=0) >= ABOVE
    below = (heights < thick).float().mean(dim=0) >= ABOVE
    return torch.cat([planes[above], -planes[below & ~above]])


def _best(
    planes: Float[Tensor, "P 4"], points: Float[Tensor, "M 3"], thick: float
) -> Surface | None:
    """The one with most points, and few beneath it, fitted to these."""
    if not len(planes):
        return None
    heights = points @ planes[:, :3].T - planes[:, 3]
    held = (heights.abs() < thick).sum(dim=0) - (heights < -2 * thick).sum(dim=0)
    best = planes[held.argmax()]
    if int(held.max()) < FEW:
        return None
    normal, offset = best[:3], float(best[3])
    chosen = points[heights[:, held.argmax()].abs() < thick]
    for _ in range(FITS):
        middle = chosen.mean(dim=0)
        fitted = torch.linalg.svd(chosen - middle, full_matrices=False).Vh[2]
        normal = fitted if fitted @ normal > 0 else -fitted
        offset = float(middle @ normal)
        chosen = points[(points @ normal - offset).abs() < thick]
    sigma = 1.4826 * float((chosen @ normal - offset).abs().median())
    return Surface(normal, offset, max(ROUGH * sigma, SMOOTH / THICK * thick))


def _stands_on(surface: Surface, own: Float[Tensor, "L 3"], size: float) -> bool:
    """Whether the object's foot is close to the surface."""
    heights = surface.heights(own)
    below = float((heights < -max(surface.tolerance, THICK * size)).float().mean())
    return below <= 1 - ABOVE and float(heights.quantile(LOWEST)) <= TOUCHING * size


def _goes_on(
    surface: Surface, points: Float[Tensor, "M 3"], own: Float[Tensor, "L 3"], size: float
) -> bool:
    """Whether the surface has Gaussians in most directions from the object's foot."""
    heights = surface.heights(own)
    low = own[heights <= heights.quantile(0.05).clamp(min=0) + THICK * size]
    away = points[surface.heights(points).abs() <= surface.tolerance] - low.median(dim=0).values
    _, _, axes = torch.linalg.svd(surface.normal[None])
    x, y = (away @ axes[1:].T).unbind(1)
    sectors = ((torch.atan2(y, x) / (2 * math.pi) + 0.5) * SECTORS).long().clamp(max=SECTORS - 1)
    return int((torch.bincount(sectors, minlength=SECTORS) > 1).sum()) >= BEYOND * SECTORS


def _foot(own: Float[Tensor, "L 3"], surface: Surface) -> Float[Tensor, "_ 3"]:
    """Where, on the surface, the object's lowest Gaussians are that rise above it."""
    heights = surface.heights(own)
    up = heights > surface.tolerance
    low = (up & (heights <= FOOT * surface.tolerance)).nonzero()[:, 0]
    if not len(low):
        return own[:0]
    points = own.double().numpy()
    _, rows = KDTree(points).query(points[low.numpy()], k=min(NEIGHBOURS, len(own)))
    low = low[up[torch.from_numpy(rows)].float().mean(dim=1) > 0.5]
    return own[low] - heights[low, None] * surface.normal
