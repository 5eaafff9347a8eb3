"""A loaded brush: strokes that follow a field of directions and leave a relief of bristles."""

from math import floor, sqrt
from typing import no_type_check

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from stylesplat.demo.noise import noise
from stylesplat.demo.vectors import FAST, kernel, smoothstep
from stylesplat.rendering.kernels.jit import cached

STEP = 0.5  # pixels between neighbouring bristles, and between stamps along a stroke
BRISTLE = 0.42  # bristle tracks per pixel
DRAG = 0.035  # how quickly a bristle's load changes per pixel of travel
LIGHT = (-0.55, -0.65, 0.53)  # towards the lamp that rakes over the canvas; y is down


@no_type_check
@kernel
def _follow(field: np.ndarray, x: float, y: float) -> tuple[float, float]:
    """Unit direction of the field at the nearest pixel."""
    row = min(max(int(y), 0), field.shape[0] - 1)
    column = min(max(int(x), 0), field.shape[1] - 1)
    u, v = field[row, column, 0], field[row, column, 1]
    norm = sqrt(u * u + v * v) + 1e-9
    return u / norm, v / norm


@no_type_check
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


@no_type_check
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
