"""Three style pictures: a swirling night and a burning tide in brush strokes, and scales.

A picture of brush strokes is a cartoon (what colour goes where), a potential (the brush follows its
contours) and layers of strokes from broad to fine. The strokes leave a relief of bristles.
"""

from math import floor, sqrt

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from stylesplat.rendering.kernels.jit import cached

from .vectors import FAST, kernel, noise, smoothstep

STEP = 0.5  # pixels between neighbouring bristles, and between stamps along a stroke
BRISTLE = 0.42  # bristle tracks per pixel
DRAG = 0.035  # how quickly a bristle's load changes per pixel of travel
LIGHT = (-0.55, -0.65, 0.53)  # towards the lamp that rakes over the canvas; y is down


@kernel
def _follow(field: np.ndarray, x: float, y: float) -> tuple[float, float]:
    """Unit direction of the field at the nearest pixel."""
    row = min(max(int(y), 0), field.shape[0] - 1)
    column = min(max(int(x), 0), field.shape[1] - 1)
    u, v = field[row, column, 0], field[row, column, 1]
    norm = sqrt(u * u + v * v) + 1e-9
    return u / norm, v / norm


@kernel
def _lay(
    color: np.ndarray, relief: np.ndarray, at: tuple, direction: tuple, stroke: np.ndarray, t: float
) -> None:
    """One line of bristles across the stroke, `t` of the way from start to end."""
    half, load = stroke[3], stroke[7]
    tip = smoothstep(0.0, 0.10, t) * smoothstep(1.0, 0.86, t)
    count = int(half / STEP)
    for i in range(-count, count + 1):
        across = i * STEP / half
        column = floor(at[0] - direction[1] * i * STEP)
        row = floor(at[1] + direction[0] * i * STEP)
        if not (0 <= row < color.shape[0] and 0 <= column < color.shape[1]):
            continue
        travel = t * stroke[2] * DRAG
        bristle = noise((i * STEP * BRISTLE + load, travel, load))
        if abs(across) > sqrt(tip) * (0.82 + 0.36 * bristle) or bristle < 0.34 * t * t:
            continue
        ridge = 0.35 * smoothstep(0.55, 0.95, abs(across))
        shade = 1 + 0.42 * (bristle - 0.5)
        for channel in range(3):
            color[row, column, channel] = stroke[4 + channel] * shade
        relief[row, column] = 0.6 * relief[row, column] + half * (0.10 * bristle + 0.11 * ridge)


@cached(**FAST)
def _paint(color: np.ndarray, relief: np.ndarray, field: np.ndarray, strokes: np.ndarray) -> None:
    for k in range(len(strokes)):
        x, y = strokes[k, 0], strokes[k, 1]
        steps = int(strokes[k, 2] / STEP)
        for i in range(steps):
            u, v = _follow(field, x, y)
            _lay(color, relief, (x, y), (u, v), strokes[k], i / steps)
            x += STEP * u
            y += STEP * v


def paint(
    ground: Float[np.ndarray, "H W 3"],
    field: Float[np.ndarray, "H W 2"],
    strokes: Float[np.ndarray, "S 8"],
) -> UInt8[np.ndarray, "H W 3"]:
    """Paint strokes in order over a ground and light the relief they leave.

    Args:
        ground: sRGB in 0..1 under the strokes.
        field: Direction (x, y) that a brush follows at each pixel, of any length.
        strokes: Start x and y, length and half width in pixels, red, green and blue, and a
            number that tells this brush load from the others.

    Returns:
        The painting, sRGB.
    """
    color, relief = ground.astype(np.float64), np.zeros(ground.shape[:2])
    _paint(color, relief, np.ascontiguousarray(field, np.float64), strokes)
    relief = cv2.GaussianBlur(relief, (0, 0), 0.8)
    dy, dx = np.gradient(relief)
    normal_z = 1 / np.sqrt(1 + dx**2 + dy**2)
    lit = (LIGHT[2] - LIGHT[0] * dx - LIGHT[1] * dy) * normal_z / LIGHT[2]
    shine = 0.30 * np.clip(lit - 1.25, 0, 1) ** 2
    shaded = color * (0.45 + 0.55 * lit.clip(0.2, 1.8))[..., None] + shine[..., None]
    return (cv2.GaussianBlur(shaded, (0, 0), 0.6).clip(0, 1) * 255).round().astype(np.uint8)


SIZE = 576  # pixels along a side of a picture
NIGHT = ("#040a26", "#0a1f66", "#1145b0", "#1b7fd0", "#3fc0dd", "#b4ecdf", "#fbeaa0")
STAR = ("#fffbe0", "#ffe45c", "#ffb52e", "#f2e28a", "#58c4d6", "#1b7fd0")
EMBER = ("#fff0c4", "#ffcf6b", "#ff9a2b", "#f0571d", "#c9202a", "#8c1030", "#4d0a2c")
TIDE = ("#032a33", "#06525a", "#0e8584", "#3fb5a2", "#a5dcc4", "#fff3d6")

# x, y and radius, as fractions of the picture's side
WHIRLS = ((0.36, 0.44, 0.20), (0.66, 0.58, 0.13))
STARS = (
    (0.80, 0.20, 0.15),
    (0.14, 0.15, 0.10),
    (0.16, 0.82, 0.12),
    (0.50, 0.12, 0.07),
    (0.84, 0.86, 0.11),
    (0.46, 0.82, 0.07),
)
SUN = (0.66, 0.26)

Map = Float[np.ndarray, "H W"]
Cartoon = Float[np.ndarray, "H W 3"]
Strokes = Float[np.ndarray, "S 8"]


def _palette(colors: tuple[str, ...], t: Map) -> Cartoon:
    """Colours between the entries of a palette; 0 is its first and 1 its last."""
    table = np.array([[int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for c in colors])
    stops = np.linspace(0, 1, len(colors))
    return np.stack([np.interp(t, stops, channel) for channel in table.T], axis=-1)


def _clouds(cells: int, rng: np.random.Generator) -> Map:
    """Smooth noise in 0..1 with about `cells` hills along a side."""
    hills = cv2.resize(rng.random((cells, cells)), (SIZE, SIZE), interpolation=cv2.INTER_CUBIC)
    return (hills - hills.min()) / np.ptp(hills)


def _grid() -> tuple[Map, Map]:
    """The x and y of every pixel, 0..1 from the upper left corner."""
    y, x = np.indices((SIZE, SIZE)) / SIZE
    return x, y


def _wave(phase: Map) -> Map:
    """Triangle wave of period 1 between 0 and 1."""
    return 1 - np.abs(2 * (phase % 1) - 1)


def _contours(potential: Map) -> Float[np.ndarray, "H W 2"]:
    """Direction along the contours of a potential: its curl."""
    along_y, along_x = np.gradient(potential)
    return np.stack([along_y, -along_x], axis=-1)


def _layer(
    cartoon: Cartoon,
    rng: np.random.Generator,
    *,
    spacing: float,
    length: float,
    half_width: float,
    where: Map | None = None,
) -> Strokes:
    """Strokes of one brush on a jittered grid, in random order, coloured by the cartoon.

    `where` is the chance that a stroke is painted at all.
    """
    starts = np.arange(-length / 2, SIZE, spacing)
    x, y = (
        g.ravel() + rng.uniform(-0.6, 0.6, g.size) * spacing for g in np.meshgrid(starts, starts)
    )
    column, row = (v.clip(0, SIZE - 1).astype(int) for v in (x, y))
    colors = cartoon[row, column]
    colors = colors * rng.normal(1, 0.12, (len(x), 1)) + rng.normal(0, 0.03, (len(x), 3))
    sizes = rng.uniform(0.7, 1.3, (len(x), 2)) * (length, half_width)
    loads = rng.uniform(0, 500, len(x))
    strokes = np.column_stack([x, y, sizes, colors.clip(0, 1), loads])
    chosen = rng.permutation(len(x))
    if where is not None:
        chosen = chosen[rng.random(len(x)) < where[row, column][chosen]]
    return strokes[chosen]


def swirling_night(seed: int = 0) -> UInt8[np.ndarray, "H W 3"]:
    """Long impasto strokes that follow whirls: deep blues and cyan around yellow stars."""
    rng = np.random.default_rng(seed)
    x, y = _grid()
    potential = 0.35 * _clouds(4, rng) + 0.25 * (y + 0.12 * np.sin(2 * np.pi * (x + 0.1)))
    for cx, cy, r in (*WHIRLS, *STARS):
        potential += 2.8 * r * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (0.8 * r) ** 2)
    bands = _wave(potential * 7 + 0.4 * _clouds(9, rng))
    cartoon = _palette(NIGHT, (0.06 + 0.62 * bands**1.4 + 0.2 * (_clouds(6, rng) - 0.4)).clip(0, 1))
    for cx, cy, r in STARS:
        distance = np.hypot(x - cx, y - cy) / r
        glow = np.clip(3.5 * (1 - distance), 0, 1)[..., None]
        cartoon = (1 - glow) * cartoon + glow * _palette(STAR, distance)
    rare = 0.15 + 0.6 * bands
    strokes = [
        _layer(cartoon * 0.75, rng, spacing=15.0, length=90.0, half_width=13.0),
        _layer(cartoon, rng, spacing=11.0, length=64.0, half_width=7.5),
        _layer(cartoon * 1.08, rng, spacing=13.0, length=44.0, half_width=4.5, where=rare),
    ]
    return paint(cartoon * 0.4, _contours(potential), np.concatenate(strokes))


def burning_tide(seed: int = 0) -> UInt8[np.ndarray, "H W 3"]:
    """Short slabs of the palette knife: rings of embers around a sun over a teal sea."""
    rng = np.random.default_rng(seed)
    x, y = _grid()
    sun = np.hypot(x - SUN[0], y - SUN[1]) + 0.02 * _clouds(7, rng)
    swell = 0.045 * np.sin(2 * np.pi * (1.6 * x + 1.1 * y))
    swell += 0.03 * np.sin(2 * np.pi * (3.7 * x - y))
    depth = y + swell + 0.05 * _clouds(5, rng) - 0.60
    crests = _wave(depth * 8 / (0.75 + depth.clip(0)))
    sky = _palette(EMBER, 0.6 * sun + 0.42 * _wave(sun * 6.5) * (sun > 0.10))
    water = depth[..., None] > 0
    cartoon = np.where(water, _palette(TIDE, crests**1.3), sky)
    field = np.where(water, _contours(depth), _contours(sun))
    glint = np.exp(-(((x - SUN[0]) / 0.10) ** 2)) * water[..., 0]
    strokes = [
        _layer(cartoon * 0.7, rng, spacing=14.0, length=46.0, half_width=11.0),
        _layer(cartoon, rng, spacing=10.0, length=26.0, half_width=7.0),
        _layer(cartoon * 1.1, rng, spacing=17.0, length=20.0, half_width=5.0),
        _layer(_palette(EMBER, sun), rng, spacing=16.0, length=28.0, half_width=5.0, where=glint),
    ]
    return paint(cartoon * 0.3, field, np.concatenate(strokes))


def scales(seed: int = 0) -> UInt8[np.ndarray, "H W 3"]:
    """Overlapping scales in greens and ochres, as of a lizard: a tiling, the same for all seeds."""
    across = 9
    y, x = np.indices((SIZE, SIZE), dtype=np.float32) * across / SIZE
    image = np.zeros((SIZE, SIZE, 3), np.float32)
    colors = np.array([[0.10, 0.30, 0.16], [0.83, 0.64, 0.22], [0.20, 0.52, 0.34]], np.float32)
    for row in range(-2, 2 * across + 2):  # lower rows lie over upper ones
        shift = 0.5 * (row % 2)
        column = np.floor(x - shift)
        distance = np.hypot(x - shift - column - 0.5, y - 0.5 * row)
        shade = np.clip(1.25 - 1.1 * distance, 0, 1)[..., None]
        colour = colors[(column.astype(int) * 2 + row) % 3] * shade + 0.12 * (1 - shade)
        ridge = (distance > 0.44)[..., None]
        inside = (distance < 0.55) & (y >= 0.5 * row)
        image = np.where(inside[..., None], np.where(ridge, 0.05, colour), image)
    return (image.clip(0, 1) * 255).round().astype(np.uint8)


PAINTINGS = {"swirling_night": swirling_night, "burning_tide": burning_tide, "scales": scales}
