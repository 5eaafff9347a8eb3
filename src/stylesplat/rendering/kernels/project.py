"""Projection of Gaussians to ellipses in the image, and its gradients (EWA splatting).

The mathematics is that of `reference.project_gaussians`, for 16 Gaussians at a time: a number is a
`Vec` with one lane per Gaussian, a vector is a tuple of three numbers, a matrix is a tuple of three
rows. The nouns are those of `rendering/reference.py`, with arrays.
"""

from math import log, sqrt
from typing import NamedTuple

import numba
import numpy as np

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.rendering.reference import (
    EPS2D,
    FAR_PLANE,
    FOV_MARGIN,
    MAX_EXTENT,
    MAX_RADIUS,
    MIN_ALPHA,
    NEAR_PLANE,
)


class Gaussian(NamedTuple):
    """One of them, or rather sixteen: the components are vectors."""

    mean: tuple
    quat: tuple
    scale: tuple


class Lanes(NamedTuple):
    """Which rows of the arrays the lanes of a vector are."""

    first: int
    rows: int
    """How many, up to 16."""
    mask: object
    """The lanes that are not 0."""
    buffer: np.ndarray
    """Room for a vector."""


@inner
def span(rows, thread, threads):
    """First row of a thread's share and the one after its last; shares are whole vectors."""
    vectors = -(-rows // vec.LANES)
    low, high = vectors * thread // threads, vectors * (thread + 1) // threads
    return low * vec.LANES, min(high * vec.LANES, rows)


@inner
def read_columns(array, first, count, columns, buffer):
    """Four vectors: the first columns of up to 16 rows; those beyond `columns` mean nothing."""
    for lane in range(count):
        for column in range(columns):
            buffer[column * vec.LANES + lane] = array[first + lane, column]
    x, y = vec.load_vec(buffer, 0), vec.load_vec(buffer, vec.LANES)
    return x, y, vec.load_vec(buffer, 2 * vec.LANES), vec.load_vec(buffer, 3 * vec.LANES)


@inner
def read_gaussian(means, quats, scales, first, count, buffer):
    mean = read_columns(means, first, count, 3, buffer)[:3]
    quat = read_columns(quats, first, count, 4, buffer)
    return Gaussian(mean, quat, read_columns(scales, first, count, 3, buffer)[:3])


@inner
def write_column(array, column, lanes, value):
    first, count, mask, buffer = lanes
    vec.store_vec(buffer, 0, vec.select(mask, value, 0))
    for lane in range(count):
        array[first + lane, column] = buffer[lane]


@inner
def write_three(array, lanes, values):
    """Write the first three columns of up to 16 rows."""
    write_column(array, 0, lanes, values[0])
    write_column(array, 1, lanes, values[1])
    write_column(array, 2, lanes, values[2])


@inner
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def cross_product(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def scaled(a, weight):
    return a[0] * weight, a[1] * weight, a[2] * weight


@inner
def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner
def times(a, b):
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inner
def combine(weights, r0, r1, r2):
    """The sum of three rows, weighted: a row vector times a matrix."""
    pair = plus(scaled(r0, weights[0]), scaled(r1, weights[1]))
    return plus(pair, scaled(r2, weights[2]))


@inner
def rotation(w, x, y, z):
    """Rows of the rotation matrix of a unit quaternion."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@inner
def unit_quaternion(quat):
    """w, x, y, z of norm 1, and the inverse of the norm that they had."""
    w, x, y, z = quat
    inverse = 1 / vec.maximum(vec.sqrt(w * w + x * x + y * y + z * z), 1e-12)
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@inner
def camera_space(mean, viewmat):
    return (
        dot(viewmat[0], mean) + viewmat[0, 3],
        dot(viewmat[1], mean) + viewmat[1, 3],
        dot(viewmat[2], mean) + viewmat[2, 3],
    )


@inner
def camera_axes(rows, scale, viewmat):
    """Rows of the matrix whose columns are a Gaussian's scaled axes in the camera."""
    r0, r1, r2 = rows
    return (
        times(combine(viewmat[0], r0, r1, r2), scale),
        times(combine(viewmat[1], r0, r1, r2), scale),
        times(combine(viewmat[2], r0, r1, r2), scale),
    )


@inner
def clamped_slope(slope, focal, centre, size):
    """The slope at which the Jacobian is taken: held constant far outside the image."""
    margin = FOV_MARGIN * 0.5 * size / focal
    least, most = -(centre / focal + margin), (size - centre) / focal + margin
    return vec.minimum(vec.maximum(slope, least), most)


@inner
def image_axes(gaussian, view):
    """A Gaussian's axes in pixels, two rows: the perspective Jacobian times `camera_axes`.

    Then the slopes in x and y at which the Jacobian was taken; the mean and axes in the camera; the
    unit quaternion and the rows of its rotation matrix.
    """
    viewmat, K, width, height = view
    p = camera_space(gaussian.mean, viewmat)
    unit = unit_quaternion(gaussian.quat)
    w, x, y, z, _ = unit
    rows = rotation(w, x, y, z)
    m0, m1, m2 = camera_axes(rows, gaussian.scale, viewmat)
    fx, fy, inverse_z = K[0, 0], K[1, 1], 1 / p[2]
    slope_x = clamped_slope(p[0] * inverse_z, fx, K[0, 2], width)
    slope_y = clamped_slope(p[1] * inverse_z, fy, K[1, 2], height)
    a0 = plus(scaled(m0, fx * inverse_z), scaled(m2, -fx * slope_x * inverse_z))
    a1 = plus(scaled(m1, fy * inverse_z), scaled(m2, -fy * slope_y * inverse_z))
    return a0, a1, (slope_x, slope_y), p, (m0, m1, m2), unit, rows


@inner
def determinants(a0, a1):
    """That of the covariance of an ellipse with these axes, and what the low-pass filter adds."""
    area = cross_product(a0, a1)
    # |a0 x a1|^2: positive by construction where xx yy - xy xy cancels
    cov_xx, cov_yy = dot(a0, a0) + EPS2D, dot(a1, a1) + EPS2D
    return dot(area, area), EPS2D * (cov_xx + cov_yy - EPS2D)


@inner
def compensation(a0, a1):
    """The factor of antialiased opacities: the root of the share of area that was there before."""
    sharp, added = determinants(a0, a1)
    return 1 / vec.sqrt(1 + added / sharp)  # right for 0 and infinity, too


@inner
def ellipse(a0, a1):
    """The standard deviations in x and y of an ellipse with these axes, and its conic."""
    cov_xx, cov_xy, cov_yy = dot(a0, a0) + EPS2D, dot(a0, a1), dot(a1, a1) + EPS2D
    sharp, added = determinants(a0, a1)
    det = sharp + added
    return vec.sqrt(cov_xx), vec.sqrt(cov_yy), (cov_yy / det, 0 - cov_xy / det, cov_xx / det)


@inner
def read_numbers(array, first, count, buffer):
    """The numbers of up to 16 rows."""
    for lane in range(count):
        buffer[lane] = array[first + lane]
    return vec.load_vec(buffer, 0)


@inner
def visible_extents(opacity, count, buffer):
    """How many standard deviations out 16 Gaussians are visible; negative for faint ones."""
    vec.store_vec(buffer, 0, opacity)
    for lane in range(count):
        fade = 2 * log(max(buffer[lane], 1e-30) / MIN_ALPHA)
        buffer[lane] = min(MAX_EXTENT, sqrt(fade)) if fade >= 0 else -1
    return vec.load_vec(buffer, 0)


@inner
def between(low, value, high):
    return vec.both(vec.greater(value, low), vec.greater(high, value))


@kernel
def project_forward(gaussians, view, out, threads):
    """Fill `out` with what one camera sees: 0 for Gaussians that it does not.

    Depths are [N,1] there, and opacities, which are filled for antialiased Gaussians only.
    """
    means, quats, scales, opacities, antialiased = gaussians
    means2d, conics, out_opacities, depths, radii = out
    _, K, width, height = view
    for thread in numba.prange(threads):
        buffer = np.zeros(4 * vec.LANES, np.float32)
        low, high = span(means.shape[0], thread, threads)
        for first in range(low, high, vec.LANES):
            count = min(vec.LANES, high - first)
            gaussian = read_gaussian(means, quats, scales, first, count, buffer)
            a0, a1, _, p, _, _, _ = image_axes(gaussian, view)
            sigma_x, sigma_y, conic = ellipse(a0, a1)
            u = K[0, 0] * p[0] / p[2] + K[0, 2]
            v = K[1, 1] * p[1] / p[2] + K[1, 2]
            opacity = read_numbers(opacities, first, count, buffer)
            if antialiased:
                opacity = opacity * compensation(a0, a1)
            extent = visible_extents(opacity, count, buffer)
            radius_x = vec.minimum(vec.ceil(extent * sigma_x), MAX_RADIUS)
            radius_y = vec.minimum(vec.ceil(extent * sigma_y), MAX_RADIUS)
            inside = vec.both(
                between(0 - radius_x, u, width + radius_x),
                between(0 - radius_y, v, height + radius_y),
            )
            deep = between(NEAR_PLANE, p[2], FAR_PLANE)
            visible = vec.both(vec.both(inside, deep), vec.greater_equal(extent, 0))
            lanes = Lanes(first, count, visible, buffer)
            write_column(means2d, 0, lanes, u)
            write_column(means2d, 1, lanes, v)
            write_three(conics, lanes, conic)
            if antialiased:
                write_column(out_opacities, 0, lanes, opacity)
            write_column(depths, 0, lanes, p[2])
            write_column(radii, 0, lanes, radius_x)
            write_column(radii, 1, lanes, radius_y)


@inner
def covariance_gradient(conic, v_conic):
    """Gradient of the 2D covariance (xx, xy, yy) from that of its inverse: -X V X."""
    a, b, c = conic
    va, vb, vc = v_conic[0], 0.5 * v_conic[1], v_conic[2]
    xx, xy = a * va + b * vb, a * vb + b * vc
    yx, yy = b * va + c * vb, b * vb + c * vc
    return 0 - (xx * a + xy * b), 0 - (xx * b + xy * c), 0 - (yx * b + yy * c)


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


@inner
def axes_backward(v_axes, unit, rows, scale, viewmat):
    """Gradients of scale and quaternion from that of `camera_axes`."""
    w, x, y, z, inverse_norm = unit
    d0, d1, d2 = v_axes
    e0 = combine((viewmat[0, 0], viewmat[1, 0], viewmat[2, 0]), d0, d1, d2)
    e1 = combine((viewmat[0, 1], viewmat[1, 1], viewmat[2, 1]), d0, d1, d2)
    e2 = combine((viewmat[0, 2], viewmat[1, 2], viewmat[2, 2]), d0, d1, d2)
    r0, r1, r2 = rows
    v_scale = plus(plus(times(e0, r0), times(e1, r1)), times(e2, r2))
    v_rows = times(e0, scale), times(e1, scale), times(e2, scale)
    v_w, v_x, v_y, v_z = rotation_backward((w, x, y, z), v_rows)
    radial = w * v_w + x * v_x + y * v_y + z * v_z
    v_quat = (
        (v_w - radial * w) * inverse_norm,
        (v_x - radial * x) * inverse_norm,
        (v_y - radial * y) * inverse_norm,
        (v_z - radial * z) * inverse_norm,
    )
    return v_scale, v_quat


@inner
def compensation_gradient(a0, a1, conic, v_compensation):
    """Gradient of the 2D covariance (xx, xy, yy) from that of the factor of its opacity."""
    sharp, added = determinants(a0, a1)
    det = sharp + added
    lost = added / det  # of the area's square, by the low-pass filter
    v_square = 0.5 * v_compensation / compensation(a0, a1)
    own = EPS2D / det
    return (
        v_square * (lost * conic[0] - own),
        v_square * lost * conic[1],
        v_square * (lost * conic[2] - own),
    )


@inner
def camera_gradients(image, K, v_covar, v_mean2d):
    """Gradients of `camera_axes` and of the mean in the camera; `image` is from `image_axes`."""
    a0, a1, slopes, p, axes, _, _ = image
    g_xx, g_xy, g_yy = v_covar
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
    v_u, v_v = fx * inverse_z * v_mean2d[0], fy * inverse_z * v_mean2d[1]
    v_z = v_z - (v_u * p[0] + v_v * p[1]) * inverse_z
    return v_axes, (v_x + v_u, v_y + v_v, v_z)


@inner
def add_view_gradient(sums, row, lanes, v_p, v_axes, mean, world_axes):
    """Add to the gradient of one row of the world-to-camera matrix, lane by lane."""
    _, count, mask, buffer = lanes
    for column in range(4):
        value = v_p
        if column < 3:
            value = v_p * mean[column] + dot(v_axes, world_axes[column])
        vec.store_vec(buffer, 0, vec.select(mask, value, 0))
        for lane in range(count):
            sums[4 * row + column, lane] += buffer[lane]


@kernel
def project_backward(gaussians, view, projected, v_projected, out, v_view):
    """Fill the gradients of the Gaussians that one camera sees, and 0 for the others.

    Depths and radii are not differentiated; opacities, [N,1] in `out`, of antialiased ones only.

    `v_view` [threads, 12, 16] holds float64 zeros. It takes the gradient of the first three rows of
    the world-to-camera matrix, unless it is [threads, 0, 16]. Threads and lanes add up apart: what
    single Gaussians add cancels to a large part, and the order of the sums must not vary.
    """
    means, quats, scales, opacities, antialiased = gaussians
    _, conics, _, _, radii = projected
    v_means2d, v_conics, v_projected_opacities, _, _ = v_projected
    v_means, v_quats, v_scales, v_opacities, _ = out
    viewmat, K, _, _ = view
    threads = v_view.shape[0]
    for thread in numba.prange(threads):
        buffer = np.zeros(4 * vec.LANES, np.float32)
        low, high = span(means.shape[0], thread, threads)
        for first in range(low, high, vec.LANES):
            count = min(vec.LANES, high - first)
            radius = read_columns(radii, first, count, 1, buffer)[0]
            lanes = Lanes(first, count, vec.greater(radius, 0), buffer)
            gaussian = read_gaussian(means, quats, scales, first, count, buffer)
            conic = read_columns(conics, first, count, 3, buffer)[:3]
            v_mean2d = read_columns(v_means2d, first, count, 2, buffer)[:2]
            v_conic = read_columns(v_conics, first, count, 3, buffer)[:3]
            image = image_axes(gaussian, view)
            a0, a1, _, _, _, unit, rows = image
            v_covar = covariance_gradient(conic, v_conic)
            if antialiased:
                v_opacity = read_numbers(v_projected_opacities, first, count, buffer)
                write_column(v_opacities, 0, lanes, v_opacity * compensation(a0, a1))
                v_factor = v_opacity * read_numbers(opacities, first, count, buffer)
                v_covar = plus(v_covar, compensation_gradient(a0, a1, conic, v_factor))
            v_axes, v_p = camera_gradients(image, K, v_covar, v_mean2d)
            v_scale, v_quat = axes_backward(v_axes, unit, rows, gaussian.scale, viewmat)
            v_mean = combine(v_p, viewmat[0], viewmat[1], viewmat[2])
            write_three(v_means, lanes, v_mean)
            write_three(v_scales, lanes, v_scale)
            write_three(v_quats, lanes, v_quat)
            write_column(v_quats, 3, lanes, v_quat[3])
            if v_view.shape[1] > 0:
                mean, scale = gaussian.mean, gaussian.scale
                world = times(rows[0], scale), times(rows[1], scale), times(rows[2], scale)
                add_view_gradient(v_view[thread], 0, lanes, v_p[0], v_axes[0], mean, world)
                add_view_gradient(v_view[thread], 1, lanes, v_p[1], v_axes[1], mean, world)
                add_view_gradient(v_view[thread], 2, lanes, v_p[2], v_axes[2], mean, world)
