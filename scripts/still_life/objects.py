"""The five objects: signed distance fields (after Inigo Quilez's constructions) and colours.

Both are functions of the position in the object's own frame, which stands on z = 0. Distances are
lower bounds, so sphere tracing never oversteps. Colours are linear light; `grain` shifts the noise,
so that seeds differ.
"""

from math import atan2, cos, floor, pi, sin, sqrt

import numpy as np

from .vectors import (
    Vec,
    along,
    dot,
    fractal_noise,
    kernel,
    lattice,
    length,
    mix,
    noise,
    saturate,
    scaled,
    smoothstep,
)

NAMES = ("vase", "teapot", "pear", "block", "ball")
VASE, TEAPOT, PEAR, BLOCK, BALL = range(1, 6)

BOUNDS = np.array([[0.62, 0.70], [0.42, 0.78], [0.50, 0.54], [0.28, 0.47], [0.31, 0.32]])
"""Height of the centre and radius of a sphere around each object, in its own frame."""

VASE_HEIGHT = 1.24
BLOCK_HALF = 0.28
BALL_RADIUS = 0.31
BALL_PANELS = 8


@kernel
def smooth_min(a: float, b: float, k: float) -> float:
    """Union whose seam is rounded over a width of `k`."""
    h = max(k - abs(a - b), 0.0) / k
    return min(a, b) - h * h * k * 0.25


@kernel
def smooth_max(a: float, b: float, k: float) -> float:
    """Intersection whose edge is rounded over a width of `k`."""
    return -smooth_min(-a, -b, k)


@kernel
def _sphere(p: Vec, centre: Vec, radius: float) -> float:
    return length(along(p, centre, -1.0)) - radius


@kernel
def _ellipsoid(p: Vec, height: float, wide: float, tall: float) -> float:
    x, y, z = p[0] / wide, p[1] / wide, (p[2] - height) / tall
    outside = length((x, y, z))
    return outside * (outside - 1) / (length((x / wide, y / wide, z / tall)) + 1e-9)


@kernel
def _rod(p: Vec, start: Vec, end: Vec, radius: float, end_radius: float) -> float:
    axis, offset = along(end, start, -1.0), along(p, start, -1.0)
    t = saturate(dot(offset, axis) / dot(axis, axis))
    return length(along(offset, axis, -t)) - (radius + (end_radius - radius) * t)


@kernel
def _ring(across: float, height: float, radius: float, thickness: float) -> float:
    return sqrt((across - radius) ** 2 + height * height) - thickness


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


@kernel
def pear(p: Vec) -> float:
    """Two spheres grown together, a dimple and a bent stem."""
    fruit = smooth_min(
        _sphere(p, (0.0, 0.0, 0.29), 0.29), _sphere(p, (0.04, 0.01, 0.68), 0.135), 0.30
    )
    fruit = smooth_max(fruit, -_sphere(p, (0.05, 0.01, 0.855), 0.03), 0.06)
    stem = _rod(p, (0.045, 0.01, 0.77), (0.12, 0.03, 0.96), 0.013, 0.021)
    return smooth_min(smooth_max(fruit, -p[2], 0.03), stem, 0.02)


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


@kernel
def panel_angle(p: Vec) -> float:
    """Which panel of the ball, plus how far across it: 0 to `BALL_PANELS`."""
    y = 0.8 * p[1] - 0.6 * (p[2] - BALL_RADIUS)
    return (atan2(y, p[0]) / (2 * pi) + 0.5) * BALL_PANELS


@kernel
def pole_height(p: Vec) -> float:
    """Position along the ball's tilted axis: -1 to 1 from pole to pole."""
    return (0.6 * p[1] + 0.8 * (p[2] - BALL_RADIUS)) / BALL_RADIUS


@kernel
def ball(p: Vec) -> float:
    """A sphere of sewn panels."""
    seam = 0.5 + 0.5 * cos(2 * pi * panel_angle(p))
    waist = sqrt(max(1 - pole_height(p) ** 2, 0.0))
    return _sphere(p, (0.0, 0.0, BALL_RADIUS), BALL_RADIUS) + 0.006 * waist * seam**12


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


CREAM = (0.84, 0.76, 0.60)
COBALT = (0.018, 0.06, 0.26)
SKY = (0.16, 0.38, 0.55)
GOLD = (0.60, 0.31, 0.05)
TEAL = (0.02, 0.22, 0.23)
CRIMSON = (0.46, 0.025, 0.03)
CORAL = (0.60, 0.10, 0.045)
MUSTARD = (0.72, 0.38, 0.045)
LEAF = (0.09, 0.22, 0.05)
BEECH = (0.56, 0.33, 0.15)
BARK = (0.10, 0.05, 0.02)

SCALES_AROUND = 14
PETALS_AROUND = 12
FLOWERS_AROUND = 9


@kernel
def _turn(p: Vec) -> float:
    """Angle around the vertical axis, 0 to 1."""
    return atan2(p[1], p[0]) / (2 * pi) + 0.5


@kernel
def _fold(x: float) -> float:
    """Triangle wave of period 1: 0 at whole numbers, 1 half-way."""
    return 1 - abs(2 * (x - floor(x)) - 1)


@kernel
def _fish_scales(u: float, v: float) -> Vec:
    """Overlapping fans of concentric rings, one per unit of `u` and half unit of `v`."""
    row = floor(2 * v)
    for above in range(2):  # the lower row lies in front
        k = row - 1 + above
        shift = 0.5 * (int(k) & 1)
        across, up = u + shift - floor(u + shift) - 0.5, v - 0.5 * k
        radius = 2 * sqrt(across * across + up * up)
        if radius < 1:
            return _fan(radius, lattice(floor(u + shift) % SCALES_AROUND, int(k), 5))
    return _fan(2 * sqrt((u - floor(u) - 0.5) ** 2 + (v - 0.5 * row - 0.5) ** 2), 0.5)


@kernel
def _fan(radius: float, chance: float) -> Vec:
    heart = mix(GOLD, mix(SKY, CORAL, smoothstep(0.6, 0.61, chance)), smoothstep(0.3, 0.31, chance))
    color = mix(heart, CREAM, smoothstep(0.28, 0.33, radius))
    color = mix(color, SKY, smoothstep(0.46, 0.50, radius))
    color = mix(color, CREAM, smoothstep(0.62, 0.66, radius))
    return mix(color, COBALT, smoothstep(0.80, 0.85, radius))


@kernel
def _vase(p: Vec, grain: float) -> Vec:
    turn, z = _turn(p), p[2]
    wobble = 0.006 * (noise((turn * 60, z * 14, grain)) - 0.5)  # a steady but human hand
    z += wobble
    color = CREAM
    if z < 0.13:
        color = mix(COBALT, CREAM, smoothstep(0.52, 0.58, _fold(turn * 24)) if z > 0.06 else 0.0)
    elif 0.17 < z < 0.68:
        color = _fish_scales(turn * SCALES_AROUND, (z - 0.17) * 6)
    elif 0.72 < z < 1.04:
        height = (z - 0.72) / 0.32
        petal = _fold(turn * PETALS_AROUND) - (1.05 * height**1.5)
        vein = smoothstep(0.06, 0.10, abs(petal - 0.2))
        color = mix(CREAM, mix(SKY, TEAL, vein), smoothstep(-0.03, 0.03, petal))
    elif 1.07 < z < 1.19:
        color = mix(COBALT, CREAM, smoothstep(-0.15, 0.15, _fold(turn * 18) - (z - 1.07) / 0.12))
    for line in (0.15, 0.70, 1.055):
        color = mix(GOLD, color, smoothstep(0.013, 0.018, abs(z - line)))
    color = mix(GOLD, color, smoothstep(VASE_HEIGHT - 0.02, VASE_HEIGHT - 0.035, z))
    inside = smoothstep(0.02, -0.02, sqrt(p[0] ** 2 + p[1] ** 2) - 0.10) * (z < VASE_HEIGHT - 0.1)
    return scaled(mix(color, BARK, inside), 0.86 + 0.28 * fractal_noise(scaled(p, 9), 3))


@kernel
def _flower(u: float, v: float, twist: float) -> Vec:
    """Petals around a yellow heart, at the origin; the first number is below 0 outside."""
    radius, angle = sqrt(u * u + v * v), atan2(v, u) + twist
    edge = 0.36 * (0.72 + 0.28 * cos(7 * angle))
    return edge - radius, 0.12 - radius, cos(21 * angle)


@kernel
def _teapot(p: Vec, grain: float) -> Vec:
    turn, z = _turn(p), p[2]
    across = sqrt(p[0] ** 2 + p[1] ** 2)
    mottled = fractal_noise((p[0] * 7 + grain, p[1] * 7, p[2] * 7), 4)
    color = mix(scaled(CORAL, 0.55), mix(CORAL, MUSTARD, 0.28), smoothstep(0.25, 0.75, mottled))
    if across > 0.48 or z > 0.72:  # spout, handle and knob
        return mix(COBALT, TEAL, smoothstep(0.35, 0.65, mottled))
    if z > 0.612:
        color = mix(CREAM, TEAL, smoothstep(0.40, 0.5, _fold(turn * 16)))
        return mix(COBALT, color, smoothstep(0.205, 0.195, across))
    row = floor(z * 5.2 + 0.1)
    u = turn * FLOWERS_AROUND + 0.5 * (int(row) & 1)
    cell = floor(u) % FLOWERS_AROUND
    twist = 6.0 * lattice(cell, int(row), 3)
    petal, heart, rays = _flower(u - floor(u) - 0.5, (z * 5.2 + 0.1 - row - 0.5) * 1.1, twist)
    bloom = (
        mix(CREAM, SKY, 0.35 + 0.35 * rays)
        if lattice(cell, int(row), 4) < 0.4
        else (mix(CREAM, MUSTARD, 0.12 + 0.12 * rays))
    )
    color = mix(color, bloom, smoothstep(-0.01, 0.01, petal))
    color = mix(color, mix(GOLD, BARK, 0.3), smoothstep(-0.01, 0.01, heart))
    return mix(COBALT, color, smoothstep(0.05, 0.055, z))


@kernel
def _pear(p: Vec, grain: float) -> Vec:
    q = (p[0] + grain, p[1], p[2])
    soft = fractal_noise(scaled(q, 3.5), 3)
    turn = _turn(along(p, (0.04, 0.01, 0.0), -1.0))
    streak = noise((turn * 44, p[2] * 3.5, grain))
    color = mix(MUSTARD, scaled(LEAF, 1.9), smoothstep(0.32, 0.72, soft + 0.25 * (0.5 - p[2])))
    blush = smoothstep(0.1, 0.9, 0.5 + 1.3 * p[0] + 0.6 * (soft - 0.5) + 0.4 * (streak - 0.5))
    color = mix(color, CRIMSON, 0.85 * blush)
    freckle = smoothstep(0.72, 0.80, noise(scaled(q, 58)))
    color = mix(color, mix(BARK, CREAM, 0.35 + 0.5 * blush), 0.6 * freckle)
    color = mix(color, BARK, 0.55 * smoothstep(0.10, 0.0, p[2]))
    stem = smoothstep(0.79, 0.82, p[2] + 0.05 * (soft - 0.5))
    return mix(color, scaled(BARK, 0.7 + noise(scaled(q, 30))), stem)


@kernel
def _motif(face: int, u: float, v: float) -> float:
    """The painted sign of a face of the block, positive inside; coordinates -1 to 1."""
    radius, angle = sqrt(u * u + v * v), atan2(u, v)
    if face == 0:  # star
        return 0.86 - 0.52 * _fold(angle * 5 / (2 * pi)) ** 0.8 - radius
    if face == 1:  # rings
        return cos(radius * 9.5) * (radius < 0.85)
    if face == 2:  # heart
        return 0.62 - sqrt(u * u + (1.15 * v - 0.55 * sqrt(abs(u)) + 0.12) ** 2)
    if face == 3:  # moon
        return min(0.66 - radius, sqrt((u - 0.28) ** 2 + (v - 0.12) ** 2) - 0.5)
    return sin(u * 7.5) * sin(v * 7.5) * (max(abs(u), abs(v)) < 0.84)  # chequers


@kernel
def _block(p: Vec, grain: float) -> Vec:
    x, y, z = p[0], p[1], p[2] - BLOCK_HALF
    rings = fractal_noise((x * 3 + grain, y * 22, z * 22), 3)
    wood = scaled(BEECH, 0.62 + 0.75 * rings)
    if abs(z) > max(abs(x), abs(y)):
        face, u, v, ground = 4, x, y, MUSTARD
    elif abs(x) > abs(y):
        face, u, v, ground = (0, y, z, COBALT) if x > 0 else (1, -y, z, CREAM)
    else:
        face, u, v, ground = (2, -x, z, TEAL) if y > 0 else (3, x, z, CRIMSON)
    sign = CRIMSON if face == 1 or face == 4 else CREAM if face == 3 else MUSTARD
    sign = CORAL if face == 2 else sign
    sign = mix(ground, sign, smoothstep(-0.04, 0.04, _motif(face, u / 0.2, v / 0.2)))
    worn = smoothstep(0.60, 0.75, fractal_noise((x * 16, y * 16 + grain, z * 16), 3))
    paint = mix(scaled(sign, 0.8 + 0.4 * rings), wood, 0.7 * worn)
    return mix(wood, paint, smoothstep(0.205, 0.195, max(abs(u), abs(v))))


@kernel
def _ball(p: Vec, grain: float) -> Vec:
    panel = panel_angle(p)
    height = pole_height(p)
    index = floor(panel) % BALL_PANELS
    color = CREAM if index & 1 else CRIMSON
    if index % 4 == 2:
        color = TEAL
    u, v = panel - floor(panel) - 0.5, height / 0.36
    petal, heart, _ = _flower(u * 1.05, v * 0.5, 0.0)
    accent = MUSTARD if index & 1 == 0 else COBALT
    color = mix(color, accent, smoothstep(-0.012, 0.012, petal))
    color = mix(color, CREAM if index & 1 == 0 else CORAL, smoothstep(-0.01, 0.01, heart))
    stripe = smoothstep(0.035, 0.025, abs(abs(height) - 0.66))
    color = mix(color, accent, stripe)
    color = mix(color, MUSTARD, smoothstep(0.85, 0.865, abs(height)))
    color = mix(color, COBALT, smoothstep(0.955, 0.965, abs(height)))
    seam = smoothstep(0.05, 0.03, 0.5 - abs(panel - floor(panel) - 0.5)) * (abs(height) < 0.86)
    leather = fractal_noise((p[0] * 26 + grain, p[1] * 26, p[2] * 26), 2)
    return scaled(mix(color, BARK, 0.7 * seam), 0.72 + 0.5 * leather)


@kernel
def albedo(object_id: int, p: Vec, grain: float) -> Vec:
    """Diffuse colour of an object at a point of its surface."""
    if object_id == VASE:
        return _vase(p, grain)
    if object_id == TEAPOT:
        return _teapot(p, grain)
    if object_id == PEAR:
        return _pear(p, grain)
    if object_id == BLOCK:
        return _block(p, grain)
    return _ball(p, grain)


@kernel
def gloss(object_id: int) -> float:
    """Strength of the highlight: glazes shine, wood hardly."""
    return 0.30 if object_id <= TEAPOT else 0.10 if object_id == PEAR else 0.05
