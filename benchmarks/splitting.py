"""What splitting costs before one colour is changed: the scene split, fitted, and nothing else.

    .venv/bin/python benchmarks/splitting.py SCENE OBJECT [--capture CAPTURE] [--downscale F]

In held-out views, over the pixels that the object covers by more than half, and in a band of 6
pixels along its contour: PSNR against the scene before, and with the capture against its photos.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from bench import machine, table
from torch import Tensor
from torch.nn import functional as F

import stylesplat as ss
from stylesplat.metrics.psnr import psnr
from stylesplat.rendering.shares import COVERED, colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.choose import find_object
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.object_views import cut_views, find_boxes, typical_length
from stylesplat.stylization.overflow import without_overflow
from stylesplat.stylization.refit import refit
from stylesplat.stylization.split import Split, split_large
from stylesplat.stylization.style_config import DEFAULT_NETWORK, SIZES, StyleConfig

BAND = 6  # pixels

SPLIT_VIEWS = 12  # in which sizes are looked up before Gaussians are split


@dataclass(frozen=True)
class Options:
    """Which object of which scene."""

    scene: tyro.conf.Positional[Path]
    """A trained scene with held-out views."""
    object: tyro.conf.Positional[str]
    """A name or a label id."""
    capture: Path | None = None
    """Whose photos to compare with."""
    downscale: float = 1.0
    """How many times smaller than they are the photos were in training."""


def areas(covered: Tensor) -> tuple[Tensor, Tensor]:
    """Inside the object, and along its contour."""
    inside = (covered[None] > COVERED).float()
    wide = F.max_pool2d(inside, 2 * BAND + 1, 1, BAND)
    narrow = 1 - F.max_pool2d(1 - inside, 2 * BAND + 1, 1, BAND)
    return inside[0] > 0, (wide - narrow)[0] > 0


def figures(
    splats: Splats, before: Splats, picked: Tensor, cameras: Cameras, photos: list[Tensor]
) -> list[str]:
    """Inside and contour against the scene before; inside against the photos."""
    found = list[list[float]]()
    for index in range(len(cameras)):
        was, covered = colors_and_coverage(before, cameras[index], picked)
        image, _ = colors_and_coverage(splats, cameras[index], torch.ones(len(splats)).bool())
        inside, contour = areas(covered[..., 0])
        if inside.any():
            against = [(was, inside), (was, contour)]
            against += [(photos[index], inside)] if photos else []
            found.append([float(psnr(image.clamp(0, 1)[m], t.clamp(0, 1)[m])) for t, m in against])
    return [f"{sum(row) / len(row):.2f}" for row in zip(*found, strict=True)]


def timed(work: Callable[[], Split]) -> tuple[Split, float]:
    """What some work made, and its seconds of all cores together."""
    start = time.process_time()
    made = work()
    return made, time.process_time() - start


def main(options: Options) -> None:
    """Print the table."""
    scene = ss.open(options.scene)
    training, held_out = scene.working_views()
    if held_out is None:
        raise SystemExit(f"{options.scene} has no held-out views.")
    splats, picked = scene.splats, find_object(scene, options.object)
    photos = list[Tensor]()
    if options.capture:
        capture = ss.load(options.capture, downscale=options.downscale)
        photos = [capture.photos[capture.cameras.index(n)] / 255 for n in held_out.names]
    boxes = find_boxes(splats, training, picked)
    config = StyleConfig()
    cells = [load_weights(DEFAULT_NETWORK, depth=3).cells(block) for block in config.layers]
    zoom = (SIZES[config.pattern] or math.inf) / typical_length(boxes)
    few = evenly(boxes, SPLIT_VIEWS)
    views = cut_views(splats, few, picked, cells, zoom=zoom, max_memory=math.inf)
    whole = Split(splats, torch.arange(len(splats)))
    every = training + held_out
    growth = config.growth(int(picked.sum()))
    split, a = timed(lambda: split_large(splats, picked, views, max_growth=growth))
    alone, b = timed(lambda: without_overflow(splats, split, picked, every))
    fitted, c = timed(lambda: refit(splats, split, picked, boxes))
    tidy, d = timed(lambda: without_overflow(splats, fitted, picked, every))
    made = {"before": (whole, 0.0), "split": (alone, a + b), "split and fitted": (tidy, a + c + d)}
    rows = list[list[str]]()
    for name, (each, seconds) in made.items():
        found = figures(each.splats, splats, picked, held_out, photos)
        rows.append([name, f"{len(each.parents):,}", f"{seconds:.1f}", *found])
    print(machine())
    head = ["", "Gaussians", "CPU s", "inside", "contour", *(["photos"] if photos else [])]
    print(table(head, rows))


if __name__ == "__main__":
    main(tyro.cli(Options))
