"""What is a large plane, and what only a slab of something round."""

import numpy as np
import pytest

from stylesplat.selection.surface_graph import find_planes


def patches(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A cap of a sphere of this radius, or a plane, with noisy normals, and a few other patches."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-1, 1, (2, 3000))
    flat = np.isinf(radius)
    z = 0 * x if flat else np.sqrt(radius**2 - x**2 - y**2) - radius
    normals = np.stack([0 * x, 0 * x, 0 * x + 1] if flat else [x, y, z + radius], axis=1)
    normals += 0.1 * np.linalg.norm(normals, axis=1)[:, None] * rng.normal(size=normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.stack([x, y, z + 0.01 * rng.normal(size=3000)], axis=1)
    return points, normals


@pytest.mark.parametrize(("radius", "count"), [(np.inf, 1), (2.0, 0)])
def test_a_slab_of_something_round_is_no_plane(radius: float, count: int):
    points, normals = patches(radius)
    weights = np.ones(len(points))
    planes = find_planes(points, normals, weights, 0.05, np.random.default_rng(0))
    assert len(planes) == count
    for plane in planes:
        assert abs(plane.normal[2]) > 0.99
