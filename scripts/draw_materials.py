"""Draws the materials that the package has as styles, such as `material:bronze`.

`python scripts/draw_materials.py` writes src/stylesplat/io/materials/NAME.jpg. A recipe
holds the digest of its picture, so that recipes with an older drawing are refused.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy.spatial import KDTree

FOLDER = Path(__file__).parents[1] / "src/stylesplat/io/materials"
SIDE = 512  # pixels
QUALITY = 80  # of JPEG: no file is larger than 60 KB
Random = np.random.RandomState  # draws the same numbers in all versions of numpy
Plane = Float[np.ndarray, "512 512"]
Colors = Float[np.ndarray, "512 512 3"]


def noise(random: Random, *widths: int | float, across: int | float = 1) -> Plane:
    """Smooth periodic noise of unit deviation; spots are `across` times as long along x."""
    y, x = np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE) * across
    total = np.zeros((SIDE, SIDE))
    for width in widths:
        white = np.fft.rfft2(random.standard_normal((SIDE, SIDE)))
        smooth = np.fft.irfft2(white * np.exp(-2 * (np.pi * width) ** 2 * (x**2 + y**2)))
        total += smooth / smooth.std() * width**0.5
    return (total - total.mean()) / total.std()


def ramp(values: Plane, *colors: str) -> Colors:
    """The colours that lie between these, which are evenly spaced from 0 to 1."""
    stops = np.array([[*bytes.fromhex(color)] for color in colors]) / 255
    places = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(values, places, channel) for channel in stops.T], axis=-1)


def mirrored(height: Plane) -> tuple[Plane, Plane]:
    """The place that a polished surface shows, from -1 to 1 along x and y of what is before it."""
    down, right = np.gradient(height)
    facing = 2 / (1 + down**2 + right**2)  # twice the square of the normal's part to the viewer
    return -right * facing, -down * facing


def bronze(random: Random) -> Colors:
    """Polished relief that mirrors two lamps; verdigris in the hollows, and specks of it."""
    relief = noise(random, 44, 22)
    x, y = mirrored(26 * relief + 0.25 * noise(random, 5, 10))
    lamp = np.exp(-((x + 0.45) ** 2 + (y + 0.55) ** 2) / 0.1)
    second = np.exp(-((x - 0.75) ** 2 + (y - 0.55) ** 2) / 0.12)
    light = 0.3 - 0.22 * y - 0.08 * x + 0.75 * lamp + 0.25 * second
    metal = ramp(light, "120a06", "4a2a14", "96602c", "dba85a", "fff0cc")
    hollow = 1 / (1 + np.exp(4 * (relief + 1.65 + 0.35 * noise(random, 2, 5))))
    specks = 1 / (1 + np.exp(10 * (0.5 * relief + 2.3 + noise(random, 2, 3))))
    shade = 0.35 * light + 0.4 + 0.2 * noise(random, 1.5, 5)
    green = ramp(shade, "2d574c", "5a8f7c", "9cc7b0")
    return metal + 0.85 * np.maximum(hollow, specks)[..., None] * (green - metal)


def marble(random: Random) -> Colors:
    """Clouds of white and grey, with veins where noise crosses 0."""
    cloud, veins = noise(random, 60, 25, 8), np.zeros((SIDE, SIDE))
    for width, strength, sharpness in ((70, 1.0, 5), (35, 0.8, 8), (20, 0.4, 14)):
        warped = noise(random, width) + 0.12 * noise(random, 4, 9)
        veins += strength * np.exp(-sharpness * abs(warped)) * (0.6 + 0.4 * np.tanh(cloud))
    return ramp(0.86 + 0.09 * cloud - 0.75 * veins, "2c2f36", "7d8088", "cfcdca", "fbf9f5")


def gold_leaf(random: Random) -> Colors:
    """Crinkled foil: facets that mirror dark or light, and bright creases between them."""
    y, x = np.mgrid[:SIDE, :SIDE] + 3 * np.stack([noise(random, 9), noise(random, 9)])
    points = random.random_sample((260, 2)) * SIDE
    distances, near = map(np.asarray, KDTree(points).query(np.stack([y, x], axis=-1), k=2))
    facets = near[..., 0]
    crease = np.exp(-(distances[..., 1] - distances[..., 0]) / 2)
    down, right = random.standard_normal((2, len(points)))[:, facets]
    along = down * (y - points[facets, 0]) + right * (x - points[facets, 1])
    shine = 1 / (1 + np.exp(-4 * (0.8 * down + 0.03 * along + 0.7 * noise(random, 50, 20) - 0.9)))
    light = 0.36 + 0.1 * right + 0.004 * along + 0.5 * shine + 0.18 * crease
    return ramp(
        light + 0.03 * noise(random, 1, 3), "3a1e02", "8f5a0e", "d99e2b", "ffdf7e", "fffbe2"
    )


def clay(random: Random) -> Colors:
    """Terracotta with dents of thumbs, in which there are fine ridges."""
    y, x = np.mgrid[:SIDE, :SIDE]
    height = 4 * noise(random, 30, 12)
    for _ in range(45):
        (cy, cx), turn = random.random_sample(2) * SIDE, random.random_sample() * np.pi
        along = (x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)
        aside = (y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)
        dent = np.exp(-(((along / 46) ** 2 + (aside / 30) ** 2) ** 2))
        height = height * (1 - 0.8 * dent) - dent * (
            14 - 0.25 * np.sin(np.hypot(along + 90, aside))
        )
    down, right = np.gradient(height)  # the light comes from above left
    light = -(down + right) / np.sqrt(1 + down**2 + right**2) + 0.1 * noise(random, 0.7, 2, 5)
    return ramp(0.55 + 0.35 * light, "4a2016", "9a4f34", "c67a55", "ecb795")


def jade(random: Random) -> Colors:
    """Polished; soft clouds of pale green with milky streaks."""
    streaks = np.exp(-2 * noise(random, 34, 12, across=2) ** 2)
    cloud = 0.15 * noise(random, 60, 30, 12, 5) + 0.3 * streaks
    x, y = mirrored(20 * noise(random, 50, 24))
    lamp = np.exp(-((x + 0.45) ** 2 + (y + 0.55) ** 2) / 0.06)
    return ramp(0.34 + cloud + 0.55 * lamp, "1d5239", "4f9670", "93c6a0", "e4f2e0", "ffffff")


DRAWINGS = {"bronze": bronze, "marble": marble, "gold-leaf": gold_leaf, "clay": clay, "jade": jade}

if __name__ == "__main__":
    for name, draw in DRAWINGS.items():
        levels = (draw(Random(0)).clip(0, 1) * 255).round().astype(np.uint8)
        Image.fromarray(levels).save(FOLDER / f"{name}.jpg", quality=QUALITY, optimize=True)
