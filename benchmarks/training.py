"""Held-out quality and the depths that pixels mix, after fixed steps or times of training.

    .venv/bin/python benchmarks/training.py                          # four scenes, 3,000 steps
    .venv/bin/python benchmarks/training.py --seconds 60 150 --scenes fox --joint-factor 1.6
    .venv/bin/python benchmarks/training.py --settings '{"color_correction": "on"}'
    .venv/bin/python benchmarks/training.py --scenes nerf_synthetic/lego --side 800 --seconds 600 \
        --max-gaussians 300000 --settings '{"background": "white"}'  # NeRF's own test views
    .venv/bin/python benchmarks/training.py --scenes nerf_llff_data/fern --side 1008 --seconds 150

Compiling, reading photos and evaluating do not count as time. Every 8th view is held out, or those
that the scene's files hold out. Cut-outs are compared on the background of the settings. Colours
are trained alone; labels lifted onto them change none. Where photos differ in exposure, compare
PSNRs with colours fitted, each half of a view by the other. `larger` is the PSNR at the size that
`train` has scenes painted and evaluated at, without and with its widening of Gaussians for that.

Where one Gaussian hides all behind it, a pixel has one depth. The scatter is the deviation of the
depths of what a pixel mixes from their mean, in units of a pixel's size there: its median over the
pixels of objects, and over the others, in the views that have masks.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isnan, nan
from pathlib import Path
from time import perf_counter, process_time

import torch
import tyro
from bench import DATA, calibration_ms, capture_of, machine, table
from jaxtyping import Float
from torch import Tensor

import stylesplat as ss
from stylesplat.evaluation.photos import Fits, evaluate_views
from stylesplat.rendering.weights import COVERED, TINY_COVERAGE, composite
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, Capture, Mask
from stylesplat.scene.projection import depths_of
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit
from stylesplat.training.photo_size import painting_downscale, widened
from stylesplat.training.state import State
from stylesplat.training.views import split_views

JUDGED = 8  # views whose scatter is measured
SCORES = ("psnr", ".2f"), ("ssim", ".4f")
COLUMNS = ("scene", "run", "seed", "steps", "s", "CPU ms a step", "Gaussians", "PSNR", "SSIM")
COLUMNS += ("PSNR, colours fitted", "larger", "scatter on objects, px", "elsewhere, px")


@dataclass(frozen=True)
class Options:
    """What to train."""

    scenes: tuple[str, ...] = ("fox", "desk", "toy", "doll")
    """Folders, those in `../shared/data` by name; photos without poses are posed once, and kept in
    `out`."""
    side: int = 480
    """Pixels of the photos' longer side."""
    steps: int = 3000
    """Of each run."""
    seconds: tuple[float, ...] = ()
    """Training times, in place of a number of steps."""
    joint_factor: float = 0
    """Time, over that without, of one more run that learns identities, too."""
    max_gaussians: int = 50_000
    """Gaussians at most."""
    seeds: tuple[int, ...] = (0,)
    """Of everything random."""
    settings: str = "{}"
    """More of `TrainConfig`, as JSON."""


def object_masks(capture: Capture) -> Iterator[tuple[Cameras, Mask]]:
    """Some views, and where they show objects: nowhere in a scene without masks."""
    maps = capture.label_maps or ()
    rows = [row for row in range(len(maps)) if maps[row] is not None] or range(len(capture))
    for row in evenly_spaced(rows, JUDGED):
        camera, labels = capture.cameras[row], capture.labels(row)
        empty = torch.zeros(*camera.size[::-1], dtype=torch.bool)
        yield camera, empty if labels is None else labels != BACKGROUND


@torch.no_grad()
def depth_scatter(splats: Splats, camera: Cameras) -> Float[Tensor, "H W"]:
    """The deviation of the depths that each pixel mixes, over the size of a pixel at their mean.

    NaN where a pixel is not covered.
    """
    depths = depths_of(splats.means, camera).clamp(min=0)
    unit = depths[depths > 0].median()  # sums of squares of numbers near 1 lose least
    powers = torch.stack([(depths / unit) ** power for power in range(3)], dim=1)
    covered, first, second = composite(splats, camera, powers).double().unbind(dim=-1)
    is_covered, covered = covered > COVERED, covered.clamp(min=TINY_COVERAGE)
    mean = (first / covered).clamp(min=TINY_COVERAGE)
    deviation = (second / covered - mean.square()).clamp(min=0).sqrt()
    return (float(camera.Ks[0, 0, 0]) * deviation / mean).where(is_covered, torch.nan)


def median_scatters(capture: Capture, splats: Splats) -> list[str]:
    """The median over the pixels of objects and over the others."""
    inside, outside = list[Tensor](), list[Tensor]()
    for camera, mask in object_masks(capture):
        found = depth_scatter(splats, camera)
        inside.append(found[mask])
        outside.append(found[~mask])
    both = (torch.cat(some) for some in (inside, outside))
    medians = [float(some.nanmedian()) if len(some) else nan for some in both]
    return ["-" if isnan(median) else f"{median:.1f}" for median in medians]


def larger_psnrs(splats: Splats, capture: Capture, config: TrainConfig) -> str:
    """Of the same views, where photos have more pixels than were trained on."""
    factor = painting_downscale(capture.full_cameras)
    if factor >= capture.downscale or capture.path is None:
        return "-"
    larger = replace(ss.load(capture.path, downscale=factor), label_maps=None)
    rows, held_out = split_views(larger, config.test_every)
    wide = widened(splats, larger.cameras[[*rows]], capture.downscale / factor)
    both = (
        evaluate_views(each, larger, held_out, background=config.background)["psnr"]
        for each in (splats, wide)
    )
    return ", ".join(f"{psnr:.2f}" for psnr in both)


def trained(scene: str, capture: Capture, config: TrainConfig, *, identities: bool) -> list[object]:
    """A row of the table."""
    photos = capture if identities else replace(capture, label_maps=None)
    run = f"{config.max_seconds:.0f} s" if config.max_seconds else "steps"
    run += ", joint" if identities else ""
    clocks = list[tuple[int, float, float]]()

    def report(state: State, loss: float, train_psnr: float) -> None:
        clocks.append((state.step, state.seconds, process_time()))

    started = perf_counter()
    splats = fit(photos, config, on_progress=report).splats.detach()
    print(f"{scene} took {perf_counter() - started:.0f} s in all", flush=True)
    (first, _, begun), (steps, seconds, ended) = clocks[0], clocks[-1]
    held_out = split_views(photos, config.test_every)[1]
    quality = evaluate_views(
        splats, photos, held_out, fits=Fits(colors=True), background=config.background
    )
    spent = f"{1e3 * (ended - begun) / max(steps - first, 1):.1f}"
    head = [scene, run, config.seed, f"{steps:,}", f"{seconds:.0f}", spent, f"{len(splats):,}"]
    figures = [f"{quality[f'{name}_unfitted']:{digits}}" for name, digits in SCORES]
    figures += [f"{quality['psnr']:.2f}", larger_psnrs(splats, capture, config)]
    return [*head, *figures, *median_scatters(capture, splats)]


def main(options: Options) -> None:
    """Print the table."""
    print(f"{options.side} pixels, {machine()}, calibration loop {calibration_ms():.0f} ms")
    rows = list[list[object]]()
    for scene in options.scenes:
        folder = Path(scene) if Path(scene).is_dir() else DATA / scene
        capture = capture_of(folder, capture_of(folder).cameras.shrink_to(options.side))
        for seed in options.seeds:
            config = TrainConfig(
                steps=options.steps, max_gaussians=options.max_gaussians, seed=seed
            )
            config = replace(config, **json.loads(options.settings))
            configs = [replace(config, max_seconds=s) for s in options.seconds] or [config]
            for each in configs:
                rows.append(trained(scene, capture, each, identities=False))
                if options.joint_factor > 0 and each.max_seconds is not None:
                    longer = options.joint_factor * each.max_seconds
                    joint = replace(each, max_seconds=longer)
                    rows.append(trained(scene, capture, joint, identities=True))
    print(f"calibration loop {calibration_ms():.0f} ms after")
    print(table(COLUMNS, rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
