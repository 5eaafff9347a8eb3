"""The size of strokes: how far the detail that painting adds goes with itself.

    .venv/bin/python benchmarks/strokes.py --scene SCENE --object OBJECT --painting FILE

For some sizes of strokes (`--stroke-size`): the distance in pixels
at which the autocorrelation of what was added to the object's lightness falls to one half; the mean
over four held-out views. What its colours before explain (its own pattern, recoloured) does not
count, nor does what changes slowly. Noise of 1, 2, 4 and 8 times the size gives 1.5, 3.3, 6.5 and
12.4 on the demo's vase. It should double when the stroke size does, within a quarter.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import torch
import tyro
from bench import table
from torch import Tensor

import stylesplat as ss
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.shares import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.paint import paint
from stylesplat.stylization.style_image import read_style
from stylesplat.stylization.views import Box, find_boxes

SLOW = 0.25  # of the object's length: what changes more slowly is no stroke
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


def stroke_length(before: Splats, after: Splats, picked: Tensor, boxes: list[Box]) -> float:
    """Pixels from one half of a stroke to the other, the mean over some views."""
    lengths = [_length(before, after, picked, b.camera, b.length) for b in evenly(boxes, VIEWS)]
    return sum(lengths) / len(lengths)


def _length(before: Splats, after: Splats, picked: Tensor, camera: Cameras, size: float) -> float:
    mask = coverage(before, camera, picked) > COVERED
    old, new = (rasterize(splats, camera)[0][0].clamp(0, 1) for splats in (before, after))
    return detail_length(old, new, mask, size)


def detail_length(before: Tensor, after: Tensor, mask: Tensor, size: float) -> float:
    """Pixels at which what painting added goes half with itself.

    Args:
        before: [H, W, 3].
        after: [H, W, 3].
        mask: [H, W], the object.
        size: Its longer side, in pixels.
    """
    inside = mask.float()
    added = torch.zeros_like(inside)
    added[mask] = _unexplained(before[mask], after[mask])
    slow = _blurred(added, SLOW * size) / _blurred(inside, SLOW * size).clamp(min=1e-6)
    detail = (added - slow) * inside
    pairs = _with_itself(inside)
    products = _with_itself(detail) / pairs.clamp(min=1)
    y, x = (torch.fft.fftfreq(n, 1 / n) for n in products.shape)
    radii = torch.hypot(y[:, None], x[None]).round().long()
    last = math.ceil(size / 2)
    by_radius = [float(products[radii == r].mean() / products[0, 0]) for r in range(last + 1)]
    far = next((r for r, value in enumerate(by_radius) if value < LEVEL), last)
    near = by_radius[far - 1]
    return far - 1 + (near - LEVEL) / (near - by_radius[far])


def _unexplained(before: Tensor, after: Tensor) -> Tensor:
    """The lightness after that is no linear function of the colours before, for each pixel."""
    known = torch.cat([before, torch.ones_like(before[:, :1])], dim=1)
    light = after.mean(dim=1, keepdim=True)
    return (light - known @ torch.linalg.lstsq(known, light).solution)[:, 0]


def _blurred(image: Tensor, deviation: float) -> Tensor:
    return torch.from_numpy(cv2.GaussianBlur(image.numpy(), (0, 0), deviation))


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
    rows = []
    for name, config in configs.items():
        styled = paint(scene.splats, training, picked, style, config=config)
        rows.append([name, f"{stroke_length(scene.splats, styled, picked, boxes):.2f}"])
    print(table(["settings", "length, px"], rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
