"""The surface of an object: depths from all around, fused to distances (Curless, Levoy 1996).

Voxels that no photo could see count as inside the object, unless some view sees through them: so
the surface is closed where the object stands on something.
"""

import math
from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numba import prange
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.meshes.rasterize import pixel_of, projection_of
from stylesplat.progress import track
from stylesplat.rendering.kernels.jit import kernel
from stylesplat.rendering.surface import near_side_depth_map
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import COVERED, geometry_only
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.content import Extent, extent_of
from stylesplat.scene.projection import share_in_images
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import cameras_of, centred_K

AROUND = 48  # directions all around
FUSION_PHOTOS = 64  # views from where photos were taken, at most
AWAY = 3.0  # radii of the object from its centre to the cameras
EMPTY = 0.25  # coverage below which the object is not there, in views that no photo supports
FUSION_PIXELS = 2  # of a view, by voxel
FUSION_SMALLEST = 160  # pixels of a view
FINENESS = 0.9  # voxels along the longest side, times the square root of the faces wanted
VOXELS = (48, 320)  # at least and at most: 320 take 1 GB
TRUNCATION = 4.0  # voxels
FUSION_LEAST_COSINE = 0.15  # below which depths are too uncertain
FUSION_SMOOTHING = 0.7  # voxels
MESH_FAINT, SOLID = 0.1, 0.5  # coverage that shows, and the share of it that has to be opaque
FUSION_NEAR = 0.02  # of the extent, and a voxel at least: so near to a depth the surface is seen
LEAST_SEEN = 0.05  # weight of the depths at a vertex: less is a guess
OPEN = 0.3  # share of the surface: where more is a guess, it is left open
# Of the way to their faces' middle: so far vertices that coincide are moved apart
FUSION_APART = 0.05
# Of the extent: closer vertices coincide, and programs that read files merge them
FUSION_SAME = 1e-5
FUSION_SPECK = 0.05  # of the largest part's area: smaller parts are strays


@dataclass(frozen=True, eq=False)
class FusedSurface:
    """Triangles, outside counterclockwise."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    seen: Float[np.ndarray, " V"]
    """How well the trusted views show each vertex."""


@dataclass(frozen=True, eq=False)
class MeshViews:
    """Cameras all around an object, which is alone in them."""

    cameras: Cameras
    trusted: Bool[np.ndarray, " C"]
    """Which of them look from where photos were taken: what others show may be a guess."""


def mesh_views(splats: Splats, photos: Cameras | None, *, length: int) -> MeshViews:
    """Square views of a whole object; without photos all of them are trusted."""
    extent = extent_of(splats, torch.ones(len(splats), dtype=torch.bool))
    outward = _all_around(AROUND if photos is not None else AROUND + FUSION_PHOTOS)
    trusted = torch.full((len(outward),), photos is None)
    if photos is not None:
        seeing = (share_in_images(splats.means, photos) > 0).nonzero()[:, 0]
        rows = evenly_spaced(seeing.tolist(), FUSION_PHOTOS)
        towards = F.normalize(photos.positions[rows].double() - extent.centre, dim=1)
        outward = torch.cat([towards, outward])
        trusted = torch.cat([torch.ones(len(towards), dtype=torch.bool), trusted])
    return MeshViews(_cameras_at(extent, outward, length), trusted.numpy())


def cameras_all_around(splats: Splats, *, length: int) -> Cameras:
    """Square views of a whole object from all directions, above and below as well."""
    return _cameras_at(
        extent_of(splats, torch.ones(len(splats), dtype=torch.bool)), _all_around(AROUND), length
    )


def _cameras_at(extent: Extent, outward: Float[Tensor, "M 3"], length: int) -> Cameras:
    radius = float(extent.size.norm()) / 2
    up = torch.eye(3).double()[0]  # which no direction equals
    viewmats = look_at(extent.centre + AWAY * radius * outward, extent.centre, up)
    K = centred_K(length / 2 * math.sqrt(AWAY**2 - 1), (length, length))
    return cameras_of(viewmats, K, (length, length), names="{:03d}")


def _all_around(count: int) -> Float[Tensor, "M 3"]:
    """Directions, evenly spread on a spiral of Fibonacci."""
    steps = torch.arange(count).double()
    heights, turns = 1 - (2 * steps + 1) / count, math.pi * (3 - math.sqrt(5)) * steps
    widths = (1 - heights.square()).sqrt()
    return torch.stack([widths * turns.cos(), widths * turns.sin(), heights], dim=1)


def find_mesh_surface(
    splats: Splats, photos: Cameras | None, faces: int, name: str
) -> tuple[FusedSurface, float]:
    """The surface of splats that are one object, and the share of it that is left open.

    It is fine enough to be simplified to so many faces.

    Raises:
        StyleSplatError: If there is none, as smoke has none.
    """
    voxels = int(min(max(FINENESS * math.sqrt(faces), VOXELS[0]), VOXELS[1]))
    views = mesh_views(splats, photos, length=max(FUSION_SMALLEST, FUSION_PIXELS * voxels))
    surface = keep_large_components(fuse_depths(splats, views, voxels, name), is_closed=True)
    is_seen = (surface.seen[surface.faces] > LEAST_SEEN).any(axis=1)
    areas = face_areas(surface.vertices, surface.faces)
    hidden = 1 - float(areas[is_seen].sum() / areas.sum())
    if hidden < OPEN:
        return surface, 0.0
    return keep_large_components(
        replace(surface, faces=surface.faces[is_seen]), is_closed=False
    ), hidden


def fuse_depths(splats: Splats, views: MeshViews, voxels: int, name: str) -> FusedSurface:
    """The closed surface with all its parts."""
    from skimage.measure import marching_cubes

    extent = extent_of(splats, torch.ones(len(splats), dtype=torch.bool))
    alone, side = geometry_only(splats), float(extent.size.max())
    voxel = side / voxels
    margin = 2 * TRUNCATION * voxel
    low = (extent.low - margin).numpy()
    shape = tuple(((extent.size + 2 * margin) / voxel).ceil().int().tolist())
    values, weights, support = np.zeros((3, *shape), np.float32)

    def look(row: int) -> tuple[int, Tensor, np.ndarray, np.ndarray, int, int]:
        camera, trusted = views.cameras[row], bool(views.trusted[row])
        found = near_side_depth_map(alone, camera, side)
        shown = (found.coverage >= (COVERED if trusted else EMPTY)).numpy()
        inside = np.asarray(distance_transform_edt(shown), np.float32) - 0.5
        outside = np.asarray(distance_transform_edt(~shown), np.float32) - 0.5
        edges = np.where(shown, inside if trusted else 0, -outside)
        certain = trusted & (found.cosines > FUSION_LEAST_COSINE)
        cosines = torch.where(certain, found.cosines, 0.0).numpy()
        visible, solid = (int((found.coverage > least).sum()) for least in (MESH_FAINT, COVERED))
        return row, found.depths, cosines, edges, visible, solid

    every = [*per_view(look, range(len(views.cameras)), "looking for the surface")]
    shown, solid = (sum(each[place] for each in every) for place in (4, 5))
    if solid < SOLID * shown:
        raise StyleSplatError(
            f"{name} has no surface to make a mesh of: one can see through {1 - solid / shown:.0%} "
            "of it. Export its splats."
        )
    for row, depth, cosines, edges, *_ in track(every, "fusing depths"):
        camera = views.cameras[row]
        matrix = projection_of(camera)
        near = max(voxel, FUSION_NEAR * side)
        place = low, voxel, TRUNCATION * voxel, near, float(camera.Ks[0, 0, 0])
        _fuse(depth.numpy(), cosines, edges, matrix, *place, values, weights, support)
    field = np.where(weights > 0, values / np.maximum(weights, 1e-6), -1).astype(np.float32)
    field = np.pad(gaussian_filter(field, FUSION_SMOOTHING), 1, constant_values=1.0)
    vertices, faces, _, _ = marching_cubes(-field, 0.0, gradient_direction="ascent")
    places = vertices - 1
    points = low + (places + 0.5) * voxel
    seen = map_coordinates(support, places.T, order=1)
    return FusedSurface(points.astype(np.float32), faces.astype(np.int32), seen)


@no_type_check
@kernel
def _fuse(
    depth, cosines, edges, matrix, low, voxel, truncation, near, focal, values, weights, support
):
    """Add to sums what a view shows.

    `edges` are pixels to the outline, below 0 outside: near it voxels count by their distance from
    it, on both sides alike.
    """
    height, width = depth.shape
    for i in prange(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                x = low[0] + (i + 0.5) * voxel
                y = low[1] + (j + 0.5) * voxel
                z = low[2] + (k + 0.5) * voxel
                u, v, w = pixel_of(matrix, x, y, z)
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                px, py = int(u), int(v)
                edge = edges[py, px] * w / (focal * truncation)
                apart, cosine = (depth[py, px] - w) / truncation, cosines[py, px]
                if edge < 0 or (0 < edge < 1 and abs(apart) < 1):
                    values[i, j, k] += min(-edge, 1.0)
                    weights[i, j, k] += 1.0
                distance = apart * cosine
                if edge < 0 or cosine == 0 or distance < -1:
                    continue
                share = cosine * cosine
                values[i, j, k] += share * min(distance, 1.0)
                weights[i, j, k] += share
                if abs(distance) * truncation < near:
                    support[i, j, k] += share


def face_areas(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " F"]:
    """By face."""
    return np.linalg.norm(face_normals(vertices, faces), axis=1) / 2


def face_normals(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3"]:
    """Normals of faces, as long as twice their areas."""
    one, other, third = (vertices[corner] for corner in faces.T)
    return np.cross(other - one, third - one)


def vertex_normals(surface: FusedSurface) -> Float[np.ndarray, "V 3"]:
    """Of length 1: the mean of the faces around, by area."""
    normals = face_normals(surface.vertices, surface.faces)
    sums = np.zeros_like(surface.vertices)
    for corner in surface.faces.T:
        np.add.at(sums, corner, normals)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(lengths > 0, sums / np.maximum(lengths, 1e-20), [0, 0, 1]).astype(np.float32)


def keep_large_components(surface: FusedSurface, *, is_closed: bool) -> FusedSurface:
    """The surface without small parts, and without cavities if it is closed."""
    count = len(surface.vertices)
    ends = np.concatenate([surface.faces[:, :2], surface.faces[:, 1:]]).T
    graph = coo_array((np.ones(ends.shape[1], np.int8), (ends[0], ends[1])), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    owner, first = part[surface.faces[:, 0]], surface.vertices[surface.faces[:, 0]]
    areas = np.bincount(owner, face_areas(surface.vertices, surface.faces))
    kept = areas > FUSION_SPECK * areas.max()
    if is_closed:
        normals = face_normals(surface.vertices, surface.faces)
        kept &= np.bincount(owner, (normals * first).sum(axis=1)) > 0
    return compact(replace(surface, faces=surface.faces[kept[owner]]))


def compact(surface: FusedSurface) -> FusedSurface:
    """The surface without vertices of no face."""
    used, faces = np.unique(surface.faces, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    return FusedSurface(surface.vertices[used], faces, surface.seen[used])


def simplify(surface: FusedSurface, count: int) -> FusedSurface:
    """The surface with at most so many faces; how well it is seen is lost."""
    from fast_simplification import simplify as collapse_edges

    if len(surface.faces) <= count:
        return surface
    points, faces, *_ = collapse_edges(surface.vertices, surface.faces, target_count=count, agg=5)
    points, faces = np.asarray(points, np.float32), np.asarray(faces, np.int32)
    surface = split_nonmanifold_edges(
        compact(FusedSurface(points, faces, np.zeros(len(points), np.float32)))
    )
    near = KDTree(surface.vertices).query_pairs(
        FUSION_SAME * float(np.ptp(points)), output_type="ndarray"
    )
    return separate_coincident_vertices(surface, np.unique(near[:, 1]))


def separate_coincident_vertices(
    surface: FusedSurface, rows: Int[np.ndarray, " L"]
) -> FusedSurface:
    """The surface with some vertices moved into their faces."""
    points = surface.vertices.copy()
    for row in rows:
        around = surface.faces[(surface.faces == row).any(axis=1)]
        points[row] += FUSION_APART * (surface.vertices[around].mean(axis=(0, 1)) - points[row])
    return replace(surface, vertices=points)


def split_nonmanifold_edges(surface: FusedSurface) -> FusedSurface:
    """The surface with two faces at an edge at most: where more touch they are moved apart.

    One end of such an edge becomes several vertices, one for those faces around it that are
    neighbours across other edges.
    """
    while True:
        faces, corners = surface.faces, np.arange(surface.faces.size).reshape(-1, 3)
        ends, owners = (
            np.stack([each, np.roll(each, -1, axis=1)], axis=2).reshape(-1, 2)
            for each in (faces, corners)
        )
        order = ends.argsort(axis=1)
        ends, owners = (np.take_along_axis(each, order, axis=1) for each in (ends, owners))
        edges, edge, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
        pinched = edges[uses > 2]
        if not len(pinched):
            return surface
        loose = np.bincount(pinched.ravel(), minlength=len(surface.vertices))[pinched] == 1
        torn = np.where(loose[:, 0], *pinched.T)[loose.any(axis=1)]
        if not len(torn):
            torn = np.setdiff1d(*pinched.T)
        order = edge.ravel().argsort(kind="stable")
        pairs = owners[order[uses[edge.ravel()[order]] == 2]].reshape(-1, 2, 2)  # across an edge
        kept = np.flatnonzero(~np.isin(faces, torn))
        rows = np.append(pairs[:, 0], kept)
        columns = np.append(pairs[:, 1], faces.size + faces.ravel()[kept])
        size = faces.size + len(surface.vertices)
        graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(size, size))
        _, owner = connected_components(graph, directed=False)
        _, first, apart = np.unique(owner[: faces.size], return_index=True, return_inverse=True)
        origins, apart = faces.ravel()[first], apart.reshape(-1, 3).astype(np.int32)
        surface = FusedSurface(surface.vertices[origins], apart, surface.seen[origins])
        surface = separate_coincident_vertices(surface, np.flatnonzero(np.isin(origins, torn)))
