"""Three numbers at a time: the vocabulary in which the demo's numba kernels are written."""

from math import sqrt
from typing import no_type_check

from stylesplat.rendering.kernels.jit import INNER, cached

Vec = tuple[float, float, float]

FAST = {"fastmath": True, "error_model": "numpy"}

kernel = cached(**FAST, **INNER)
"""Decorator of functions that only other kernels call: half of the time to compile them."""


@no_type_check
@kernel
def dot(a: Vec, b: Vec) -> float:
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@no_type_check
@kernel
def scaled(a: Vec, s: float) -> Vec:
    """`s * a`."""
    return a[0] * s, a[1] * s, a[2] * s


@no_type_check
@kernel
def along(origin: Vec, direction: Vec, t: float) -> Vec:
    """The point `origin + t * direction`."""
    return origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]


@no_type_check
@kernel
def product(a: Vec, b: Vec) -> Vec:
    """Element by element."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@no_type_check
@kernel
def length(a: Vec) -> float:
    """Euclidean norm."""
    return sqrt(dot(a, a))


@no_type_check
@kernel
def unit(a: Vec) -> Vec:
    """The same direction at length 1."""
    return scaled(a, 1 / (length(a) + 1e-12))


@no_type_check
@kernel
def saturate(x: float) -> float:
    """Clamp to 0 .. 1."""
    return min(max(x, 0.0), 1.0)


@no_type_check
@kernel
def smoothstep(low: float, high: float, x: float) -> float:
    """0 below `low`, 1 above `high`, a smooth ramp between; falling if `low > high`."""
    t = saturate((x - low) / (high - low))
    return t * t * (3 - 2 * t)


@no_type_check
@kernel
def mix(a: Vec, b: Vec, t: float) -> Vec:
    """From `a` at 0 to `b` at 1."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t
