"""Projection of Gaussians to ellipses in the image, and its gradients (EWA splatting).

The mathematics is `reference.project`'s, sixteen Gaussians at a time: a number is a `Vec` with one
lane per Gaussian, a vector a tuple of three numbers, a matrix a tuple of three rows. The nouns are
those of `rendering/gaussians.py`, with arrays.
"""

from math import log, sqrt
from typing import no_type_check

import numba
import numpy as np

from stylesplat.rendering import constants as const
from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.rendering.kernels.rows import Lanes, read_four, read_three, span, write_column


@no_type_check
@inner
def dot(a, b):
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@no_type_check
@inner
def cross_product(a, b):
    """The vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@no_type_check
@inner
def scaled(a, weight):
    """A vector times a number."""
    return a[0] * weight, a[1] * weight, a[2] * weight


@no_type_check
@inner
def plus(a, b):
    """The sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@no_type_check
@inner
def combine(weights, r0, r1, r2):
    """The sum of three rows, weighted: a row vector times a matrix."""
    pair = plus(scaled(r0, weights[0]), scaled(r1, weights[1]))
    return plus(pair, scaled(r2, weights[2]))


@no_type_check
@inner
def rotation(w, x, y, z):
    """Rows of the rotation matrix of a unit quaternion."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@no_type_check
@inner
def unit_quaternion(quat):
    """w, x, y, z of norm 1, and the inverse of the norm that they had."""
    w, x, y, z = quat
    inverse = 1 / vec.maximum(vec.sqrt(w * w + x * x + y * y + z * z), 1e-12)
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@no_type_check
@inner
def camera_space(mean, viewmat):
    """A world point in camera coordinates."""
    return (
        dot(viewmat[0], mean) + viewmat[0, 3],
        dot(viewmat[1], mean) + viewmat[1, 3],
        dot(viewmat[2], mean) + viewmat[2, 3],
    )


@no_type_check
@inner
def camera_axes(rows, scale, viewmat):
    """Rows of the matrix whose columns are a Gaussian's scaled axes in the camera."""
    r0, r1, r2 = rows
    sx, sy, sz = scale
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
@inner
def clamped_slope(slope, focal, centre, size):
    """The slope at which the Jacobian is taken: held constant far outside the image."""
    margin = const.FOV_MARGIN * 0.5 * size / focal
    least, most = -(centre / focal + margin), (size - centre) / focal + margin
    return vec.minimum(vec.maximum(slope, least), most)


@no_type_check
@inner
def image_axes(axes, p, view):
    """A Gaussian's axes in pixels: the perspective Jacobian times `camera_axes`.

    Returns:
        The two rows, and the slopes in x and y at which the Jacobian was taken.
    """
    m0, m1, m2 = axes
    _, K, width, height = view
    fx, fy, inverse_z = K[0, 0], K[1, 1], 1 / p[2]
    slope_x = clamped_slope(p[0] * inverse_z, fx, K[0, 2], width)
    slope_y = clamped_slope(p[1] * inverse_z, fy, K[1, 2], height)
    a0 = plus(scaled(m0, fx * inverse_z), scaled(m2, -fx * slope_x * inverse_z))
    a1 = plus(scaled(m1, fy * inverse_z), scaled(m2, -fy * slope_y * inverse_z))
    return a0, a1, (slope_x, slope_y)


@no_type_check
@inner
def ellipse(a0, a1):
    """The standard deviations in x and y of an ellipse with these axes, and its conic."""
    cov_xx, cov_xy, cov_yy = dot(a0, a0) + const.EPS2D, dot(a0, a1), dot(a1, a1) + const.EPS2D
    area = cross_product(a0, a1)
    # |a0 x a1|^2 + ...: positive by construction where xx yy - xy xy cancels
    det = dot(area, area) + const.EPS2D * (cov_xx + cov_yy - const.EPS2D)
    return vec.sqrt(cov_xx), vec.sqrt(cov_yy), (cov_yy / det, 0 - cov_xy / det, cov_xx / det)


@no_type_check
@inner
def read_extents(opacities, first, count, buffer):
    """How many standard deviations out 16 Gaussians are seen; negative for invisible ones."""
    for lane in range(count):
        fade = 2 * log(max(opacities[first + lane], 1e-30) / const.MIN_ALPHA)
        buffer[lane] = min(const.MAX_EXTENT, sqrt(fade)) if fade >= 0 else -1
    return vec.load(buffer, 0)


@no_type_check
@inner
def between(low, value, high):
    """Lanes in which a value lies strictly between two others."""
    return vec.both(vec.greater(value, low), vec.greater(high, value))


@no_type_check
@kernel
def project(gaussians, view, out, threads):
    """Fill `out` (depths as [N,1]) with what one camera sees: 0 for Gaussians that it does not."""
    means, quats, scales, opacities = gaussians
    means2d, conics, depths, radii = out
    viewmat, K, width, height = view
    for thread in numba.prange(threads):
        buffer = np.zeros(4 * vec.LANES, np.float32)
        low, high = span(means.shape[0], thread, threads)
        for first in range(low, high, vec.LANES):
            count = min(vec.LANES, high - first)
            p = camera_space(read_three(means, first, count, buffer), viewmat)
            w, x, y, z, _ = unit_quaternion(read_four(quats, first, count, buffer))
            scale = read_three(scales, first, count, buffer)
            axes = camera_axes(rotation(w, x, y, z), scale, viewmat)
            a0, a1, _ = image_axes(axes, p, view)
            sigma_x, sigma_y, conic = ellipse(a0, a1)
            u = K[0, 0] * p[0] / p[2] + K[0, 2]
            v = K[1, 1] * p[1] / p[2] + K[1, 2]
            extent = read_extents(opacities, first, count, buffer)
            radius_x, radius_y = vec.ceil(extent * sigma_x), vec.ceil(extent * sigma_y)
            inside = vec.both(
                between(0 - radius_x, u, width + radius_x),
                between(0 - radius_y, v, height + radius_y),
            )
            deep = between(const.NEAR_PLANE, p[2], const.FAR_PLANE)
            seen = vec.both(vec.both(inside, deep), vec.greater_equal(extent, 0))
            lanes = Lanes(first, count, seen, buffer)
            write_column(means2d, 0, lanes, u)
            write_column(means2d, 1, lanes, v)
            write_column(conics, 0, lanes, conic[0])
            write_column(conics, 1, lanes, conic[1])
            write_column(conics, 2, lanes, conic[2])
            write_column(depths, 0, lanes, p[2])
            write_column(radii, 0, lanes, radius_x)
            write_column(radii, 1, lanes, radius_y)
