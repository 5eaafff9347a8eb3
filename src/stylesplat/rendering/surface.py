"""Where the surface is that a camera sees: depths, normals, and points of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.reference import (
    Backend,
    activated,
    depth_planes,
    rasterizer,
    views_of,
    with_matrices_of,
)
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.visibility import in_view
from stylesplat.rendering.weights import COVERED, coverage, expected_depth, geometry_only
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.projection import normals_towards, pixel_centres, project, unproject
from stylesplat.scene.splats import Splats

# The part of a pixel's weight, from the front, that shows its surface. The mean of all lies between
# the surface and what haze, or a pixel at a rim, shares with it: it has no table under a toy, and
# makes one slab of a guitar's strings and body. One quantile jumps from Gaussian to Gaussian.
SURFACE_SHARES = 0.1, 0.4
# Shares of an object's longest side, one for each round: what lies farther behind the mean depth is
# another side. Meshes of the demo's vase and teapot, fox and the bottle of desk were measured with
# these; they are as good with `front_depth` but for the bottle's (benchmarks/README.md, Meshes).
NEAR_SIDE_SLACK = 0.08, 0.03


@dataclass(frozen=True, eq=False)
class DepthMap:
    """The surface that one camera sees."""

    camera: Cameras
    depths: Float[Tensor, "H W"]
    """Along the camera's z axis; 0 where nothing shows."""
    coverage: Float[Tensor, "H W"]
    """The opaque share of what was asked for."""
    points: Float[Tensor, "H W 3"]
    """In the world."""
    normals: Float[Tensor, "H W 3"]
    """Towards the camera, from neighbouring pixels."""
    cosines: Float[Tensor, "H W"]
    """Between normals and rays: where it is small, depths are uncertain."""

    def reliable(self, grazing: float) -> Bool[Tensor, "H W"]:
        """Where a pixel is covered by half, and seen at more than a grazing angle, a cosine."""
        return (self.coverage > COVERED) & (self.cosines > grazing)


@torch.no_grad()
def front_depth(
    splats: Splats,
    camera: Cameras,
    mask: Bool[Tensor, " N"] | None = None,
    *,
    shares: tuple[float, float] = SURFACE_SHARES,
    backend: Backend = "auto",
) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
    """The depth of the surface in each pixel of one camera, 0 where nothing is, and its coverage.

    Args:
        splats: The scene.
        camera: One camera.
        mask: The Gaussians whose surface it is; others only hide them. All by default.
        shares: The part of a pixel's weight whose mean depth it is, from the front.
        backend: As `rasterize` takes it.
    """
    near = in_view(splats, camera, backend=backend)
    gaussians = activated(
        geometry_only(splats).map(lambda tensor: tensor.index_select(0, near.rows))
    )
    (view,) = views_of(with_matrices_of(splats, camera))
    planes = depth_planes(gaussians, view, near.projected.conics)
    counted = torch.ones_like(near.projected.opacities)
    if mask is not None:
        counted *= mask[near.rows]
    drawn_by = rasterizer(backend, splats.device)
    return drawn_by.front_depth(near.projected, planes, counted, camera.size, shares)


def depth_map(
    splats: Splats,
    camera: Cameras,
    mask: Bool[Tensor, " N"] | None = None,
) -> DepthMap:
    """The surface that one camera sees; see `front_depth`."""
    return _with_normals(*front_depth(splats, camera, mask), camera)


@torch.no_grad()
def near_side_depth_map(splats: Splats, camera: Cameras, longest: float) -> DepthMap:
    """The mean depth of the near side of an object that is alone; coverage is that of all sides.

    It is smoother than `depth_map`, which follows single Gaussians.

    Args:
        splats: The object.
        camera: One camera.
        longest: The object's longest side, in world units.
    """
    depths, coverage = expected_depth(splats, camera)
    width, height = camera.size
    pixels, along = project(splats.means, camera)
    x, y = pixels[:, 0].long().clamp(0, width - 1), pixels[:, 1].long().clamp(0, height - 1)
    for share in NEAR_SIDE_SLACK:
        near = along < depths[y, x] + share * longest
        depths, _ = expected_depth(splats[near], camera)
    return _with_normals(depths, coverage, camera)


def _with_normals(
    depths: Float[Tensor, "H W"], coverage: Float[Tensor, "H W"], camera: Cameras
) -> DepthMap:
    points = points_at(depths, camera)
    normals, cosines = normals_towards(points, camera.positions.to(points))
    return DepthMap(camera, depths, coverage, points, normals, cosines)


def points_at(depths: Float[Tensor, "H W"], camera: Cameras) -> Float[Tensor, "H W 3"]:
    """The points in the world that a camera's pixels show, of these depths."""
    centres = pixel_centres(*camera.size).to(depths)
    return unproject(centres, depths.flatten(), camera).view(*depths.shape, 3)


class SurfacePoints(NamedTuple):
    """What pixels of some views show of a surface, one row each."""

    points: Float[Tensor, "P 3"]
    normals: Float[Tensor, "P 3"]
    """Towards the cameras."""
    colors: Float[Tensor, "P 3"]
    sizes: Float[Tensor, " P"]
    """The distance of neighbouring pixels' points, if the surface faces the camera."""
    coverage: Float[Tensor, " P"]


def surface_points(
    shown: DepthMap, image: Float[Tensor, "H W 3"], *, grazing: float
) -> SurfacePoints:
    """The points of a camera's reliable pixels, with the colours of an image."""
    reliable = shown.reliable(grazing)
    sizes = shown.depths / shown.camera.Ks[0, 0, 0].to(shown.depths)
    every = shown.points, shown.normals, image, sizes, shown.coverage
    return SurfacePoints(*(each[reliable] for each in every))


def average_in_voxels(
    side: float, points: Float[Tensor, "P 3"], *others: Float[Tensor, "P 3"]
) -> tuple[Int[Tensor, " C"], list[Float[Tensor, "C 3"]]]:
    """How many points each cube of a grid has, and the means of them and of their other values."""
    cells = (points / side).floor().long()
    cells -= cells.amin(dim=0)
    across, along, _ = (cells.amax(dim=0) + 1).tolist()
    x, y, z = cells.unbind(dim=1)
    keys = (z * along + y) * across + x  # CUDA has no product of integer matrices
    _, index, counts = keys.unique(return_inverse=True, return_counts=True)
    none = points.new_zeros(len(counts), 3)
    means = [none.index_add(0, index, v) / counts[:, None] for v in (points, *others)]
    return counts, means


SURFACE_SOLID = 0.7  # coverage from which a pixel shows the surface; with less it fills holes alone
SURFACE_GRAZING = 0.25  # cosine below which depths are too uncertain
SURFACE_PULLS = 4  # pixels at most by which points beyond a silhouette are moved inwards
SURFACE_HOLE = 6.0  # pixels around a point without any inside the silhouettes: less is no hole
SURFACE_BESIDE = 2.0  # pixels from its rim, where there are points already
SURFACE_PLANE = 16  # points that a plane is fitted to


@torch.no_grad()
def find_surface(
    splats: Splats,
    mask: Bool[Tensor, " N"],
    views: Sequence[tuple[Cameras, Float[Tensor, "_ _ 3"]]],
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"], Float[Tensor, "P 3"], float]:
    """Find an object's surface from rendered depths.

    Args:
        splats: The scene.
        mask: The object's Gaussians.
        views: Cameras that show all of the object, and their images.

    Returns:
        The points, one for each pixel that shows it; their normals towards the camera that saw
        them; their colours; the typical distance of the points of neighbouring pixels.
    """
    alone, cameras = geometry_only(splats[mask]), [camera for camera, _ in views]

    def look(view: tuple[Cameras, Tensor]) -> tuple[SurfacePoints, Tensor]:
        camera, image = view
        found = surface_points(depth_map(splats, camera, mask), image, grazing=SURFACE_GRAZING)
        return found, coverage(alone, camera)

    found = per_view(look, views, "looking for the surface", splats.device)
    parts, silhouettes = zip(*found, strict=True)
    points, normals, colors, sizes, covered = map(torch.cat, zip(*parts, strict=True))
    size = float(sizes.median())
    outside = partial(outside_silhouettes, cameras=cameras, silhouettes=silhouettes)
    kept = project_into_silhouettes(points, normals, covered > SURFACE_SOLID, size, outside)
    return points[kept], normals[kept], colors[kept], size


def outside_silhouettes(
    points: Float[Tensor, "P 3"],
    cameras: Sequence[Cameras],
    silhouettes: Sequence[Float[Tensor, "_ _"]],
) -> Bool[Tensor, " P"]:
    """Which points lie beyond the silhouette of a view; silhouettes are coverages."""
    found = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    for camera, silhouette in zip(cameras, silhouettes, strict=True):
        pixels, depths = project(points, camera)
        size = torch.tensor(camera.size).to(pixels)
        inside = ((pixels >= 0) & (pixels < size)).all(dim=1) & (depths > 0)
        x, y = pixels[inside].long().unbind(1)
        found |= inside.masked_scatter(inside, silhouette[y, x] < COVERED)
    return found


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
    for _ in range(SURFACE_PULLS):
        points[beyond] -= size * normals[beyond]
        beyond = beyond[outside(points[beyond])]
    spare = spare[~torch.isin(spare, beyond)]
    spares = points[spare]
    far = nearest_points(points[kept], spares)[0][:, 0].to(points) / size
    near = nearest_points(spares[far > SURFACE_HOLE], spares)[0][:, 0].to(points)
    kept[spare] = (far > SURFACE_BESIDE) & (near < SURFACE_HOLE * size)
    return kept


def project_to_planes(
    points: Float[Tensor, "P 3"], normals: Float[Tensor, "P 3"], rows: Int[Tensor, " L"]
) -> tuple[Float[Tensor, "L 3"], Float[Tensor, "L 3"]]:
    """Some points moved onto the planes of their neighbours, and the normals of the planes."""
    _, near = nearest_points(points, points[rows], SURFACE_PLANE)
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
