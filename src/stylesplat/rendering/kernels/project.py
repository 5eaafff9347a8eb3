"""Projection of Gaussians to ellipses in the image, and its gradients (EWA splatting).

The mathematics is `reference.project`'s, one Gaussian at a time. Vectors are tuples of three
numbers and matrices tuples of three rows.
"""

from math import ceil, log, sqrt
from typing import no_type_check

import numba

from stylesplat.rendering import constants as const


@no_type_check
@numba.njit(cache=True)
def dot(a, b):
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@no_type_check
@numba.njit(cache=True)
def combine(weights, r0, r1, r2):
    """The sum of three rows, weighted: a row vector times a matrix."""
    a, b, c = weights[0], weights[1], weights[2]
    return (
        a * r0[0] + b * r1[0] + c * r2[0],
        a * r0[1] + b * r1[1] + c * r2[1],
        a * r0[2] + b * r1[2] + c * r2[2],
    )


@no_type_check
@numba.njit(cache=True)
def rotation(w, x, y, z):
    """Rows of the rotation matrix of a unit quaternion."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@no_type_check
@numba.njit(cache=True)
def rotation_backward(w, x, y, z, d0, d1, d2):
    """Gradient of a unit quaternion from that of the rows of its matrix."""
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
@numba.njit(cache=True)
def unit_quaternion(quat):
    """w, x, y, z of norm 1, and the inverse of the norm that they had."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    inverse = 1 / max(sqrt(w * w + x * x + y * y + z * z), 1e-12)
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@no_type_check
@numba.njit(cache=True)
def camera_space(mean, viewmat):
    """A world point in camera coordinates."""
    return (
        dot(viewmat[0], mean) + viewmat[0, 3],
        dot(viewmat[1], mean) + viewmat[1, 3],
        dot(viewmat[2], mean) + viewmat[2, 3],
    )


@no_type_check
@numba.njit(cache=True)
def camera_axes(rows, scale, viewmat):
    """Rows of the matrix whose columns are a Gaussian's scaled axes in the camera."""
    r0, r1, r2 = rows
    sx, sy, sz = scale[0], scale[1], scale[2]
    m0, m1, m2 = (
        combine(viewmat[0], r0, r1, r2),
        combine(viewmat[1], r0, r1, r2),
        combine(viewmat[2], r0, r1, r2),
    )
    return (
        (m0[0] * sx, m0[1] * sy, m0[2] * sz),
        (m1[0] * sx, m1[1] * sy, m1[2] * sz),
        (m2[0] * sx, m2[1] * sy, m2[2] * sz),
    )


@no_type_check
@numba.njit(cache=True)
def clamped_slope(slope, focal, centre, size):
    """The slope at which the Jacobian is taken: held constant far outside the image."""
    margin = const.FOV_MARGIN * 0.5 * size / focal
    return min(max(slope, -(centre / focal + margin)), (size - centre) / focal + margin)


@no_type_check
@numba.njit(cache=True)
def image_axes(axes, p, K, width, height):
    """A Gaussian's axes in pixels: the perspective Jacobian times `camera_axes`."""
    m0, m1, m2 = axes
    zero = (0.0, 0.0, 0.0)
    fx, fy, inverse_z = K[0, 0], K[1, 1], 1 / p[2]
    slope_x = clamped_slope(p[0] * inverse_z, fx, K[0, 2], width)
    slope_y = clamped_slope(p[1] * inverse_z, fy, K[1, 2], height)
    a0 = combine((fx * inverse_z, -fx * slope_x * inverse_z, 0.0), m0, m2, zero)
    a1 = combine((fy * inverse_z, -fy * slope_y * inverse_z, 0.0), m1, m2, zero)
    return a0, a1, slope_x, slope_y


@no_type_check
@numba.njit(cache=True, parallel=True)
def project(
    means, quats, scales, opacities, viewmat, K, width, height, means2d, conics, depths, radii
):
    """Fill the last four arrays for one camera; `radii` stay 0 for what it does not see."""
    for i in numba.prange(means.shape[0]):
        p = camera_space(means[i], viewmat)
        depths[i] = p[2]
        opacity = opacities[i]
        if not const.NEAR_PLANE < p[2] < const.FAR_PLANE or opacity < const.MIN_ALPHA:
            continue
        w, x, y, z, _ = unit_quaternion(quats[i])
        axes = camera_axes(rotation(w, x, y, z), scales[i], viewmat)
        a0, a1, _, _ = image_axes(axes, p, K, width, height)
        cov_xx = dot(a0, a0) + const.EPS2D
        cov_xy = dot(a0, a1)
        cov_yy = dot(a1, a1) + const.EPS2D
        # |a0 x a1|^2 + ...: positive by construction where xx yy - xy xy cancels
        cross = (
            a0[1] * a1[2] - a0[2] * a1[1],
            a0[2] * a1[0] - a0[0] * a1[2],
            a0[0] * a1[1] - a0[1] * a1[0],
        )
        det = dot(cross, cross) + const.EPS2D * (cov_xx + cov_yy - const.EPS2D)
        u = K[0, 0] * p[0] / p[2] + K[0, 2]
        v = K[1, 1] * p[1] / p[2] + K[1, 2]
        fade = 2 * log(opacity / const.MIN_ALPHA)
        extent = min(const.MAX_EXTENT, sqrt(max(fade, 0.0)))
        radius_x, radius_y = ceil(extent * sqrt(cov_xx)), ceil(extent * sqrt(cov_yy))
        if (
            u + radius_x <= 0
            or u - radius_x >= width
            or v + radius_y <= 0
            or v - radius_y >= height
        ):
            continue
        means2d[i, 0], means2d[i, 1] = u, v
        conics[i, 0], conics[i, 1], conics[i, 2] = cov_yy / det, -cov_xy / det, cov_xx / det
        radii[i, 0], radii[i, 1] = radius_x, radius_y


@no_type_check
@numba.njit(cache=True)
def covariance_gradient(conic, v_conic):
    """Gradient of the 2D covariance (xx, xy, yy) from that of its inverse: -X V X."""
    a, b, c = conic[0], conic[1], conic[2]
    va, vb, vc = v_conic[0], 0.5 * v_conic[1], v_conic[2]
    xx, xy = a * va + b * vb, a * vb + b * vc
    yx, yy = b * va + c * vb, b * vb + c * vc
    return -(xx * a + xy * b), -(xx * b + xy * c), -(yx * b + yy * c)


@no_type_check
@numba.njit(cache=True)
def jacobian_backward(p, K, slopes, v_rows, axes):
    """Gradient of the camera-space mean through the perspective Jacobian."""
    fx, fy, inverse_z = K[0, 0], K[1, 1], 1 / p[2]
    slope_x, slope_y = slopes
    v_a0, v_a1 = v_rows
    v_slope_x = -fx * inverse_z * dot(v_a0, axes[2])
    v_slope_y = -fy * inverse_z * dot(v_a1, axes[2])
    v_z = -(fx * dot(v_a0, axes[0]) + fy * dot(v_a1, axes[1])) * inverse_z * inverse_z
    v_z -= (v_slope_x * slope_x + v_slope_y * slope_y) * inverse_z
    v_x = v_y = 0.0
    if slope_x == p[0] * inverse_z:  # not clamped
        v_x = v_slope_x * inverse_z
        v_z -= v_slope_x * slope_x * inverse_z
    if slope_y == p[1] * inverse_z:
        v_y = v_slope_y * inverse_z
        v_z -= v_slope_y * slope_y * inverse_z
    return v_x, v_y, v_z


@no_type_check
@numba.njit(cache=True)
def axes_backward(v_axes, quat, rows, scale, viewmat):
    """Gradients of scale and quaternion from that of `camera_axes`."""
    w, x, y, z, inverse_norm = unit_quaternion(quat)
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
    sx, sy, sz = scale[0], scale[1], scale[2]
    v_unit = rotation_backward(
        w,
        x,
        y,
        z,
        (e0[0] * sx, e0[1] * sy, e0[2] * sz),
        (e1[0] * sx, e1[1] * sy, e1[2] * sz),
        (e2[0] * sx, e2[1] * sy, e2[2] * sz),
    )
    radial = w * v_unit[0] + x * v_unit[1] + y * v_unit[2] + z * v_unit[3]
    v_quat = (
        (v_unit[0] - radial * w) * inverse_norm,
        (v_unit[1] - radial * x) * inverse_norm,
        (v_unit[2] - radial * y) * inverse_norm,
        (v_unit[3] - radial * z) * inverse_norm,
    )
    return v_scale, v_quat


@no_type_check
@numba.njit(cache=True, parallel=True)
def project_backward(
    means,
    quats,
    scales,
    viewmat,
    K,
    width,
    height,
    conics,
    radii,
    v_means2d,
    v_conics,
    v_means,
    v_quats,
    v_scales,
):
    """Fill the gradients of the Gaussians that one camera sees; the others stay 0."""
    zero = (0.0, 0.0, 0.0)
    for i in numba.prange(means.shape[0]):
        if radii[i, 0] == 0:
            continue
        p = camera_space(means[i], viewmat)
        w, x, y, z, _ = unit_quaternion(quats[i])
        rows = rotation(w, x, y, z)
        axes = camera_axes(rows, scales[i], viewmat)
        a0, a1, slope_x, slope_y = image_axes(axes, p, K, width, height)
        g_xx, g_xy, g_yy = covariance_gradient(conics[i], v_conics[i])
        v_a0 = combine((2 * g_xx, 2 * g_xy, 0.0), a0, a1, zero)
        v_a1 = combine((2 * g_xy, 2 * g_yy, 0.0), a0, a1, zero)
        fx, fy, inverse_z = K[0, 0], K[1, 1], 1 / p[2]
        v_axes = (
            combine((fx * inverse_z, 0.0, 0.0), v_a0, zero, zero),
            combine((fy * inverse_z, 0.0, 0.0), v_a1, zero, zero),
            combine((-fx * slope_x * inverse_z, -fy * slope_y * inverse_z, 0.0), v_a0, v_a1, zero),
        )
        v_scale, v_quat = axes_backward(v_axes, quats[i], rows, scales[i], viewmat)
        v_x, v_y, v_z = jacobian_backward(p, K, (slope_x, slope_y), (v_a0, v_a1), axes)
        v_u, v_v = fx * inverse_z * v_means2d[i, 0], fy * inverse_z * v_means2d[i, 1]
        v_z -= (v_u * p[0] + v_v * p[1]) * inverse_z
        v_p = (v_x + v_u, v_y + v_v, v_z)
        v_mean = combine(v_p, viewmat[0], viewmat[1], viewmat[2])
        for k in range(3):
            v_means[i, k] = v_mean[k]
            v_scales[i, k] = v_scale[k]
        for k in range(4):
            v_quats[i, k] = v_quat[k]
