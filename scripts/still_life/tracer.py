"""Sphere tracing of the still life: colour, exact label and exact depth of every pixel."""

from math import sqrt

import numpy as np
from numba import prange

from stylesplat.rendering.kernels.jit import cached

from .objects import BOUNDS, NAMES, albedo, distance, gloss
from .surroundings import (
    NOWHERE,
    backdrop_albedo,
    hit_backdrop,
    hit_table,
    table_albedo,
    table_normal,
)
from .vectors import FAST, Vec, along, dot, kernel, mix, product, saturate, scaled, unit

OBJECTS = len(NAMES)
TABLE, BACKDROP = 0, -1  # both are label 0
HIT = 4e-4  # a surface is reached at this distance; a pixel is 20 times as wide
STEPS = 120
PENUMBRA = 7.0  # distance to a shadow's edge over distance to its caster, inverted
SHADOW_MARGIN = 0.15  # how far outside its bounding sphere an object still softens light
SAME_PLACE = 0.03  # rays of a pixel that end this close together share one look at the light
GRAZING = -0.2  # cosine at a pixel's centre from which its rays may face the light
HALF_PIXEL = 0.5  # that the samples of a pixel lie within, around its centre
AO_TAPS = (0.02, 0.06, 0.13, 0.24, 0.40)

TO_LIGHT = (-0.50, -0.42, 0.757)
LIGHT = (2.75, 2.45, 2.05)
SKYLIGHT = (0.62, 0.70, 0.80)
BOUNCE = (0.42, 0.30, 0.20)
EXPOSURE = 0.92


@kernel
def _to_object(p: Vec, placed: np.ndarray) -> Vec:
    """From the world to the frame of an object placed at (x, y, cosine, sine)."""
    x, y = p[0] - placed[0], p[1] - placed[1]
    return placed[2] * x + placed[3] * y, placed[2] * y - placed[3] * x, p[2]


@kernel
def _clip(
    origin: Vec, direction: Vec, layout: np.ndarray, i: int, margin: float
) -> tuple[float, float]:
    """Where a ray enters and leaves the sphere around object `i`; empty if enter > leave."""
    centre = (layout[i, 0], layout[i, 1], BOUNDS[i, 0])
    offset = along(origin, centre, -1.0)
    b = dot(offset, direction)
    root = b * b - dot(offset, offset) + (BOUNDS[i, 1] + margin) ** 2
    if root <= 0:
        return NOWHERE, -NOWHERE
    return max(-b - sqrt(root), 0.0), -b + sqrt(root)


@kernel
def trace(
    origin: Vec, direction: Vec, layout: np.ndarray, starts: np.ndarray, cone: float
) -> tuple[float, int]:
    """Distance along a ray to what it hits first, and what that is.

    `starts` [OBJECTS] says how far the way is known to be free of each object. It grows as far as
    everything within a distance of `cone` (over that along the ray) is free as well.
    """
    nearest, hit = hit_backdrop(origin, direction), BACKDROP
    t = hit_table(origin, direction)
    if t < nearest:
        nearest, hit = t, TABLE
    for i in range(OBJECTS):
        t, leave = _clip(origin, direction, layout, i, 0.0)
        t, free = max(t, starts[i]), True
        for _ in range(STEPS):
            if t > min(leave, nearest):
                break
            d = distance(i + 1, _to_object(along(origin, direction, t), layout[i]))
            free = free and d > cone * t
            if free:
                starts[i] = t
            if d < HIT:
                nearest, hit = t, i + 1
                break
            t += d
    return nearest, hit


@kernel
def _normal(hit: int, p: Vec, layout: np.ndarray) -> Vec:
    """Surface normal in the world, from four samples at the corners of a tetrahedron."""
    n = (0.0, 0.0, 0.0)
    for k in range(4):
        corner = (-1.0 + 2 * ((k ^ (k >> 1)) & 1), -1.0 + 2 * (k >> 1), -1.0 + 2 * (k & 1))
        at = _to_object(along(p, corner, 1.5e-3), layout[hit - 1])
        n = along(n, corner, distance(hit, at))
    return unit(n)


@kernel
def _shadow(p: Vec, layout: np.ndarray) -> float:
    """How much of the key light arrives, with soft edges."""
    light = 1.0
    for i in range(OBJECTS):
        t, leave = _clip(p, TO_LIGHT, layout, i, SHADOW_MARGIN)
        t = max(t, 0.01)
        for _ in range(STEPS):
            if t > leave or light < 0.004:
                break
            d = distance(i + 1, _to_object(along(p, TO_LIGHT, t), layout[i]))
            light = min(light, PENUMBRA * max(d, 0.0) / t)
            t += max(0.8 * d, 0.012)
    return light * light * (3 - 2 * light)


@kernel
def _openness(p: Vec, n: Vec, layout: np.ndarray) -> float:
    """Ambient occlusion: how far the distance field stays behind free space."""
    blocked, weight = 0.0, 1.0
    for reach in AO_TAPS:
        q = along(p, n, reach)
        free = min(max(q[2], 0.0), reach)
        for i in range(OBJECTS):
            x, y, z = q[0] - layout[i, 0], q[1] - layout[i, 1], q[2] - BOUNDS[i, 0]
            if sqrt(x * x + y * y + z * z) - BOUNDS[i, 1] < free:
                free = min(free, distance(i + 1, _to_object(q, layout[i])))
        blocked += weight * (reach - max(free, 0.0)) / reach
        weight *= 0.8
    return 1 - 0.82 * saturate(blocked / 3.36)


@kernel
def _arriving(p: Vec, hit: int, layout: np.ndarray) -> tuple[float, float]:
    """How much of the key light and of the sky's reaches a surface point: its costly part."""
    if hit == BACKDROP:
        return 0.0, 0.0
    n = table_normal(p) if hit == TABLE else _normal(hit, p, layout)
    shadow = _shadow(along(p, n, 0.004), layout) if dot(n, TO_LIGHT) > GRAZING else 0.0
    return shadow, _openness(p, n, layout)


@kernel
def _shade(
    p: Vec, direction: Vec, hit: int, arriving: tuple[float, float], layout: np.ndarray
) -> Vec:
    """Light that a surface point sends back along the ray, of what arrives there."""
    if hit == BACKDROP:
        return backdrop_albedo(p)
    if hit == TABLE:
        n, color, shine = table_normal(p), table_albedo(p, layout[0, 4]), 0.03
    else:
        n, shine = _normal(hit, p, layout), gloss(hit)
        color = albedo(hit, _to_object(p, layout[hit - 1]), layout[hit - 1, 4])
    lit = max(dot(n, TO_LIGHT), 0.0) * arriving[0]
    ambient = mix(BOUNCE, SKYLIGHT, 0.5 + 0.5 * n[2])
    light = along(scaled(ambient, arriving[1]), LIGHT, lit)
    halfway = unit(along(TO_LIGHT, direction, -1.0))
    highlight = shine * lit * max(dot(n, halfway), 0.0) ** 48
    sheen = 0.5 * shine * (1 + dot(n, direction)) ** 3 * (0.4 + 0.6 * max(n[2], 0.0))
    return along(along(product(color, light), LIGHT, highlight), SKYLIGHT, sheen)


@kernel
def _film(x: float) -> float:
    """Linear light to display value: Narkowicz's fit of the ACES curve, then gamma."""
    x = max(x * EXPOSURE * 0.6, 0.0)
    return saturate(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)) ** (1 / 2.2)


@kernel
def _ray(x: float, y: float, K: np.ndarray, c2w: np.ndarray) -> Vec:
    """World direction through a pixel position, of depth 1 in the camera."""
    u, v = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
    return (
        c2w[0, 0] * u + c2w[0, 1] * v + c2w[0, 2],
        c2w[1, 0] * u + c2w[1, 1] * v + c2w[1, 2],
        c2w[2, 0] * u + c2w[2, 1] * v + c2w[2, 2],
    )


@cached(**FAST, parallel=True)
def render_view(
    K: np.ndarray, c2w: np.ndarray, layout: np.ndarray, photo: np.ndarray, geometry: np.ndarray
) -> None:
    """Fill `photo` [H, W, 3] with sRGB in 0..1 and `geometry` [H, W, 2] with label and depth.

    Label and depth (along the camera's z) belong to the pixel's centre; the colour is the
    mean of four samples around it, which share the centre's shadow, sky and backdrop.
    """
    origin = (c2w[0, 3], c2w[1, 3], c2w[2, 3])
    cone = HALF_PIXEL / min(K[0, 0], K[1, 1])
    for row in prange(photo.shape[0]):
        starts = np.empty(OBJECTS)
        for column in range(photo.shape[1]):
            starts[:] = 0
            central = _ray(column + 0.5, row + 0.5, K, c2w)
            t, hit = trace(origin, unit(central), layout, starts, cone)
            geometry[row, column, 0] = max(hit, 0)
            geometry[row, column, 1] = t / sqrt(dot(central, central))
            centre = along(origin, unit(central), t)
            shared = _arriving(centre, hit, layout)
            behind = backdrop_albedo(centre) if hit == BACKDROP else (0.0, 0.0, 0.0)
            color = (0.0, 0.0, 0.0)
            for sample in range(4):
                x, y = column + 0.25 + 0.5 * (sample & 1), row + 0.25 + 0.5 * (sample >> 1)
                direction = unit(_ray(x, y, K, c2w))
                reached, what = trace(origin, direction, layout, starts, NOWHERE)
                p = along(origin, direction, reached)
                near = what == hit and abs(reached - t) < SAME_PLACE
                if near and what == BACKDROP:
                    seen = behind
                else:
                    arriving = shared if near else _arriving(p, what, layout)
                    seen = _shade(p, direction, what, arriving, layout)
                color = along(color, (_film(seen[0]), _film(seen[1]), _film(seen[2])), 0.25)
            for channel in range(3):
                photo[row, column, channel] = color[channel]
