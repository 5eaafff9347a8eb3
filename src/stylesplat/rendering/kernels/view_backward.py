"""Gradient of the projection by the camera's pose: a sum over all Gaussians in view."""

from typing import no_type_check

import numba
import numpy as np

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.columns import Lanes, read_four, read_three, read_two, span
from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.rendering.kernels.project import dot
from stylesplat.rendering.kernels.project_backward import Ellipse, Gaussian, camera_gradients


@no_type_check
@inner
def add_lanes(sums, index, lanes, value):
    """Add a vector to a row of sums, lane by lane."""
    _, count, mask, buffer = lanes
    vec.store(buffer, 0, vec.select(mask, value, 0))
    for lane in range(count):
        sums[index, lane] += buffer[lane]


@no_type_check
@inner
def add_row(sums, row, lanes, v_p, v_axes, mean, world_axes):
    """Add to the gradient of one row of the matrix: of its rotation, then of its translation."""
    e0, e1, e2 = world_axes
    add_lanes(sums, 4 * row, lanes, v_p * mean[0] + dot(v_axes, e0))
    add_lanes(sums, 4 * row + 1, lanes, v_p * mean[1] + dot(v_axes, e1))
    add_lanes(sums, 4 * row + 2, lanes, v_p * mean[2] + dot(v_axes, e2))
    add_lanes(sums, 4 * row + 3, lanes, v_p)


@no_type_check
@inner
def stretched(row, scale):
    """A row of a rotation matrix whose columns are multiplied by the scales."""
    return row[0] * scale[0], row[1] * scale[1], row[2] * scale[2]


@no_type_check
@kernel
def view_backward(geometry, view, projected, v_projected, sums):
    """Add up the gradient of the first three rows of the world-to-camera matrix.

    Args:
        geometry: As `project_backward` takes it, like all but the last.
        view: The camera.
        projected: What it sees.
        v_projected: The gradients of that.
        sums: Zeros, [T,12,16] in float64: threads and lanes add up apart, since what single
            Gaussians pull cancels to a large part, and the order must not vary.
    """
    means, quats, scales = geometry
    _, conics, _, radii = projected
    v_means2d, v_conics, _, _ = v_projected
    threads = sums.shape[0]
    for thread in numba.prange(threads):
        buffer = np.zeros(4 * vec.LANES, np.float32)
        low, high = span(means.shape[0], thread, threads)
        for first in range(low, high, vec.LANES):
            count = min(vec.LANES, high - first)
            radius, _ = read_two(radii, first, count, buffer)
            gaussian = Gaussian(
                read_three(means, first, count, buffer),
                read_four(quats, first, count, buffer),
                read_three(scales, first, count, buffer),
            )
            conic = read_three(conics, first, count, buffer)
            v_ellipse = Ellipse(
                read_two(v_means2d, first, count, buffer),
                read_three(v_conics, first, count, buffer),
            )
            v_axes, v_p, _, rows = camera_gradients(gaussian, view, conic, v_ellipse)
            mean, scale = gaussian.mean, gaussian.scale
            world_axes = (
                stretched(rows[0], scale),
                stretched(rows[1], scale),
                stretched(rows[2], scale),
            )
            lanes = Lanes(first, count, vec.greater(radius, 0), buffer)
            add_row(sums[thread], 0, lanes, v_p[0], v_axes[0], mean, world_axes)
            add_row(sums[thread], 1, lanes, v_p[1], v_axes[1], mean, world_axes)
            add_row(sums[thread], 2, lanes, v_p[2], v_axes[2], mean, world_axes)
