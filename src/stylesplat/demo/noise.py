"""Seedless lattice noise: the grain of the demo's woods, glazes and brush strokes.

A seed enters as an offset of the position.
"""

from math import floor
from typing import no_type_check

from stylesplat.demo.vectors import Vec, kernel, scaled


@no_type_check
@kernel
def lattice(i: int, j: int, k: int) -> float:
    """A number in [0, 1) that looks random, fixed for each lattice point."""
    h = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    h = (h ^ (h >> 15)) * 1274126177
    h = (h ^ (h >> 13)) * 668265263
    return ((h ^ (h >> 16)) & 0xFFFFFF) / 16777216.0


@no_type_check
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


@no_type_check
@kernel
def fractal_noise(p: Vec, octaves: int) -> float:
    """Noise in [0, 1] with ever finer detail: each octave half as strong, twice as fine."""
    total, weight = 0.0, 0.5
    for _ in range(octaves):
        total += weight * noise(p)
        p = scaled(p, 2.03)  # not quite 2: the lattices must not line up
        weight *= 0.5
    return total / (1 - 2 * weight)
