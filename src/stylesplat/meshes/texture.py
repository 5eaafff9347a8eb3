"""The texture of a mesh: where each face lies in it, and its colours from renders."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numba import prange
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from stylesplat.meshes.rasterize import (
    NOTHING,
    draw_mesh,
    draw_triangles,
    facing,
    interpolated,
    pixel_of,
    projection_of,
)
from stylesplat.meshes.surface import FusedSurface, MeshViews, vertex_normals
from stylesplat.meshes.unwrap import unwrap_faces
from stylesplat.rendering.kernels.jit import kernel
from stylesplat.rendering.render import render
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import TINY_COVERAGE
from stylesplat.scene.splats import Splats

BAKED = (160, 768)  # pixels of the views that give the texture, at least and at most
TEXELS = 3  # along the texture's side, by pixel of a view's
TEXTURE_SOLID = 0.9  # coverage from which a pixel's colour is the object's
THINNED = 4  # one in so many texels is searched for the nearest
TEXTURE_HIDDEN = 0.01  # of the extent: what lies farther behind the depth buffer is hidden
SHARP = 2  # power of the cosine between normal and ray by which a view counts
TEXTURE_LEAST_COSINE = 0.2


@dataclass(frozen=True, eq=False)
class TexturedMesh:
    """A mesh with a texture; vertices lie twice where the texture has a seam."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    uvs: Float[np.ndarray, "V 2"]
    """From 0 to 1, v downwards, as in glTF."""
    faces: Int[np.ndarray, "F 3"]
    texture: Float[np.ndarray, "S S 3"]
    """Colours in 0..1."""


def unwrap(surface: FusedSurface, size: int) -> TexturedMesh:
    """Lay the faces of a surface flat into a texture, which is grey."""
    origins, faces, uvs = unwrap_faces(surface.vertices, surface.faces, size)
    return TexturedMesh(
        vertices=surface.vertices[origins],
        normals=vertex_normals(surface)[origins],
        uvs=uvs,
        faces=faces.astype(np.int32),
        texture=np.full((size, size, 3), 0.5, np.float32),
    )


@dataclass(frozen=True, eq=False)
class Texels:
    """The texels that lie on a face."""

    inside: Bool[np.ndarray, "S S"]
    points: Float[np.ndarray, "T 3"]
    normals: Float[np.ndarray, "T 3"]

    @cached_property
    def rows(self) -> Int[np.ndarray, "S S"]:
        """The row of each texel in the points, or `NOTHING`."""
        rows = np.full(self.inside.shape, NOTHING, np.int32)
        rows[self.inside] = np.arange(len(self.points))
        return rows

    @cached_property
    def nearest(self) -> tuple[np.ndarray, ...]:
        """The row and column of the nearest texel on a face, by texel."""
        places = np.empty((2, *self.inside.shape), np.int32)
        distance_transform_edt(
            ~self.inside, return_distances=False, return_indices=True, indices=places
        )
        return places[0], places[1]


def texels_of(mesh: TexturedMesh) -> Texels:
    """Where the texels lie in the world."""
    size = len(mesh.texture)
    ones = np.ones(len(mesh.uvs), np.float32)
    fragments = draw_triangles(mesh.uvs * size, ones, mesh.faces, (size, size))
    rest = [fragments.of_corners(each, mesh.faces) for each in (mesh.vertices, mesh.normals)]
    return Texels(fragments.faces != NOTHING, *rest)


def baked_length(texture_size: int) -> int:
    """Pixels of the side of views that give a texture of so many pixels a side."""
    return min(max(texture_size // TEXELS, BAKED[0]), BAKED[1])


@torch.no_grad()
def bake(mesh: TexturedMesh, splats: Splats, views: MeshViews) -> TexturedMesh:
    """Colour the texture with the renders of splats that are the object alone."""
    texels = texels_of(mesh)
    margin = TEXTURE_HIDDEN * float(np.ptp(mesh.vertices, axis=0).max())
    sums = np.zeros((2, len(texels.points), 4), np.float32)  # by whether views are trusted

    def look(row: int) -> tuple[int, np.ndarray, np.ndarray]:
        image, covered = render(splats, views.cameras[row])
        solid = (covered > TEXTURE_SOLID).float()
        colors = (image / covered.clamp(min=TINY_COVERAGE)).clamp(0, 1) * solid
        depths = draw_mesh(mesh.vertices, mesh.faces, views.cameras[row]).depths
        return row, torch.cat([colors, solid], dim=2).numpy(), depths

    for row, image, depths in per_view(look, range(len(views.cameras)), "rendering the texture"):
        camera = views.cameras[row]
        matrix = projection_of(camera)
        place = matrix, camera.positions[0].double().numpy(), depths, margin
        _gather(texels.points, texels.normals, image, *place, sums[int(views.trusted[row])])
    guessed, seen = sums
    found = np.where(seen[:, 3:] > 0, seen, guessed)
    colors = found[:, :3] / np.maximum(found[:, 3:], TINY_COVERAGE)
    return _filled(mesh, texels, colors, found[:, 3] > 0)


def _filled(
    mesh: TexturedMesh,
    texels: Texels,
    colors: Float[np.ndarray, "T 3"],
    known: Bool[np.ndarray, " T"],
) -> TexturedMesh:
    """The mesh with colours of texels; those that nobody saw take that of the nearest one."""
    if not known.all() and known.any():
        some = np.flatnonzero(known)[::THINNED]
        _, nearest = KDTree(texels.points[some]).query(texels.points[~known], workers=-1)
        colors[~known] = colors[some[nearest]]
    texture = np.zeros_like(mesh.texture)
    texture[texels.inside] = colors
    return replace(mesh, texture=texture[texels.nearest])


@no_type_check
@kernel
def _gather(points, normals, image, matrix, position, depths, margin, sums):
    """Add to `sums` what an image shows of texels, and its weight."""
    for n in prange(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        u, v, w = pixel_of(matrix, x, y, z)
        cosine = facing(normals, n, position, x, y, z)
        if cosine < TEXTURE_LEAST_COSINE:
            continue
        share, red, green, blue = interpolated(image, depths, w - margin, u, v, w)
        if share < 0.5:
            continue
        factor = cosine**SHARP
        sums[n, 0] += factor * red
        sums[n, 1] += factor * green
        sums[n, 2] += factor * blue
        sums[n, 3] += factor * share
