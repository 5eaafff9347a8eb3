"""Gradients of the projection: from ellipses back to means, quaternions and scales."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from torch import Tensor

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.rendering.kernels.project import (
    camera_axes,
    camera_space,
    combine,
    dot,
    image_axes,
    plus,
    rotation,
    scaled,
    unit_quaternion,
)
from stylesplat.rendering.kernels.rows import (
    Lanes,
    read_four,
    read_three,
    read_two,
    span,
    write_column,
)


class GeometryRows(NamedTuple):
    """What of Gaussians is differentiated here, or the gradients of that."""

    means: Tensor
    quats: Tensor
    scales: Tensor


class Gaussian(NamedTuple):
    """One of them, or rather sixteen: the components are vectors."""

    mean: tuple
    quat: tuple
    scale: tuple


class Ellipse(NamedTuple):
    """What a Gaussian looks like, or the gradients of that; again sixteen."""

    mean2d: tuple
    conic: tuple


@no_type_check
@inner
def covariance_gradient(conic, v_conic):
    """Gradient of the 2D covariance (xx, xy, yy) from that of its inverse: -X V X."""
    a, b, c = conic
    va, vb, vc = v_conic[0], 0.5 * v_conic[1], v_conic[2]
    xx, xy = a * va + b * vb, a * vb + b * vc
    yx, yy = b * va + c * vb, b * vb + c * vc
    return 0 - (xx * a + xy * b), 0 - (xx * b + xy * c), 0 - (yx * b + yy * c)


@no_type_check
@inner
def jacobian_backward(p, K, slopes, v_rows, axes):
    """Gradient of the camera-space mean through the perspective Jacobian."""
    fx, fy, inverse_z = K[0, 0], K[1, 1], 1 / p[2]
    slope_x, slope_y = slopes
    v_a0, v_a1 = v_rows
    v_slope_x = -fx * inverse_z * dot(v_a0, axes[2])
    v_slope_y = -fy * inverse_z * dot(v_a1, axes[2])
    v_z = 0 - (fx * dot(v_a0, axes[0]) + fy * dot(v_a1, axes[1])) * inverse_z * inverse_z
    v_z = v_z - (v_slope_x * slope_x + v_slope_y * slope_y) * inverse_z
    # a clamped slope does not depend on the mean
    v_x = vec.select(vec.equal(slope_x, p[0] * inverse_z), v_slope_x * inverse_z, 0)
    v_y = vec.select(vec.equal(slope_y, p[1] * inverse_z), v_slope_y * inverse_z, 0)
    return v_x, v_y, v_z - v_x * slope_x - v_y * slope_y


@no_type_check
@inner
def rotation_backward(quat, v_rows):
    """Gradient of a unit quaternion from that of the rows of its matrix."""
    w, x, y, z = quat
    d0, d1, d2 = v_rows
    return (
        2 * (z * (d1[0] - d0[1]) + y * (d0[2] - d2[0]) + x * (d2[1] - d1[2])),
        2 * (y * (d0[1] + d1[0]) + z * (d0[2] + d2[0]) + w * (d2[1] - d1[2]))
        - 4 * x * (d1[1] + d2[2]),
        2 * (x * (d0[1] + d1[0]) + z * (d1[2] + d2[1]) + w * (d0[2] - d2[0]))
        - 4 * y * (d0[0] + d2[2]),
        2 * (x * (d0[2] + d2[0]) + y * (d1[2] + d2[1]) + w * (d1[0] - d0[1]))
        - 4 * z * (d0[0] + d1[1]),
    )


@no_type_check
@inner
def axes_backward(v_axes, unit, rows, scale, viewmat):
    """Gradients of scale and quaternion from that of `camera_axes`."""
    w, x, y, z, inverse_norm = unit
    d0, d1, d2 = v_axes
    e0 = combine((viewmat[0, 0], viewmat[1, 0], viewmat[2, 0]), d0, d1, d2)
    e1 = combine((viewmat[0, 1], viewmat[1, 1], viewmat[2, 1]), d0, d1, d2)
    e2 = combine((viewmat[0, 2], viewmat[1, 2], viewmat[2, 2]), d0, d1, d2)
    r0, r1, r2 = rows
    v_scale = (
        e0[0] * r0[0] + e1[0] * r1[0] + e2[0] * r2[0],
        e0[1] * r0[1] + e1[1] * r1[1] + e2[1] * r2[1],
        e0[2] * r0[2] + e1[2] * r1[2] + e2[2] * r2[2],
    )
    sx, sy, sz = scale
    v_rows = (
        (e0[0] * sx, e0[1] * sy, e0[2] * sz),
        (e1[0] * sx, e1[1] * sy, e1[2] * sz),
        (e2[0] * sx, e2[1] * sy, e2[2] * sz),
    )
    v_w, v_x, v_y, v_z = rotation_backward((w, x, y, z), v_rows)
    radial = w * v_w + x * v_x + y * v_y + z * v_z
    v_quat = (
        (v_w - radial * w) * inverse_norm,
        (v_x - radial * x) * inverse_norm,
        (v_y - radial * y) * inverse_norm,
        (v_z - radial * z) * inverse_norm,
    )
    return v_scale, v_quat


@no_type_check
@inner
def camera_gradients(gaussian, view, conic, v_ellipse):
    """Gradients of the rows of `camera_axes` and of the mean in camera coordinates.

    Returns:
        Both, then the unit quaternion and the rows of its rotation matrix.
    """
    viewmat, K, _, _ = view
    p = camera_space(gaussian.mean, viewmat)
    unit = unit_quaternion(gaussian.quat)
    w, x, y, z, _ = unit
    rows = rotation(w, x, y, z)
    axes = camera_axes(rows, gaussian.scale, viewmat)
    a0, a1, slopes = image_axes(axes, p, view)
    g_xx, g_xy, g_yy = covariance_gradient(conic, v_ellipse.conic)
    v_a0 = plus(scaled(a0, 2 * g_xx), scaled(a1, 2 * g_xy))
    v_a1 = plus(scaled(a0, 2 * g_xy), scaled(a1, 2 * g_yy))
    fx, fy, inverse_z = K[0, 0], K[1, 1], 1 / p[2]
    v_axes = (
        scaled(v_a0, fx * inverse_z),
        scaled(v_a1, fy * inverse_z),
        plus(
            scaled(v_a0, -fx * slopes[0] * inverse_z),
            scaled(v_a1, -fy * slopes[1] * inverse_z),
        ),
    )
    v_x, v_y, v_z = jacobian_backward(p, K, slopes, (v_a0, v_a1), axes)
    v_u, v_v = fx * inverse_z * v_ellipse.mean2d[0], fy * inverse_z * v_ellipse.mean2d[1]
    v_z = v_z - (v_u * p[0] + v_v * p[1]) * inverse_z
    return v_axes, (v_x + v_u, v_y + v_v, v_z), unit, rows


@no_type_check
@inner
def gaussian_gradients(gaussian, view, conic, v_ellipse):
    """Gradients of a Gaussian's mean, quaternion and scale."""
    viewmat, _, _, _ = view
    v_axes, v_p, unit, rows = camera_gradients(gaussian, view, conic, v_ellipse)
    v_scale, v_quat = axes_backward(v_axes, unit, rows, gaussian.scale, viewmat)
    v_mean = combine(v_p, viewmat[0], viewmat[1], viewmat[2])
    return Gaussian(v_mean, v_quat, v_scale)


@no_type_check
@kernel
def project_backward(geometry, view, projected, v_projected, out, threads):
    """Fill the gradients of the Gaussians that one camera sees, and 0 for the others.

    Of `v_projected` only means2d and conics count: depths and radii are not differentiated.
    """
    means, quats, scales = geometry
    _, conics, _, radii = projected
    v_means2d, v_conics, _, _ = v_projected
    v_means, v_quats, v_scales = out
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
            v_mean, v_quat, v_scale = gaussian_gradients(gaussian, view, conic, v_ellipse)
            lanes = Lanes(first, count, vec.greater(radius, 0), buffer)
            write_column(v_means, 0, lanes, v_mean[0])
            write_column(v_means, 1, lanes, v_mean[1])
            write_column(v_means, 2, lanes, v_mean[2])
            write_column(v_scales, 0, lanes, v_scale[0])
            write_column(v_scales, 1, lanes, v_scale[1])
            write_column(v_scales, 2, lanes, v_scale[2])
            write_column(v_quats, 0, lanes, v_quat[0])
            write_column(v_quats, 1, lanes, v_quat[1])
            write_column(v_quats, 2, lanes, v_quat[2])
            write_column(v_quats, 3, lanes, v_quat[3])


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
