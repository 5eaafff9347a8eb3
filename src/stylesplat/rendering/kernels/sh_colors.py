"""Spherical harmonics on the CPU, with gradients of coefficients and directions.

The basis is `scene.splats`'s: same order, same signs.
"""

from math import sqrt
from typing import NamedTuple

import numba
import numpy as np
from torch import Tensor

from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.scene.splats import SH_C0, SH_C1, SH_C2, SH_C3, SH_C3_ZONAL

A2, B2, C2 = SH_C2
A3, B3, C3 = SH_C3
ZONAL, TESSERAL = SH_C3_ZONAL
ZERO, HALF = np.float32(0), np.float32(0.5)
UNCLAMPED = np.float32(-np.inf)  # the lowest colour where none is clamped


class Harmonics(NamedTuple):
    """What a colour is made of, or the gradients of that: [N,3], [N,1,3] and [N,K-1,3]."""

    dirs: Tensor
    sh0: Tensor
    shN: Tensor


@inner
def basis(x, y, z):
    """The 16 basis functions at a unit direction."""
    xx, yy, zz = x * x, y * y, z * z
    return (
        SH_C0,
        -SH_C1 * y,
        SH_C1 * z,
        -SH_C1 * x,
        A2 * x * y,
        -A2 * y * z,
        B2 * (3 * zz - 1),
        -A2 * x * z,
        C2 * (xx - yy),
        -A3 * y * (3 * xx - yy),
        B3 * x * y * z,
        -C3 * y * (5 * zz - 1),
        ZONAL * z * (5 * zz - 3),
        -C3 * x * (5 * zz - 1),
        TESSERAL * z * (xx - yy),
        -A3 * x * (xx - 3 * yy),
    )


@inner
def basis_gradient(x, y, z, s):
    """The gradient by direction of the sum of `s[k]` times basis function k.

    `s` holds 16 numbers, 0 for the bands that are not in use.
    """
    xx, yy, zz = x * x, y * y, z * z
    v_x = -SH_C1 * s[3] + A2 * (y * s[4] - z * s[7]) + 2 * C2 * x * s[8]
    v_y = -SH_C1 * s[1] + A2 * (x * s[4] - z * s[5]) - 2 * C2 * y * s[8]
    v_z = SH_C1 * s[2] - A2 * (y * s[5] + x * s[7]) + 6 * B2 * z * s[6]
    v_x += -6 * A3 * x * y * s[9] + B3 * y * z * s[10] - C3 * (5 * zz - 1) * s[13]
    v_x += 2 * TESSERAL * x * z * s[14] - 3 * A3 * (xx - yy) * s[15]
    v_y += -3 * A3 * (xx - yy) * s[9] + B3 * x * z * s[10] - C3 * (5 * zz - 1) * s[11]
    v_y += -2 * TESSERAL * y * z * s[14] + 6 * A3 * x * y * s[15]
    v_z += B3 * x * y * s[10] - 10 * C3 * z * (y * s[11] + x * s[13])
    v_z += 3 * ZONAL * (5 * zz - 1) * s[12] + TESSERAL * (xx - yy) * s[14]
    return v_x, v_y, v_z


@inner
def unit(direction):
    """A direction of norm 1, and the inverse of the norm that it had."""
    x, y, z = direction[0], direction[1], direction[2]
    inverse = 1 / max(sqrt(x * x + y * y + z * z), 1e-12)
    return x * inverse, y * inverse, z * inverse, inverse


@kernel
def colors(bases, harmonics, lowest, out):
    """Fill `out` [N,3] with the colours, clamped at `lowest`; `bases` is 1, 4, 9 or 16."""
    dirs, sh0, shN = harmonics
    for i in numba.prange(dirs.shape[0]):
        x, y, z, _ = unit(dirs[i])
        values = basis(x, y, z)
        value = np.float32(values[0])
        r, g, b = value * sh0[i, 0, 0], value * sh0[i, 0, 1], value * sh0[i, 0, 2]
        for k in range(1, bases):
            value = np.float32(values[k])
            r += value * shN[i, k - 1, 0]
            g += value * shN[i, k - 1, 1]
            b += value * shN[i, k - 1, 2]
        out[i, 0], out[i, 1], out[i, 2] = (
            max(r + HALF, lowest),
            max(g + HALF, lowest),
            max(b + HALF, lowest),
        )


@kernel
def colors_backward(bases, harmonics, lowest, out, v_out, v_harmonics, threads):
    """Fill the gradients of directions and coefficients; `out` are the colours."""
    dirs, _, shN = harmonics
    v_dirs, v_sh0, v_shN = v_harmonics
    n = dirs.shape[0]
    for t in numba.prange(threads):
        sums = np.zeros(16, np.float32)
        for i in range(t * n // threads, (t + 1) * n // threads):
            if v_out[i, 0] == 0 and v_out[i, 1] == 0 and v_out[i, 2] == 0:
                v_dirs[i], v_sh0[i], v_shN[i] = 0, 0, 0
                continue
            x, y, z, inverse = unit(dirs[i])
            values = basis(x, y, z)
            r = v_out[i, 0] if out[i, 0] > lowest else ZERO
            g = v_out[i, 1] if out[i, 1] > lowest else ZERO
            b = v_out[i, 2] if out[i, 2] > lowest else ZERO
            value = np.float32(values[0])
            v_sh0[i, 0, 0], v_sh0[i, 0, 1], v_sh0[i, 0, 2] = value * r, value * g, value * b
            for k in range(1, shN.shape[1] + 1):
                value = np.float32(values[k]) if k < bases else ZERO
                v_shN[i, k - 1, 0] = value * r
                v_shN[i, k - 1, 1] = value * g
                v_shN[i, k - 1, 2] = value * b
                total = shN[i, k - 1, 0] * r + shN[i, k - 1, 1] * g + shN[i, k - 1, 2] * b
                sums[k] = total if k < bases else ZERO
            v_x, v_y, v_z = basis_gradient(x, y, z, sums)
            radial = v_x * x + v_y * y + v_z * z
            v_dirs[i, 0] = (v_x - radial * x) * inverse
            v_dirs[i, 1] = (v_y - radial * y) * inverse
            v_dirs[i, 2] = (v_z - radial * z) * inverse
