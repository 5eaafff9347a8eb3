"""The size of strokes: how far the detail that painting adds goes with itself.

    .venv/bin/python benchmarks/strokes.py --scene SCENE --object OBJECT --painting FILE

For some scales and patterns: the distance in pixels at which the autocorrelation of what was added
to the object's lightness, its slow changes taken off, falls to one half; the mean over four
held-out views. It should double when the scale does, within a quarter.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from bench import table
from torch import Tensor
from torch.nn import functional as F

import stylesplat as ss
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.shares import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.stylization.object_views import Box, find_boxes
from stylesplat.stylization.paint_objects import paint
from stylesplat.stylization.style_config import Pattern, StyleConfig
from stylesplat.stylization.style_images import read_style

SLOW = 8  # parts of the object's length: what changes more slowly is no stroke
LEVEL = 0.5  # of the autocorrelation
VIEWS = 4


@dataclass(frozen=True)
class Options:
    """What to paint, and how."""

    scene: Path
    """A scene with objects."""
    painting: Path
    """A picture."""
    object: int = 1
    """A label id."""
    scales: tuple[float, ...] = (1.0, 2.0, 4.0)
    """With the pattern that is the default."""
    patterns: tuple[Pattern, ...] = ("small", "medium", "large")
    """With the scale that is the default."""


def stroke_length(before: Splats, after: Splats, picked: Tensor, boxes: list[Box]) -> float:
    """Pixels from one half of a stroke to the other, the mean over some views."""
    lengths = [_length(before, after, picked, b.camera, b.length) for b in evenly(boxes, VIEWS)]
    return sum(lengths) / len(lengths)


def _length(before: Splats, after: Splats, picked: Tensor, camera: Cameras, size: float) -> float:
    mask = (coverage(before, camera, picked) > COVERED).float()
    images = (rasterize(splats, camera)[0][0].mean(dim=2) for splats in (after, before))
    added = (next(images) - next(images)) * mask
    side = 2 * int(size / SLOW / 2) + 1
    slow = _blurred(added, side) / _blurred(mask, side).clamp(min=1e-6)
    detail = (added - slow) * mask
    pairs = _with_itself(mask)
    products = _with_itself(detail) / pairs.clamp(min=1)
    y, x = (torch.fft.fftfreq(n, 1 / n) for n in products.shape)
    radii = torch.hypot(y[:, None], x[None]).round().long()
    by_radius = [float(products[radii == r].mean() / products[0, 0]) for r in range(side)]
    far = next((r for r, value in enumerate(by_radius) if value < LEVEL), side - 1)
    near = by_radius[far - 1]
    return far - 1 + (near - LEVEL) / (near - by_radius[far])


def _blurred(image: Tensor, side: int) -> Tensor:
    for _ in range(2):
        image = F.avg_pool2d(image[None], side, 1, side // 2, count_include_pad=True)[0]
    return image


def _with_itself(image: Tensor) -> Tensor:
    size = [2 * n for n in image.shape]  # so that nothing meets itself from behind
    return torch.fft.irfft2(torch.fft.rfft2(image, size).abs().square(), size)


@torch.no_grad()
def main(options: Options) -> None:
    """Print the table."""
    scene = ss.open(options.scene)
    training, held_out = scene.working_views()
    picked = pick(scene.splats, object_id=options.object)
    boxes = find_boxes(scene.splats, held_out or training, picked)
    style = read_style(options.painting)
    configs = {f"scale {scale:g}": StyleConfig(scale=scale) for scale in options.scales}
    configs |= {pattern: StyleConfig(pattern=pattern) for pattern in options.patterns}
    rows = []
    for name, config in configs.items():
        styled = paint(scene.splats, training, picked, style, config=config)
        rows.append([name, f"{stroke_length(scene.splats, styled, picked, boxes):.2f}"])
    print(table(["settings", "length, px"], rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
