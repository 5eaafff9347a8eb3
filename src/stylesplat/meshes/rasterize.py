"""Triangles drawn with a depth buffer: which face a pixel shows, and where on it."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import get_num_threads, prange

from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.scene.cameras import Cameras

MESH_NEAR = 1e-6  # depth in front of which nothing is drawn
NOTHING = -1  # the face of a pixel that shows none


class Fragments(NamedTuple):
    """What the pixels of one image show of a mesh."""

    faces: Int[np.ndarray, "H W"]
    """Their faces, or `NOTHING`."""
    weights: Float[np.ndarray, "H W 3"]
    """Of the face's corners: what varies over a face is their weighted sum."""
    depths: Float[np.ndarray, "H W"]
    """Infinite where nothing is."""

    def of_corners(
        self, values: Float[np.ndarray, "V D"], faces: Int[np.ndarray, "F 3"]
    ) -> Float[np.ndarray, "P D"]:
        """Values of vertices at the pixels that show a face, in order."""
        shown = self.faces != NOTHING
        corners = values[faces[self.faces[shown]]]  # [P, 3, D]
        return np.einsum("pkd,pk->pd", corners, self.weights[shown])


def draw_mesh(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], camera: Cameras
) -> Fragments:
    """A mesh as one camera shows it, from both sides."""
    viewmat, K = camera.viewmats[0].double().numpy(), camera.Ks[0].double().numpy()
    points_c = vertices @ viewmat[:3, :3].T + viewmat[:3, 3]
    depths = np.maximum(points_c[:, 2], MESH_NEAR / 2)
    places = (points_c @ K.T)[:, :2] / depths[:, None]
    return draw_triangles(places, depths, faces, camera.size)


def draw_triangles(
    places: Float[np.ndarray, "V 2"],
    depths: Float[np.ndarray, " V"],
    faces: Int[np.ndarray, "F 3"],
    size: tuple[int, int],
) -> Fragments:
    """Triangles between pixels, in an image of a width and height."""
    width, height = size
    fragments = Fragments(
        np.full((height, width), NOTHING, np.int32),
        np.zeros((height, width, 3), np.float32),
        np.full((height, width), np.inf, np.float32),
    )
    corners = np.concatenate([places, depths[:, None]], axis=1).astype(np.float32)
    _draw(corners, faces, fragments.faces, fragments.weights, fragments.depths, get_num_threads())
    return fragments


@no_type_check
@kernel
def _draw(corners, faces, shown, weights, depths, bands):
    height, width = shown.shape
    for band in prange(bands):
        top, bottom = height * band // bands, height * (band + 1) // bands
        for face in range(faces.shape[0]):
            a, b, c = corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
            if min(a[2], b[2], c[2]) < MESH_NEAR:
                continue
            first = max(top, int(np.ceil(min(a[1], b[1], c[1]) - 0.5)))
            last = min(bottom - 1, int(np.floor(max(a[1], b[1], c[1]) - 0.5)))
            left = max(0, int(np.ceil(min(a[0], b[0], c[0]) - 0.5)))
            right = min(width - 1, int(np.floor(max(a[0], b[0], c[0]) - 0.5)))
            area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            if area == 0 or first > last or left > right:
                continue
            for row in range(first, last + 1):
                y = row + 0.5
                for column in range(left, right + 1):
                    x = column + 0.5
                    p = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
                    q = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
                    r = 1 - p - q
                    if p < 0 or q < 0 or r < 0:
                        continue
                    p, q, r = p / a[2], q / b[2], r / c[2]
                    depth = 1 / (p + q + r)
                    if depth < depths[row, column]:
                        depths[row, column] = depth
                        shown[row, column] = face
                        weights[row, column, 0] = p * depth
                        weights[row, column, 1] = q * depth
                        weights[row, column, 2] = r * depth


def projection_of(camera: Cameras) -> Float[np.ndarray, "3 4"]:
    """The matrix of one camera that `pixel_of` takes."""
    return (camera.Ks[0] @ camera.viewmats[0, :3]).double().numpy()


@no_type_check
@inner
def pixel_of(matrix, x, y, z):
    """Where a point lies in an image, and its depth; pixel centres lie at +0.5."""
    w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
    u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / w
    v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / w
    return u, v, w


@no_type_check
@inner
def facing(normals, n, position, x, y, z):
    """The cosine between a normal and the ray from its point to a camera."""
    dx, dy, dz = position[0] - x, position[1] - y, position[2] - z
    along = dx * normals[n, 0] + dy * normals[n, 1] + dz * normals[n, 2]
    return along / np.sqrt(dx * dx + dy * dy + dz * dz)


@no_type_check
@inner
def interpolated(image, depths, least, u, v, w):
    """The last channel and the three others of an image between pixels, of those of more depth.

    All are 0 at places outside the image.
    """
    height, width = depths.shape
    u, v = u - 0.5, v - 0.5
    share, red, green, blue = 0.0, 0.0, 0.0, 0.0
    if w > 0 and u >= 0 and v >= 0 and u < width - 1 and v < height - 1:
        column, row = int(u), int(v)
        right, down = u - column, v - row
        for i in range(2):
            for j in range(2):
                if depths[row + i, column + j] > least:
                    part = (down if i == 1 else 1 - down) * (right if j == 1 else 1 - right)
                    share += part * image[row + i, column + j, 3]
                    red += part * image[row + i, column + j, 0]
                    green += part * image[row + i, column + j, 1]
                    blue += part * image[row + i, column + j, 2]
    return share, red, green, blue
