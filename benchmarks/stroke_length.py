"""How long strokes are in pixels: how far the detail that painting adds goes with itself.

The distance at which the autocorrelation of what was added to the object's lightness falls to one
half; the mean over four held-out views. What its colours before explain (its own pattern,
recoloured) does not count, nor does what changes slowly. It compares settings of one painting in
one size: as paintings have detail of every size, larger strokes need not have a larger length.
"""

import math

import cv2
import torch
from torch import Tensor

from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.stylization.views import ObjectBox

SLOW = 0.25  # of the object's length: what changes more slowly is no stroke
LEVEL = 0.5  # of the autocorrelation
VIEWS = 4


def stroke_length(before: Splats, after: Splats, picked: Tensor, boxes: list[ObjectBox]) -> float:
    """Pixels from one half of a stroke to the other, the mean over some views."""
    lengths = [
        _length(before, after, picked, b.camera, b.length) for b in evenly_spaced(boxes, VIEWS)
    ]
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
