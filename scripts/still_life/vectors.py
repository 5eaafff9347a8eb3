"""Vectors of three numbers and lattice noise, for the numba kernels of the still life.

The noise has no seed: a seed shifts the position.
"""

from math import floor, sqrt
from typing import Any

from stylesplat.rendering.kernels.jit import INNER, cached

Vec = tuple[float, float, float]

FAST: dict[str, Any] = {"fastmath": True, "error_model": "numpy"}

kernel = cached(**FAST, **INNER)
"""Decorator of functions that only other kernels call: half of the time to compile them."""


@kernel
def dot(a: Vec, b: Vec) -> float:
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def scaled(a: Vec, s: float) -> Vec:
    """`s * a`."""
    return a[0] * s, a[1] * s, a[2] * s


@kernel
def along(origin: Vec, direction: Vec, t: float) -> Vec:
    """The point `origin + t * direction`."""
    return origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]


@kernel
def product(a: Vec, b: Vec) -> Vec:
    """Element by element."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel
def length(a: Vec) -> float:
    """Euclidean norm."""
    return sqrt(dot(a, a))


@kernel
def unit(a: Vec) -> Vec:
    """The same direction at length 1."""
    return scaled(a, 1 / (length(a) + 1e-12))


@kernel
def saturate(x: float) -> float:
    """Clamp to 0 .. 1."""
    return min(max(x, 0.0), 1.0)


@kernel
def smoothstep(low: float, high: float, x: float) -> float:
    """0 below `low`, 1 above `high`, a smooth ramp between; falling if `low > high`."""
    t = saturate((x - low) / (high - low))
    return t * t * (3 - 2 * t)


@kernel
def mix(a: Vec, b: Vec, t: float) -> Vec:
    """From `a` at 0 to `b` at 1."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t


@kernel
def lattice(i: int, j: int, k: int) -> float:
    """A number in [0, 1) that looks random, fixed for each lattice point."""
    h = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    h = (h ^ (h >> 15)) * 1274126177
    h = (h ^ (h >> 13)) * 668265263
    return ((h ^ (h >> 16)) & 0xFFFFFF) / 16777216.0


@kernel
def noise(p: Vec) -> float:
    """Smooth noise in [0, 1] whose features are one unit across."""
    i, j, k = floor(p[0]), floor(p[1]), floor(p[2])
    u, v, w = p[0] - i, p[1] - j, p[2] - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for corner in range(8):
        a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
        total += weight * lattice(i + a, j + b, k + c)
    return total


@kernel
def fractal_noise(p: Vec, octaves: int) -> float:
    """Noise in [0, 1] with ever finer detail: each octave half as strong, twice as fine."""
    total, weight = 0.0, 0.5
    for _ in range(octaves):
        total += weight * noise(p)
        p = scaled(p, 2.03)  # not quite 2: the lattices must not line up
        weight *= 0.5
    return total / (1 - 2 * weight)
