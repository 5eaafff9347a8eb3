"""The round table with its cloth, and the painted backdrop around it."""

from math import cos, floor, pi, sin, sqrt

from .objects import BARK, COBALT, CREAM, GOLD, SKY
from .vectors import (
    Vec,
    along,
    dot,
    fractal_noise,
    kernel,
    lattice,
    mix,
    noise,
    scaled,
    smoothstep,
    unit,
)

TABLE_RADIUS = 2.05
TABLE_THICKNESS = 0.13
BACKDROP_RADIUS = 7.0
PLANK_WIDTH = 0.34
PLANK_LENGTH = 1.9
CLOTH_TURN = 0.5  # radians
CLOTH_HALF = (1.62, 0.80)
NOWHERE = 1e9  # farther than anything

OAK = (0.36, 0.185, 0.075)
OAK_DARK = (0.13, 0.055, 0.02)
PLASTER = (0.98, 0.86, 0.68)
PLASTER_DARK = (0.22, 0.30, 0.30)


@kernel
def hit_backdrop(origin: Vec, direction: Vec) -> float:
    """Distance along a ray to the sphere around everything, seen from inside."""
    b = dot(origin, direction)
    return -b + sqrt(b * b - dot(origin, origin) + BACKDROP_RADIUS**2)


@kernel
def hit_table(origin: Vec, direction: Vec) -> float:
    """Distance along a ray to the table's top or rim, `NOWHERE` if it misses."""
    if direction[2] < 0 < origin[2]:
        t = -origin[2] / direction[2]
        top = along(origin, direction, t)
        if top[0] ** 2 + top[1] ** 2 < TABLE_RADIUS**2:
            return t
    a = direction[0] ** 2 + direction[1] ** 2
    b = origin[0] * direction[0] + origin[1] * direction[1]
    root = b * b - a * (origin[0] ** 2 + origin[1] ** 2 - TABLE_RADIUS**2)
    if root > 0:
        t = (-b - sqrt(root)) / a
        if t > 0 and -TABLE_THICKNESS < origin[2] + t * direction[2] < 0:
            return t
    return NOWHERE


@kernel
def table_normal(p: Vec) -> Vec:
    """Up on the top, bending outwards at the rounded rim."""
    radius = sqrt(p[0] ** 2 + p[1] ** 2)
    bend = smoothstep(TABLE_RADIUS - 0.05, TABLE_RADIUS, radius) * 0.7 if p[2] > -1e-4 else 2.0
    return unit((bend * p[0] / radius, bend * p[1] / radius, 1.0 if p[2] > -1e-4 else 0.1))


@kernel
def backdrop_albedo(p: Vec) -> Vec:
    """A photographer's painted canvas: lighter above, softly mottled."""
    q = scaled(p, 0.45)
    cloud = fractal_noise((q[0] + 1.3 * noise(q), q[1], q[2]), 3)
    height = smoothstep(-4.5, 5.5, p[2] + 1.6 * (cloud - 0.5))
    return mix(PLASTER_DARK, PLASTER, height)


@kernel
def _planks(p: Vec, grain: float) -> Vec:
    row = floor(p[1] / PLANK_WIDTH)
    shifted = p[0] / PLANK_LENGTH + 0.37 * row
    piece = floor(shifted)
    tone = lattice(int(row), int(piece), 9)
    across, x = p[1] / PLANK_WIDTH - row, p[0] + 17 * tone + grain
    bend = fractal_noise((x * 0.55, p[1] * 2.0, tone * 40), 2)
    rings = 0.5 + 0.5 * sin(2 * pi * (p[1] * 9 + 7 * bend))
    fibre = fractal_noise((x * 1.7, p[1] * 34, tone * 9), 3)
    pores = smoothstep(0.62, 0.80, noise((x * 9, p[1] * 95, 3.3)))
    depth = 0.36 * rings**2 + 0.5 * smoothstep(0.25, 0.8, fibre) - 0.10
    color = mix(OAK, OAK_DARK, depth)
    color = scaled(mix(color, OAK_DARK, 0.55 * pores), 0.72 + 0.62 * tone)
    joint = min(min(across, 1 - across) * PLANK_WIDTH, (0.5 - abs(shifted - piece - 0.5)) * 1.9)
    return mix(scaled(BARK, 0.25), color, smoothstep(0.004, 0.012, joint))


@kernel
def _linen(u: float, v: float, grain: float) -> Vec:
    """Striped cloth with a coarse weave; `u` runs along it, `v` across."""
    weave = 0.5 + 0.25 * (sin(u * 150) + sin(v * 150))
    thread = noise((u * 9 + grain, v * 110, 1.5)) + noise((u * 110, v * 9 + grain, 2.5))
    end = CLOTH_HALF[0] - abs(u)
    side = CLOTH_HALF[1] - abs(v)
    color = CREAM
    stripe = smoothstep(0.03, 0.024, abs(side - 0.10)) + smoothstep(0.010, 0.006, abs(side - 0.16))
    color = mix(color, COBALT, 0.85 * min(stripe, 1.0))
    band = smoothstep(0.05, 0.044, abs(end - 0.30)) + smoothstep(0.012, 0.008, abs(end - 0.38))
    color = mix(color, mix(COBALT, SKY, 0.25), 0.8 * min(band, 1.0))
    diamond = abs(2 * (v * 7 - floor(v * 7)) - 1) + abs(end - 0.52) / 0.07
    color = mix(color, GOLD, 0.85 * smoothstep(0.85, 0.75, diamond))
    return scaled(color, 0.50 + 0.16 * weave + 0.24 * thread)


@kernel
def table_albedo(p: Vec, grain: float) -> Vec:
    """Oak planks, and the cloth that lies askew on them."""
    if p[2] < -1e-4:
        return scaled(_planks(p, grain), 0.6)
    c, s = cos(CLOTH_TURN), sin(CLOTH_TURN)
    u, v = c * p[0] + s * p[1], c * p[1] - s * p[0]
    ragged = 0.012 * (noise((u * 5, v * 5, grain)) - 0.5)
    fringe = 0.06 * (noise((v * 60, 7.7, grain)) > 0.45)
    end = CLOTH_HALF[0] + fringe - abs(u)
    side = CLOTH_HALF[1] - abs(v) + ragged
    inside = min(end, side)
    if inside > 0:
        return _linen(u, v, grain)
    return scaled(_planks(p, grain), 0.65 + 0.35 * smoothstep(0.0, -0.05, inside))
