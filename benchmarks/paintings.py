"""Three pictures that a style has to be true to: a line print, dots, flat areas of colour.

Lines must give lines, dots dots, flat colours flat areas, which paintings do not tell so clearly.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import torch
from bench import STYLES
from jaxtyping import Float, UInt8

from stylesplat.io.images import write_image

SIZE = 900  # pixels along a side
SHIPPED = {
    "night": "van_gogh_starry_night_1024.jpg",
    "kandinsky": "kandinsky_composition_vii_1071.jpg",
    "hassam": "hassam_south_ledges_1070.jpg",
    "monet": "monet_water_lilies_1100.jpg",
    "raiko": "ukiyo_e_raiko_1100.jpg",
}
Picture = UInt8[np.ndarray, "H W 3"]


def line_print(seed: int = 0) -> Picture:
    """Engraved lines: dark ink on paper, thicker where it is darker, crossed where darkest."""
    rng, size = np.random.default_rng(seed), 2 * SIZE
    tone = _hills(4, size, rng)
    ink = np.zeros((size, size))
    for cells, least in ((3, 0.0), (4, 0.55)):
        way = _hills(cells, size, rng) + 0.8 * np.linspace(0, 1, size)[:, None]
        if least:
            way = _hills(cells, size, rng) + 0.8 * np.linspace(0, 1, size)[None]
        down, right = np.gradient(way)
        slope = np.hypot(down, right) * size
        line = 0.5 + 0.5 * np.cos(2 * np.pi * 45 * way)
        width = np.clip((tone - least) / (1 - least), 0, 1) * (0.15 + 0.75 * (tone > least))
        edge = 0.06 * np.clip(slope, 0.3, 2)  # as sharp wherever lines are closer
        ink = np.maximum(ink, np.clip(0.5 + (line - 1 + width) / edge / 2, 0, 1) * (width > 0.02))
    ink = cv2.resize(ink, (SIZE, SIZE), interpolation=cv2.INTER_AREA)[..., None]
    return _bytes(ink * (0.10, 0.09, 0.13) + (1 - ink) * (0.93, 0.89, 0.78))


def dots(seed: int = 0) -> Picture:
    """Round dots of pure colours, mixed as pointillists do, over hills of light and shade."""
    rng, radius = np.random.default_rng(seed), 7
    palette = np.array([[24, 52, 130], [60, 140, 190], [240, 196, 60], [226, 110, 50],
                        [70, 130, 60], [250, 236, 200], [140, 50, 90]])  # fmt: skip
    warm = _hills(5, SIZE, rng)
    picture = np.full((SIZE, SIZE, 3), (236, 226, 200), np.uint8)
    order = np.array([0, 6, 1, 4, 3, 2, 5])  # dark to light
    steps = np.arange(0, SIZE, int(1.5 * radius))
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    for x, y in rng.permutation(places + rng.integers(-3, 4, places.shape)):
        light = warm[min(max(y, 0), SIZE - 1), min(max(x, 0), SIZE - 1)] + rng.normal(0, 0.16)
        color = palette[order[int(np.clip(light * len(order), 0, len(order) - 1))]]
        size = radius * rng.uniform(0.75, 1.0)
        middle = (int(16 * x), int(16 * y))
        cv2.circle(picture, middle, int(16 * size), color.tolist(), -1, cv2.LINE_AA, 4)
    return picture


def flat_areas(seed: int = 0) -> Picture:
    """Cut paper: fields of a few flat colours, and rounded shapes of others upon them."""
    rng = np.random.default_rng(seed)
    palette = np.array([[0.13, 0.24, 0.55], [0.93, 0.72, 0.16], [0.80, 0.20, 0.16],
                        [0.10, 0.45, 0.36], [0.95, 0.90, 0.80], [0.12, 0.11, 0.14]])  # fmt: skip
    size = 2 * SIZE
    cells = rng.integers(0, len(palette), (6, 5))
    fields = np.kron(cells, np.ones((size // 6, size // 5), int))
    picture = palette[fields]
    for color in rng.permutation(palette):
        shape = _hills(7, size, rng) > 0.68
        picture[shape] = color
    return _bytes(cv2.resize(picture, (SIZE, SIZE), interpolation=cv2.INTER_AREA))


DRAWN: Mapping[str, Callable[[], Picture]] = {
    "lines": line_print,
    "dots": dots,
    "flat": flat_areas,
}


def find_painting(name: str, folder: Path) -> Path:
    """The file of a painting, which is drawn into a folder if it has to be.

    Args:
        name: One of `SHIPPED` or `DRAWN`, or a file.
        folder: Where drawn ones are kept.
    """
    if name in SHIPPED:
        return STYLES / SHIPPED[name]
    if name not in DRAWN:
        return Path(name)
    path = folder / f"{name}.png"
    if not path.is_file():
        write_image(torch.from_numpy(DRAWN[name]()), path)
    return path


def _hills(cells: int, size: int, rng: np.random.Generator) -> Float[np.ndarray, "_ _"]:
    """Smooth noise in 0..1 with about so many hills along a side."""
    hills = cv2.resize(rng.random((cells, cells)), (size, size), interpolation=cv2.INTER_CUBIC)
    return (hills - hills.min()) / np.ptp(hills)


def _bytes(colors: Float[np.ndarray, "H W 3"]) -> Picture:
    return (colors.clip(0, 1) * 255).round().astype(np.uint8)
