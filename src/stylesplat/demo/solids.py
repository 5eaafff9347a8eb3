"""The five objects as signed distance fields (after Inigo Quilez's constructions).

Each is a function of the position in the object's own frame, which stands on z = 0. The
distances are lower bounds, so sphere tracing never oversteps.
"""

from math import atan2, cos, pi, sqrt
from typing import no_type_check

import numpy as np

from stylesplat.demo.vectors import Vec, along, dot, kernel, length, saturate, smoothstep

NAMES = ("vase", "teapot", "pear", "block", "ball")
VASE, TEAPOT, PEAR, BLOCK, BALL = range(1, 6)

BOUNDS = np.array([[0.62, 0.70], [0.42, 0.78], [0.50, 0.54], [0.28, 0.47], [0.31, 0.32]])
"""Height of the centre and radius of a sphere around each object, in its own frame."""

VASE_HEIGHT = 1.24
BLOCK_HALF = 0.28
BALL_RADIUS = 0.31
BALL_PANELS = 8


@no_type_check
@kernel
def smooth_min(a: float, b: float, k: float) -> float:
    """Union whose seam is rounded over a width of `k`."""
    h = max(k - abs(a - b), 0.0) / k
    return min(a, b) - h * h * k * 0.25


@no_type_check
@kernel
def smooth_max(a: float, b: float, k: float) -> float:
    """Intersection whose edge is rounded over a width of `k`."""
    return -smooth_min(-a, -b, k)


@no_type_check
@kernel
def _sphere(p: Vec, centre: Vec, radius: float) -> float:
    return length(along(p, centre, -1.0)) - radius


@no_type_check
@kernel
def _ellipsoid(p: Vec, height: float, wide: float, tall: float) -> float:
    x, y, z = p[0] / wide, p[1] / wide, (p[2] - height) / tall
    outside = length((x, y, z))
    return outside * (outside - 1) / (length((x / wide, y / wide, z / tall)) + 1e-9)


@no_type_check
@kernel
def _rod(p: Vec, start: Vec, end: Vec, radius: float, end_radius: float) -> float:
    axis, offset = along(end, start, -1.0), along(p, start, -1.0)
    t = saturate(dot(offset, axis) / dot(axis, axis))
    return length(along(offset, axis, -t)) - (radius + (end_radius - radius) * t)


@no_type_check
@kernel
def _ring(across: float, height: float, radius: float, thickness: float) -> float:
    return sqrt((across - radius) ** 2 + height * height) - thickness


@no_type_check
@kernel
def vase(p: Vec) -> float:
    """A hollow amphora: foot, belly, neck and flared lip."""
    z = p[2]
    profile = 0.19 + 0.20 * smoothstep(0.0, 0.56, z) - 0.255 * smoothstep(0.56, 1.02, z)
    profile += 0.10 * smoothstep(1.02, VASE_HEIGHT, z)
    steepness = 0.75  # turns the radial distance into a lower bound of the true one
    outside = (sqrt(p[0] ** 2 + p[1] ** 2) - profile) * steepness
    cavity = max(outside + 0.03, 0.6 - z)
    wall = smooth_max(outside, -cavity, 0.02)
    return smooth_max(wall, abs(z - VASE_HEIGHT / 2) - VASE_HEIGHT / 2, 0.03)


@no_type_check
@kernel
def teapot(p: Vec) -> float:
    """Body, lid with knob, spout towards +x and handle towards -x, grown together."""
    across = sqrt(p[0] ** 2 + p[1] ** 2)
    body = _ellipsoid(p, 0.34, 0.43, 0.355)
    rim = _ring(across, p[2] - 0.635, 0.215, 0.022)
    body = smooth_min(body, min(rim, _ring(across, p[2] - 0.02, 0.24, 0.03)), 0.03)
    lid = _ellipsoid(p, 0.63, 0.2, 0.12)
    lid = smooth_min(lid, _sphere(p, (0.0, 0.0, 0.80), 0.06), 0.05)
    spout = _rod(p, (0.28, 0.0, 0.24), (0.53, 0.0, 0.40), 0.115, 0.066)
    spout = smooth_min(spout, _rod(p, (0.53, 0.0, 0.40), (0.67, 0.0, 0.64), 0.062, 0.05), 0.06)
    spout = smooth_max(spout, -_sphere(p, (0.695, 0.0, 0.685), 0.045), 0.015)
    handle = _ring(sqrt((p[0] + 0.43) ** 2 + (p[2] - 0.38) ** 2), p[1], 0.205, 0.04)
    pot = smooth_min(smooth_min(body, lid, 0.015), smooth_min(spout, handle, 0.01), 0.05)
    return smooth_max(pot, -p[2], 0.02)


@no_type_check
@kernel
def pear(p: Vec) -> float:
    """Two spheres grown together, a dimple and a bent stem."""
    fruit = smooth_min(
        _sphere(p, (0.0, 0.0, 0.29), 0.29), _sphere(p, (0.04, 0.01, 0.68), 0.135), 0.30
    )
    fruit = smooth_max(fruit, -_sphere(p, (0.05, 0.01, 0.855), 0.03), 0.06)
    stem = _rod(p, (0.045, 0.01, 0.77), (0.12, 0.03, 0.96), 0.013, 0.021)
    return smooth_min(smooth_max(fruit, -p[2], 0.03), stem, 0.02)


@no_type_check
@kernel
def block(p: Vec) -> float:
    """A rounded wooden cube with a sunken panel on each face."""
    x, y, z = abs(p[0]), abs(p[1]), abs(p[2] - BLOCK_HALF)
    rounding = 0.035
    edge = BLOCK_HALF - rounding
    qx, qy, qz = max(x - edge, 0.0), max(y - edge, 0.0), max(z - edge, 0.0)
    cube = length((qx, qy, qz)) + min(max(x, y, z) - edge, 0.0) - rounding
    middle = x + y + z - max(x, y, z) - min(x, y, z)
    return 0.85 * (cube + 0.014 * smoothstep(0.225, 0.185, middle))  # the bevel adds steepness


@no_type_check
@kernel
def panel_angle(p: Vec) -> float:
    """Which panel of the ball, plus how far across it: 0 to `BALL_PANELS`."""
    y = 0.8 * p[1] - 0.6 * (p[2] - BALL_RADIUS)
    return (atan2(y, p[0]) / (2 * pi) + 0.5) * BALL_PANELS


@no_type_check
@kernel
def pole_height(p: Vec) -> float:
    """Position along the ball's tilted axis: -1 to 1 from pole to pole."""
    return (0.6 * p[1] + 0.8 * (p[2] - BALL_RADIUS)) / BALL_RADIUS


@no_type_check
@kernel
def ball(p: Vec) -> float:
    """A sphere of sewn panels."""
    seam = 0.5 + 0.5 * cos(2 * pi * panel_angle(p))
    waist = sqrt(max(1 - pole_height(p) ** 2, 0.0))
    return _sphere(p, (0.0, 0.0, BALL_RADIUS), BALL_RADIUS) + 0.006 * waist * seam**12


@no_type_check
@kernel
def distance(object_id: int, p: Vec) -> float:
    """Distance to the surface of one object, negative inside."""
    if object_id == VASE:
        return vase(p)
    if object_id == TEAPOT:
        return teapot(p)
    if object_id == PEAR:
        return pear(p)
    if object_id == BLOCK:
        return block(p)
    return ball(p)
