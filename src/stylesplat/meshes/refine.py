"""Vertices moved to where the views agree: multi-view stereo on the renders of a splat.

A point of the true surface has one colour in all views, but for gloss. The mean depth of soft
Gaussians may lie beside it, and the texture would blur there; fur would be thin along outlines.
All vertices near each other move alike, so that faces rarely cut each other.
"""

from dataclasses import replace
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import prange
from scipy.sparse import csr_array, diags_array

from stylesplat.meshes.rasterize import draw_mesh, facing, interpolated, pixel_of, projection_of
from stylesplat.meshes.surface import FusedSurface, MeshViews, face_normals, vertex_normals
from stylesplat.rendering.kernels.jit import kernel
from stylesplat.rendering.render import render
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import COVERED, geometry_only
from stylesplat.scene.splats import Splats

OFFSETS = (-1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0)  # along the normal, in mean edges
REFINE_STEPS = (1.0, 1.0, 1.0, 0.5)  # of the offsets, in turn
REFINE_PLACES = (4, 1, 1), (1, 4, 1), (1, 1, 4), (2, 2, 2)  # of a face, in sixths of its corners
REFINE_HIDDEN = 0.005  # of the extent: what lies farther behind the depth buffer is hidden
REFINE_LEAST_COSINE = 0.3  # between normal and ray: below it a pixel is too long on the surface
REFINE_OPAQUE = 0.9  # coverage below which a pixel's colour is not the object's alone
REFINE_REACH = 12  # pixels by which an outline may be beside the mesh's
REFINE_RIM = 4  # pixels within which the mesh has to end, for a vertex to be at its outline
LEAST_TURN = 0.7  # cosine between a face before and after
TINY_MOVE = 1e-5  # of the extent: shorter moves are none
STAY = 5e-4  # variance of colours that moving by an edge has to save: plain parts stay
COST_RINGS, SHIFT_RINGS = 4, 5  # edges over which costs, and shifts, are averaged
OUTLINES = 3  # edges over which gaps at outlines, and shifts for them, are averaged
FACING, FEW = 0.3, 0.1  # weights of views that show a vertex from the front, and of no shift


@torch.no_grad()
def refine(surface: FusedSurface, splats: Splats, views: MeshViews) -> FusedSurface:
    """Move vertices along normals, by turns to where views agree about colours and to outlines."""
    shape, rows = geometry_only(splats), views.trusted.nonzero()[0].tolist()

    def look(row: int) -> np.ndarray:
        return (render(shape, views.cameras[row])[1][..., 0] > COVERED).numpy()

    outlines = [*per_view(look, rows, "looking for outlines")]
    for step in REFINE_STEPS:
        surface = _moved(surface, splats, views, step)
        surface = _moved_to_outlines(surface, outlines, views)
    return surface


def _moved(surface: FusedSurface, splats: Splats, views: MeshViews, step: float) -> FusedSurface:
    vertices, faces, normals = surface.vertices, surface.faces, vertex_normals(surface)
    shares = np.array(REFINE_PLACES, np.float32) / 6  # [B, 3]
    points, directions = (
        np.einsum("bk,fkd->bfd", shares, each[faces]).reshape(-1, 3) for each in (vertices, normals)
    )
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edge = float(np.linalg.norm(np.subtract(*vertices[edges.T]), axis=1).mean())
    offsets = edge * step * np.array(OFFSETS)
    found = photo_inconsistency(surface, points, directions, offsets, splats, views)
    corners, samples = np.tile(faces, (len(REFINE_PLACES), 1)), np.arange(len(points))
    to_corners = csr_array(
        (shares.repeat(len(faces), axis=0).ravel(), (corners.ravel(), samples.repeat(3))),
        shape=(len(vertices), len(points)),
    )
    around = neighbor_mean_matrix(edges, len(vertices))
    costs, weights = (to_corners @ each.T for each in found)  # [V, L]
    for _ in range(COST_RINGS):
        costs, weights = around @ costs, around @ weights
    variances = costs / np.maximum(weights, 1e-6) + STAY * np.square(step * np.array(OFFSETS))
    shifts = offsets[variances.argmin(axis=1)]
    shifts[weights.min(axis=1) < 1e-3] = 0
    return _shifted(surface, shifts, around, SHIFT_RINGS)


def _moved_to_outlines(
    surface: FusedSurface, outlines: list[np.ndarray], views: MeshViews
) -> FusedSurface:
    """Vertices at an outline of the mesh moved to the splat's, less if other views show them."""
    vertices, faces, normals = surface.vertices, surface.faces, vertex_normals(surface)
    margin = REFINE_HIDDEN * float(np.ptp(vertices, axis=0).max())
    sums = np.zeros((len(vertices), 3), np.float32)
    for row, shown in zip(views.trusted.nonzero()[0].tolist(), outlines, strict=True):
        camera = views.cameras[row]
        depths = draw_mesh(vertices, faces, camera).depths
        position, focal = camera.positions[0].double().numpy(), float(camera.Ks[0, 0, 0])
        place = projection_of(camera), position, focal
        _add_gaps(vertices, normals, shown, *place, depths, margin, sums)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    around = neighbor_mean_matrix(edges, len(vertices))
    for _ in range(OUTLINES):
        sums = around @ sums
    gaps, counts, others = sums.T
    return _shifted(surface, gaps / (counts + FACING * others + FEW), around, OUTLINES)


def _shifted(
    surface: FusedSurface, shifts: Float[np.ndarray, " V"], around: csr_array, times: int
) -> FusedSurface:
    """Vertices moved along their normals, all averaged so many times with those around."""
    along = vertex_normals(surface).astype(float)
    for _ in range(times):
        shifts, along = around @ shifts, around @ along
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return replace(surface, vertices=limit_face_rotation(surface, shifts[:, None] * along))


def limit_face_rotation(
    surface: FusedSurface, moves: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "V 3"]:
    """The vertices moved; less far where a face would turn by much."""
    before = face_normals(surface.vertices, surface.faces)
    while True:
        vertices = surface.vertices + moves.astype(np.float32)
        after = face_normals(vertices, surface.faces)
        lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        folded = (before * after).sum(axis=1) < LEAST_TURN * lengths
        rows = np.unique(surface.faces[folded])
        if not np.abs(moves[rows]).max(initial=0) > 0:
            return vertices
        moves[rows] *= 0.5
        moves[np.abs(moves) < TINY_MOVE * np.ptp(surface.vertices)] = 0


def neighbor_mean_matrix(edges: np.ndarray, count: int) -> csr_array:
    """The mean of each vertex and those that it has an edge to."""
    rows = np.concatenate([edges[:, 0], edges[:, 1], np.arange(count)])
    columns = np.concatenate([edges[:, 1], edges[:, 0], np.arange(count)])
    links = csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    links.sum_duplicates()
    links.data[:] = 1
    return diags_array(1 / links.sum(axis=1)) @ links


def photo_inconsistency(
    surface: FusedSurface,
    points: Float[np.ndarray, "P 3"],
    directions: Float[np.ndarray, "P 3"],
    offsets: Float[np.ndarray, " L"],
    splats: Splats,
    views: MeshViews,
) -> tuple[Float[np.ndarray, "L P"], Float[np.ndarray, "L P"]]:
    """Weighted squares of colours about their mean over views, and the weights, by offset."""
    sums = np.zeros((len(offsets), len(points), 5), np.float32)
    margin = REFINE_HIDDEN * float(np.ptp(surface.vertices, axis=0).max())

    def look(row: int) -> tuple[int, np.ndarray, np.ndarray]:
        image, covered = render(splats, views.cameras[row])
        depths = draw_mesh(surface.vertices, surface.faces, views.cameras[row]).depths
        return row, torch.cat([image, (covered > REFINE_OPAQUE).float()], dim=2).numpy(), depths

    rows = views.trusted.nonzero()[0].tolist()
    for row, image, depths in per_view(look, rows, "refining the surface"):
        camera = views.cameras[row]
        place = projection_of(camera), camera.positions[0].double().numpy(), depths, margin
        _collect(points, directions, offsets, image, *place, sums)
    weights = sums[..., 3]
    means = np.square(sums[..., :3]).sum(axis=2) / np.maximum(weights, 1e-6)
    return sums[..., 4] - means, weights


@no_type_check
@kernel
def _collect(points, directions, offsets, image, matrix, position, depths, margin, sums):
    """Add to `sums` the colours that an image shows at visible points, weights, and squares."""
    height, width = depths.shape
    for n in prange(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        u, v, w = pixel_of(matrix, x, y, z)
        if not (w > 0 and u >= 0 and v >= 0 and u < width and v < height):
            continue
        cosine = facing(directions, n, position, x, y, z)
        if cosine < REFINE_LEAST_COSINE or depths[int(v), int(u)] < w - margin:
            continue
        for k in range(offsets.shape[0]):
            x = points[n, 0] + offsets[k] * directions[n, 0]
            y = points[n, 1] + offsets[k] * directions[n, 1]
            z = points[n, 2] + offsets[k] * directions[n, 2]
            u, v, w = pixel_of(matrix, x, y, z)
            share, red, green, blue = interpolated(image, depths, -np.inf, u, v, w)
            if share < REFINE_OPAQUE:
                continue
            sums[k, n, 0] += cosine * red
            sums[k, n, 1] += cosine * green
            sums[k, n, 2] += cosine * blue
            sums[k, n, 3] += cosine
            sums[k, n, 4] += cosine * (red * red + green * green + blue * blue)


@no_type_check
@kernel
def _add_gaps(points, normals, shown, matrix, position, focal, depths, margin, sums):
    """Add to `sums` how far the outline lies outside the mesh's, by point, and its weights.

    These are the number of views with the point at the mesh's outline, and cosines of other views.
    """
    height, width = depths.shape
    for n in prange(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        u, v, w = pixel_of(matrix, x, y, z)
        if not (w > 0 and u >= 0 and v >= 0 and u < width and v < height):
            continue
        cosine = facing(normals, n, position, x, y, z)
        if cosine < -REFINE_LEAST_COSINE or depths[int(v), int(u)] < w - margin:
            continue
        if cosine > REFINE_LEAST_COSINE:
            sums[n, 2] += cosine
            continue
        nx, ny, nz = normals[n, 0], normals[n, 1], normals[n, 2]
        pixel = w / focal
        right, down, _ = pixel_of(matrix, x + pixel * nx, y + pixel * ny, z + pixel * nz)
        length = np.sqrt((right - u) ** 2 + (down - v) ** 2)
        right, down = (right - u) / length, (down - v) / length
        gap, ends = 0, False
        for t in range(-REFINE_REACH, REFINE_REACH + 1):
            column, row = int(u + t * right), int(v + t * down)
            if column < 0 or row < 0 or column >= width or row >= height:
                continue
            is_mesh = depths[row, column] < np.inf
            gap += int(shown[row, column]) - int(is_mesh)
            ends |= 0 <= t < REFINE_RIM and not is_mesh
        if ends:
            sums[n, 0] += gap * pixel
            sums[n, 1] += 1
