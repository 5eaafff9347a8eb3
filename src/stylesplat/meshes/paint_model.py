"""Somebody's mesh, painted: its surface as discs, their paint, and that in a texture of its own.

The discs are painted as any splat is, and `bake` and `repaint` bring the paint into the texture. A
part keeps its UVs if each place of the texture is one place of its surface; else new ones are made.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.models.model import PaintedPart, Part, Unwrapped, base_colors
from stylesplat.io.splats.gltf import HALF_TURN
from stylesplat.meshes.rasterize import NOTHING, draw_triangles
from stylesplat.meshes.repaint import repaint
from stylesplat.meshes.surface import face_areas, face_normals, mesh_views
from stylesplat.meshes.texture import TexturedMesh, bake, baked_length
from stylesplat.meshes.unwrap import unwrap_faces
from stylesplat.rendering.surface import poisson_disk_sample
from stylesplat.scene.layers import Layer
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.stylization.canvas import discs_at
from stylesplat.stylization.style import Style

DISCS = 80_000  # on the surface that is painted, at most
TEXELS_OF_DISC = 8  # at least
DISCS_PACKED = (
    0.7  # of random discs that are as dense as can be: their number times distance^2 over area
)
CANDIDATES = 5  # points by disc, from which discs are chosen
SOLID_DISC = 0.99  # opacity
SEVERAL = 2  # times the side of one texture has the square that holds several
UV_CHECK_LENGTH = 512  # pixels of the side of the texture in which overlaps of UVs are looked for
UV_ROUNDING = 1e-4  # of UVs at the texture's border
UV_OVERLAP = 1.1  # times the area that is covered: less is rounding


@dataclass(frozen=True, eq=False)
class Layout:
    """Where parts lie in one texture, which has a square tile for each picture."""

    mesh: TexturedMesh
    parts: list[PaintedPart]
    tiles: int
    """Along a side."""

    def after(self, count: int) -> list[PaintedPart]:
        """The parts, whose pictures follow so many others."""
        return [replace(each, picture=each.picture + count) for each in self.parts]

    def pictures(self, texture: Float[np.ndarray, "S S 3"]) -> list[UInt8[np.ndarray, "T T 4"]]:
        """The tiles of a texture, with the opacity of what they replace."""
        size, found = len(texture) // self.tiles, []
        for number in range(1 + max(each.picture for each in self.parts)):
            row, column = divmod(number, self.tiles)
            tile = texture[row * size :, column * size :][:size, :size]
            alpha = np.full((size, size, 1), 255, np.uint8)
            before = next(each.part.picture for each in self.parts if each.picture == number)
            kept = all(each.unwrapped is None for each in self.parts if each.picture == number)
            if kept and before is not None and before[..., 3].min() < 255:
                resized = Image.fromarray(before[..., 3]).resize((size, size))
                alpha = np.asarray(resized)[..., None]
            colors = np.rint(tile.clip(0, 1) * 255).astype(np.uint8)
            found.append(np.concatenate([colors, alpha], axis=2))
        return found


def in_unit_ball(parts: Sequence[Part]) -> list[Float[np.ndarray, "_ 3"]]:
    """The vertices of each part, moved and scaled into a unit ball, y down."""
    every = np.concatenate([part.vertices[part.faces.ravel()] for part in parts])
    low, high = every.min(axis=0), every.max(axis=0)
    radius = np.linalg.norm(high - low) / 2
    if not (np.isfinite(radius) and radius > 0):
        raise StyleSplatError("The mesh has no extent, or places that are not finite. Mend it.")
    return [(part.vertices - (low + high) / 2) / radius @ HALF_TURN for part in parts]


def sample_discs(
    parts: Sequence[Part],
    vertices: Sequence[Float[np.ndarray, "_ 3"]],
    *,
    texture_size: int,
    seed: int,
) -> Splats:
    """Discs evenly spread over the surface of parts, in its base colours."""
    discs = min(DISCS, texture_size**2 // TEXELS_OF_DISC)
    random = np.random.default_rng(seed)
    areas = [face_areas(v, part.faces) for v, part in zip(vertices, parts, strict=True)]
    total = sum(float(each.sum()) for each in areas)
    found = []
    for part, own, each in zip(parts, vertices, areas, strict=True):
        count = round(CANDIDATES * discs * float(each.sum()) / total)
        if not count:
            continue
        faces = random.choice(len(each), count, p=each / each.sum())
        root, along = np.sqrt(random.random(count)), random.random(count)
        weights = np.stack([1 - root, root * (1 - along), root * along], axis=1)
        rows = part.faces[faces]
        points = np.einsum("mkd,mk->md", own[rows], weights)
        found.append((points, face_normals(own, rows), base_colors(part, faces, weights)))
    points, normals, colors = (
        torch.from_numpy(np.concatenate(each)).float() for each in zip(*found, strict=True)
    )
    spacing = math.sqrt(DISCS_PACKED * total / discs)
    rows = poisson_disk_sample(points, spacing, seed=seed)
    sh0, count = sh0_from_rgb(colors[rows])[:, None], len(rows)
    blank = Splats(
        means=points[rows],
        quats=torch.zeros(count, 4),
        scales=torch.zeros(count, 3),
        opacities=torch.zeros(count),
        sh0=sh0,
        shN=torch.zeros(count, 0, 3),
    )
    facing = torch.nn.functional.normalize(normals[rows], dim=1)
    opacities = torch.full((count,), SOLID_DISC)
    return discs_at(blank, points[rows], facing, spacing, opacities)


def lay_out(
    parts: Sequence[Part], vertices: Sequence[Float[np.ndarray, "_ 3"]], texture_size: int
) -> Layout:
    """Give each part its place in one texture, which is grey."""
    kept, anew = _textures(parts)
    tiles = math.ceil(math.sqrt(len(kept) + bool(anew)))
    size = texture_size * (SEVERAL if tiles > 1 else 1)
    number_of = {row: number for number, rows in enumerate(kept) for row in rows}
    found = {row: _shifted(parts[row]) for row in number_of}
    painted = {row: PaintedPart(parts[row], number_of[row], None) for row in number_of}
    for row, each in zip(anew, _unwrap(parts, vertices, anew, size // tiles), strict=True):
        number_of[row], found[row] = len(kept), each.uvs
        painted[row] = PaintedPart(parts[row], len(kept), each)
    points, normals, uvs, faces, count = [], [], [], [], 0
    for row, (part, own) in enumerate(zip(parts, vertices, strict=True)):
        new = painted[row].unwrapped
        rows = np.arange(len(own)) if new is None else new.origins
        points.append(own[rows])
        normals.append(_vertex_normals(own, part.faces)[rows])
        uvs.append((found[row] + np.array(divmod(number_of[row], tiles))[::-1]) / tiles)
        faces.append((part.faces if new is None else new.faces) + count)
        count += len(rows)
    mesh = TexturedMesh(
        *(np.concatenate(each).astype(np.float32) for each in (points, normals, uvs)),
        faces=np.concatenate(faces).astype(np.int32),
        texture=np.full((size, size, 3), 0.5, np.float32),
    )
    return Layout(mesh, [painted[row] for row in range(len(parts))], tiles)


def _textures(parts: Sequence[Part]) -> tuple[list[list[int]], list[int]]:
    """The parts that keep their UVs, by the texture that they share, and those that cannot."""
    groups, kept = dict[object, list[int]](), list[list[int]]()
    anew = [row for row, part in enumerate(parts) if part.uvs is None]
    for row, part in enumerate(parts):
        if part.uvs is not None:
            groups.setdefault(part.texture, []).append(row)
    for rows in groups.values():
        if _is_one_to_one([parts[row] for row in rows]):
            kept.append(rows)
        else:
            anew += rows
    return kept, sorted(anew)


def _unwrap(
    parts: Sequence[Part],
    vertices: Sequence[Float[np.ndarray, "_ 3"]],
    rows: Sequence[int],
    size: int,
) -> Iterator[Unwrapped]:
    """New UVs for some parts, which share a texture."""
    if not rows:
        return
    if find_spec("xatlas") is None:
        raise StyleSplatError(
            f"{parts[rows[0]].names[-1]} has no UVs of its own, and making them needs xatlas. Run "
            "`pip install 'stylesplat[mesh]'`."
        )
    counts = [len(vertices[row]) for row in rows]
    starts = np.cumsum([0, *counts])
    points = np.concatenate([vertices[row] for row in rows]).astype(np.float32)
    faces = np.concatenate([parts[r].faces + s for r, s in zip(rows, starts, strict=False)])
    origins, faces, uvs = unwrap_faces(points, faces, size)
    first = 0
    for row, start in zip(rows, starts, strict=False):
        own = faces[first : first + len(parts[row].faces)]
        first += len(own)
        used, corners = np.unique(own, return_inverse=True)
        yield Unwrapped(origins[used] - start, corners.reshape(own.shape), uvs[used])


def _shifted(part: Part) -> Float[np.ndarray, "V 2"]:
    """The UVs of a part, moved by whole textures to where they begin above 0."""
    assert part.uvs is not None
    used = part.uvs[part.faces.ravel()]
    return part.uvs - np.floor(used.min(axis=0) + UV_ROUNDING)


def _vertex_normals(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "V 3"]:
    """The normals of the faces around each vertex, by their areas; seams of UVs are no edges."""
    _, same = np.unique(points, axis=0, return_inverse=True)
    sums = np.zeros((same.max() + 1, 3))
    np.add.at(sums, same.ravel()[faces.ravel()], face_normals(points, faces).repeat(3, axis=0))
    found = sums[same.ravel()]
    return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-20)


def _is_one_to_one(parts: Sequence[Part]) -> bool:
    """Whether the UVs of parts fit into the texture, with no place of it used twice."""
    uvs = np.concatenate([_shifted(part) for part in parts])
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=False)])
    if uvs[faces.ravel()].max() > 1 + UV_ROUNDING or not np.isfinite(uvs[faces.ravel()]).all():
        return False
    a, b, c = (uvs[faces[:, corner]] * UV_CHECK_LENGTH for corner in range(3))
    across = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    used, size = np.abs(across).sum() / 2, (UV_CHECK_LENGTH, UV_CHECK_LENGTH)
    depths = np.ones(len(uvs), np.float32)
    drawn = draw_triangles(
        uvs.astype(np.float32) * UV_CHECK_LENGTH, depths, faces.astype(np.int32), size
    )
    return bool(0 < used < UV_OVERLAP * (drawn.faces != NOTHING).sum())


@torch.no_grad()
def paint_texture(
    layout: Layout, before: Splats, after: Splats, layer: Layer, style: Style, name: str
) -> Float[np.ndarray, "S S 3"]:
    """The texture in the colours of painted discs, painted on in it unless it is a draft."""
    views = mesh_views(before, None, length=baked_length(len(layout.mesh.texture)))
    mesh = bake(layout.mesh, after, views)
    if style.config.quality == "draft":
        return mesh.texture
    return repaint(mesh, before, views, layer, name, style=style).texture
