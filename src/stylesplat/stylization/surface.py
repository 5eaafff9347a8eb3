"""An object's surface as its views show it, sampled evenly."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.reference import with_matrices_of
from stylesplat.rendering.render import colors_of
from stylesplat.rendering.surface import SurfacePoints, depth_map, surface_points
from stylesplat.rendering.weights import (
    COVERED,
    Contributions,
    contributions,
    coverage,
    geometry_only,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import project
from stylesplat.scene.splats import Splats
from stylesplat.stylization.views import ObjectBox, box_cameras, per_view

SURFACE_VIEWS = 16  # with 12 places that few of them show stay bare
SURFACE_LENGTH = 200.0  # longer side of the object in them, in pixels
SURFACE_MARGIN = 8  # pixels around its box, where nothing is to show
SURFACE_SOLID = 0.7  # coverage from which a pixel shows the surface; with less it fills holes alone
PULLS = 4  # pixels at most by which points beyond a silhouette are moved inwards
HOLE = 6.0  # pixels around a point without any inside the silhouettes: less is no hole
SURFACE_BESIDE = 2.0  # pixels from its rim, where there are points already
SURFACE_GRAZING = 0.25  # cosine below which depths are too uncertain
POOLED = 0.6  # side of the cubes whose points are averaged, in distances of the samples
SURFACE_PLANE = 16  # points that a plane is fitted to


class UnpaintedView(NamedTuple):
    """What one camera sees of an object before a canvas is laid on it."""

    camera: Cameras
    linear: Contributions
    """The contributions of the object's Gaussians."""
    image: Float[Tensor, "H W 3"]


@torch.no_grad()
def unpainted_views(
    splats: Splats, mask: Bool[Tensor, " N"], boxes: Sequence[ObjectBox]
) -> list[UnpaintedView]:
    """Views of the whole object, `SURFACE_LENGTH` pixels long."""

    def look(camera: Cameras) -> UnpaintedView:
        camera = with_matrices_of(splats, camera)
        linear = contributions(splats, camera, mask)
        colors = colors_of(splats, linear.gaussians, camera.positions)
        return UnpaintedView(camera, linear, linear.render(colors))

    cameras = box_cameras(boxes, SURFACE_LENGTH, SURFACE_VIEWS, SURFACE_MARGIN)
    return [*per_view(look, cameras, "looking at the object", splats.device)]


@torch.no_grad()
def find_surface(
    splats: Splats, mask: Bool[Tensor, " N"], views: Sequence[UnpaintedView]
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"], Float[Tensor, "P 3"], float]:
    """Find an object's surface from rendered depths.

    Returns:
        The points, one for each pixel that shows it; their normals towards the camera that saw
        them; their colours; the typical size of a pixel if the object is `SURFACE_LENGTH` pixels
        long.
    """
    alone = geometry_only(splats[mask])

    def look(view: UnpaintedView) -> tuple[SurfacePoints, Tensor]:
        shown = depth_map(splats, view.camera, mask)
        found = surface_points(shown, view.image, grazing=SURFACE_GRAZING)
        return found, coverage(alone, view.camera)

    found = per_view(look, views, "looking for the surface", splats.device)
    parts, silhouettes = zip(*found, strict=True)
    points, normals, colors, sizes, covered = map(torch.cat, zip(*parts, strict=True))
    size = float(sizes.median())

    def outside(points: Float[Tensor, "P 3"]) -> Bool[Tensor, " P"]:
        """Which points lie beyond the silhouette of a view."""
        found = torch.zeros(len(points), dtype=torch.bool, device=points.device)
        for view, silhouette in zip(views, silhouettes, strict=True):
            inside, there = _look_up(points, view.camera, silhouette)
            found |= inside.masked_scatter(inside, there < COVERED)
        return found

    kept = project_into_silhouettes(points, normals, covered > SURFACE_SOLID, size, outside)
    return points[kept], normals[kept], colors[kept], size


def project_into_silhouettes(
    points: Float[Tensor, "P 3"],
    normals: Float[Tensor, "P 3"],
    solid: Bool[Tensor, " P"],
    size: float,
    outside: Callable[[Float[Tensor, "Q 3"]], Bool[Tensor, " Q"]],
) -> Bool[Tensor, " P"]:
    """Find the surface's points; those outside move inwards, in place, where they fill a hole.

    Depths are less exact than silhouettes: of a flat side that some views see along it, no point
    may lie inside. What is not solid fills holes of what is, too. The size is that of a pixel.
    """
    beyond = outside(points)
    kept = solid & ~beyond
    if not kept.any():
        return kept
    spare, beyond = (~kept).nonzero()[:, 0], beyond.nonzero()[:, 0]
    for _ in range(PULLS):
        points[beyond] -= size * normals[beyond]
        beyond = beyond[outside(points[beyond])]
    spare = spare[~torch.isin(spare, beyond)]
    places = points.double().cpu().numpy()
    spares = places[spare.cpu().numpy()]
    far, _ = KDTree(places[kept.cpu().numpy()]).query(spares, workers=-1)
    far = torch.from_numpy(far).to(points) / size
    amid = (far > HOLE).cpu().numpy()
    near, _ = KDTree(spares[amid]).query(spares, workers=-1)
    kept[spare] = (far > SURFACE_BESIDE) & (torch.from_numpy(near).to(points) < HOLE * size)
    return kept


def _look_up(
    points: Float[Tensor, "P 3"], camera: Cameras, values: Float[Tensor, "H W"]
) -> tuple[Bool[Tensor, " P"], Float[Tensor, " L"]]:
    """Which points project into a camera's image, and the values there."""
    pixels, depths = project(points, camera)
    size = torch.tensor(camera.size).to(pixels)
    inside = ((pixels >= 0) & (pixels < size)).all(dim=1) & (depths > 0)
    x, y = pixels[inside].long().unbind(1)
    return inside, values[y, x]


def project_to_planes(
    points: Float[Tensor, "P 3"], normals: Float[Tensor, "P 3"], rows: Int[Tensor, " L"]
) -> tuple[Float[Tensor, "L 3"], Float[Tensor, "L 3"]]:
    """Some points moved onto the planes of their neighbours, and the normals of the planes."""
    coordinates = points.double().cpu().numpy()
    count = min(SURFACE_PLANE, len(points))
    _, near = KDTree(coordinates).query(coordinates[rows.cpu().numpy()], k=count, workers=-1)
    near = torch.from_numpy(near).to(rows).view(len(rows), -1)
    smooth = F.normalize(normals[near].mean(dim=1), dim=1)
    above = ((points[rows] - points[near].mean(dim=1)) * smooth).sum(dim=1, keepdim=True)
    return points[rows] - above * smooth, smooth


def poisson_disk_sample(
    points: Float[Tensor, "P 3"], distance: float, *, seed: int
) -> Int[Tensor, " L"]:
    """Choose points of which no two are closer than a distance, as many as fit, in random order."""
    places = points.double().cpu().numpy()
    place_in_order = np.random.default_rng(seed).permutation(len(places))
    tree = KDTree(places, compact_nodes=False, balanced_tree=False)  # is made sooner
    pairs = tree.query_pairs(distance, output_type="ndarray")
    turned = place_in_order[pairs[:, 0]] > place_in_order[pairs[:, 1]]
    first, later = np.where(turned[:, None], pairs[:, ::-1], pairs).T
    free = np.ones(len(places), bool)
    while len(first):  # each round chooses the points that wait for no other
        waiting = np.zeros_like(free)
        waiting[later] = True
        free[later[~waiting[first]]] = False
        undecided = waiting[first] & free[first] & free[later]
        first, later = first[undecided], later[undecided]
    return torch.from_numpy(free.nonzero()[0]).to(points.device)
