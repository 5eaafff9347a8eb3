"""How the time of a step grows with the image and with the number of Gaussians.

    .venv/bin/python benchmarks/scaling.py

Fox from 100x178 to 1080x1920 with 50,000 Gaussians; and with 5,000 to 500,000 at 540x960, where
Gaussians are left out, or split into smaller ones beside each other. The work is linear if
"ns per pair" does not grow: a pair is a pixel and a Gaussian that reaches its 4x4 block. Writes a
plot to `benchmarks/scaling.png`.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from bench import calibration_ms, capture, machine, median_ms, resized, step, table, trained_fox

from stylesplat.rendering import cpu
from stylesplat.rendering.gaussians import activated, views_of
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

PLOT = Path(__file__).parent / "scaling.png"
WIDTHS = (100, 180, 270, 540, 810, 1080)
COUNTS = (5_000, 15_000, 50_000, 150_000, 500_000)
BLOCK_PIXELS = 16


def pairs(splats: Splats, camera: Cameras) -> int:
    """How many times a Gaussian meets a pixel's block in the tile lists."""
    projected = cpu.project_gaussians(activated(splats), views_of(camera)[0])
    opacities, colors = splats.opacities.sigmoid(), splats.means
    tiled = cpu.sort_into_tiles(projected, opacities, colors, camera.size)
    return BLOCK_PIXELS * int(np.bitwise_count(tiled.lists.masks).sum())


def measure(splats: Splats, camera: Cameras) -> tuple[float, int]:
    """Milliseconds of a step, and its pairs."""
    return median_ms(lambda: step(splats, camera), repeats=7), pairs(splats, camera)


def row(name: str, splats: Splats, camera: Cameras, ms: float, met: int) -> list[object]:
    """A line of a table."""
    width, height = camera.size
    return [
        *(name, f"{len(splats):,}", f"{met / (width * height):.0f}", f"{met / 1e6:.1f} M"),
        *(f"{ms:.1f}", f"{1e6 * ms / met:.2f}"),
    ]


def plot(series: dict[str, tuple[list[int], list[float]]]) -> None:
    """Draw time over pairs on logarithmic axes, with a line of slope 1."""
    figure, axes = plt.subplots(figsize=(6, 4.5))
    for name, (met, times) in series.items():
        axes.loglog(met, times, "o-", label=name)
    met, times = next(iter(series.values()))
    ends = np.array([min(met), max(met)])
    axes.loglog(ends, times[-1] * ends / met[-1], "k:", label="linear")
    axes.set(xlabel="pairs of a pixel and a Gaussian", ylabel="ms per step")
    axes.legend()
    figure.tight_layout()
    figure.savefig(PLOT, dpi=100)


def main() -> None:
    """Print both tables and draw the plot."""
    print(f"{machine()}, calibration loop {calibration_ms():.0f} ms")
    trained, full = trained_fox(), capture("fox").cameras[0]
    by_size, by_count = [], []
    series: dict[str, tuple[list[int], list[float]]] = {
        "50,000 Gaussians, 100x178 to 1080x1920": ([], []),
        "540x960, 5,000 to 500,000 Gaussians": ([], []),
    }
    sizes, counts = series.values()
    for width in WIDTHS:
        camera = full.downscale(full.size[0] / width)
        ms, met = measure(trained, camera)
        by_size.append(row("x".join(map(str, camera.size)), trained, camera, ms, met))
        sizes[0].append(met)
        sizes[1].append(ms)
    for count in COUNTS:
        splats = resized(trained, count)
        ms, met = measure(splats, full)
        by_count.append(row("x".join(map(str, full.size)), splats, full, ms, met))
        counts[0].append(met)
        counts[1].append(ms)
    heads = ["image", "Gaussians", "overlap", "pairs", "ms", "ns per pair"]
    print(table(heads, by_size), table(heads, by_count), sep="\n\n")
    plot(series)
    print(f"\nPlot: {PLOT}")


if __name__ == "__main__":
    main()
