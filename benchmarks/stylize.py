"""The style engine: how fast, how exact, how much memory; against a naive loop.

    .venv/bin/python benchmarks/stylize.py [--naive-steps 300]

Fox at 540x960, trained once; VGG19; Starry Night. The naive loop is the method as published, on
our own rasteriser: every step renders the whole frame with gradients, takes its features in
float32 and searches all style features for every pixel's. It starts from the same colours and has
the same rates. Targets: 20 s from command to scene, a step 50 times faster than the
naive one, two objects in less than 1.6 times one, less than 3 GB, shortcuts within 2 %.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple
from unittest.mock import patch

import torch
import tyro
from bench import (
    MIB,
    STYLES,
    calibration_ms,
    machine,
    median_ms,
    peak_memory,
    style_network,
    table,
    trained_scene,
)
from numba import get_num_threads
from torch import Tensor
from torch.nn import functional as F
from tqdm import tqdm

import stylesplat as ss
from stylesplat.evaluation.style import LENGTH, measure_painted, object_nnfm, renders
from stylesplat.rendering import cpu
from stylesplat.rendering.gaussians import activated, views_of
from stylesplat.rendering.kernels import blend, blend_backward, vecs
from stylesplat.rendering.linear import contributions
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import StyleIndex, nearest_rows, nnfm_loss
from stylesplat.stylization.optimize import FINAL_RATE, paint_steps
from stylesplat.stylization.paint import Painted, paint_context, paint_objects
from stylesplat.stylization.style_image import read_style, style_features
from stylesplat.stylization.target import PaintContext, PaintTarget
from stylesplat.stylization.views import crop_views, find_boxes, typical_length

FOX, SHIELD = 1, 2  # label ids
NAIVE_STYLE = 512  # pixels of the style image, 13,000 features
SHORTCUT_STEPS = 60  # of each variant that is compared with the exact one
SHORTCUT_SIZE = 128  # pixels of the object in these


@dataclass(frozen=True)
class Options:
    """What to run."""

    naive_steps: int = 5
    """Steps of the naive loop, some ten seconds each; 300 to compare final losses."""


@dataclass(frozen=True)
class Bench:
    """The scene and the style that everything is measured on."""

    splats: Splats
    training: Cameras
    held_out: Cameras
    network: FeatureNetwork
    style: Tensor

    def job(self, object_id: int, **settings: object) -> PaintTarget:
        """One object in the style."""
        picked = pick(self.splats, object_id=object_id)
        config = replace(StyleConfig(), **settings)
        return PaintTarget(str(object_id), picked, (self.style,), config)

    def loss(self, splats: Splats, picked: Tensor, length: float) -> float:
        """The exact NNFM in held-out views."""
        boxes = find_boxes(self.splats, self.held_out, picked)
        zoom = length / typical_length(boxes)
        views = crop_views(self.splats, boxes, picked, [self.network.cells(3)], zoom=zoom)
        targets = style_features(self.style, self.network, (3,), length=2 * length)
        few = evenly(views, 4)
        return object_nnfm(renders(splats, few), few, targets, self.network, (3,))


def storage(bench: Bench) -> str:
    """Ways to render with other colours, in milliseconds forward and backward."""
    picked = bench.job(FOX).mask
    rows = [_storage_row(bench, picked, factor) for factor in (1.0, 3.3)]
    return table(["size", "rasterise", "stored lists", "float16 blocks", "MB a view"], rows)


def _storage_row(bench: Bench, picked: Tensor, factor: float) -> list[str]:
    camera = bench.training[20].downscale(factor)
    linear = contributions(bench.splats, camera, picked)
    colors = torch.rand(len(linear.gaussians), 3, requires_grad=True)
    v_image = torch.rand_like(linear.background)
    times = [
        median_ms(lambda: _rasterized(bench.splats, camera).backward(v_image), repeats=7),
        median_ms(_reblending(bench.splats, camera, v_image), repeats=7),
        median_ms(lambda: linear.image(colors).backward(v_image), repeats=7),
    ]
    width, height = camera.size
    megabytes = f"{linear.nbytes / MIB:.0f}"
    return [f"{width}x{height}", *(f"{ms:.1f}" for ms in times), megabytes]


def _rasterized(splats: Splats, camera: Cameras) -> Tensor:
    return rasterize(replace(splats, sh0=splats.sh0.detach().requires_grad_()), camera)[0][0]


def _reblending(splats: Splats, camera: Cameras, v_image: Tensor) -> Callable[[], None]:
    """What is left of rasterising with projection, order and tile lists stored."""
    gaussians = activated(splats)
    projected = cpu.project_gaussians(gaussians, views_of(camera)[0])
    drawn = cpu.rasterize_to_pixels(
        projected, gaussians.opacities, torch.rand_like(splats.means), camera.size
    )
    picture = cpu.as_picture(drawn.image, drawn.alphas)
    v_picture = cpu.as_picture(v_image, torch.zeros_like(drawn.alphas))
    order, rows, lists = drawn.tiled
    colors, channels = vecs.channels(3), blend_backward.split_channels(3, 0)
    stride = blend_backward.gradient_stride(3)

    def work() -> None:
        blend.blend_forward(colors, rows, lists, picture, get_num_threads())
        partial = cpu.partial_sums(len(order), stride).flatten(1).numpy()
        blend_backward.blend_backward(channels, rows, lists, picture, v_picture, partial)

    return work


def shortcuts(bench: Bench) -> str:
    """The exact final loss after optimising with one shortcut more each."""
    job = bench.job(FOX, steps=SHORTCUT_STEPS, object_size=SHORTCUT_SIZE, quality="draft")

    def exhaustive(self: StyleIndex, feats: Tensor) -> Tensor:
        return nearest_rows(feats, self.directions)

    def run(
        name: str, dtype: torch.dtype, room: float, *, compressed: bool
    ) -> tuple[str, float, float]:
        cameras = bench.training
        studio = PaintContext(bench.splats, cameras, cameras, bench.network, dtype, room)
        search = StyleIndex.nearest if compressed else exhaustive
        with patch.object(StyleIndex, "nearest", search):
            start = time.perf_counter()
            *_, last = paint_steps(studio, job)
            seconds = time.perf_counter() - start
        return name, seconds, bench.loss(last.splats, job.mask, LENGTH)

    found = [
        run("none: rasterised, float32, exhaustive search", torch.float32, 0, compressed=False),
        run("+ linear rendering", torch.float32, math.inf, compressed=False),
        run("+ compressed search", torch.float32, math.inf, compressed=True),
        run("+ bfloat16", torch.bfloat16, math.inf, compressed=True),
    ]
    exact = found[0][2]
    rows = [
        [name, f"{seconds:.1f}", f"{loss:.4f}", f"{100 * (loss / exact - 1):+.2f} %"]
        for name, seconds, loss in found
    ]
    return table([f"shortcuts, {SHORTCUT_STEPS} steps", "s", "exact NNFM", "difference"], rows)


def naive(bench: Bench, steps: int) -> tuple[float, Splats]:
    """Seconds per step of the naive loop, and what it makes."""
    job = bench.job(FOX, quality="draft")
    context = paint_context(bench.splats, bench.training, bench.network)
    start = next(paint_steps(context, replace(job, config=replace(job.config, lr=1e-9))))
    rows = job.mask.nonzero()[:, 0]
    sh0 = start.splats.sh0[rows].requires_grad_()
    optimizer = torch.optim.Adam([sh0], lr=job.config.lr, eps=1e-15)
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, FINAL_RATE ** (1 / steps))
    target = style_features(bench.style, bench.network, (3,), length=NAIVE_STYLE)[0]
    generator = torch.Generator().manual_seed(0)
    began = time.perf_counter()
    for _ in tqdm(range(steps), desc="naive"):
        row = int(torch.randint(len(bench.training), (1,), generator=generator))
        splats = replace(start.splats, sh0=start.splats.sh0.index_copy(0, rows, sh0))
        seen = job.mask.float()[:, None]
        image, _, _ = rasterize(splats, bench.training[row], features=seen)
        feats = bench.network(image[0, :, :, :3])[0]
        cells = F.avg_pool2d(image[0, :, :, 3][None], 4)[0] > 0.5
        loss = naive_loss(feats, cells, target)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
    seconds = (time.perf_counter() - began) / steps
    final = replace(start.splats, sh0=start.splats.sh0.index_copy(0, rows, sh0.detach()))
    return seconds, final


def naive_loss(feats: Tensor, cells: Tensor, target: Tensor) -> Tensor:
    """NNFM of the object, after the search for every pixel of the frame."""
    with torch.no_grad():
        nearest_rows(
            feats.reshape(-1, feats.shape[-1])[~cells.flatten()], F.normalize(target, dim=1)
        )
    return nnfm_loss(feats[cells], target)


class Run(NamedTuple):
    """Objects that were painted, as `stylize` does it."""

    styled: Painted
    seconds: float
    """With measuring."""
    painting: dict[str, float]
    """Seconds of each object."""


def _styled(bench: Bench, *jobs: PaintTarget) -> Run:
    start = time.perf_counter()
    studio = paint_context(bench.splats, bench.training, bench.network, held_out=bench.held_out)
    styled, painting = paint_objects(studio, jobs)
    measure_painted(studio, jobs, styled.splats, held_out=bench.held_out)
    return Run(styled, time.perf_counter() - start, painting)


def speed(bench: Bench, naive_steps: int) -> str:
    """Ours against the naive loop, one object and two."""
    one, other = bench.job(FOX), bench.job(SHIELD)
    results: list[Run] = []
    _styled(bench, replace(one, config=replace(one.config, steps=2)))  # compiles
    memory = peak_memory(lambda: results.append(_styled(bench, one)))
    results.append(_styled(bench, one, other))
    painted, (ours, both) = results[0].styled, (run.seconds for run in results)
    step = results[0].painting[one.name] / one.config.all_steps
    naive_step, by_naive = naive(bench, naive_steps)
    ratio = f"{naive_step / step:.0f} times faster"
    size = max(bench.training.size)
    losses = [
        [f"{bench.loss(s, one.mask, length):.4f}" for s in (painted.splats, by_naive)]
        for length in (LENGTH, size / 2)
    ]
    rows = [
        ["all steps, s", f"{ours:.1f}", f"{300 * naive_step:.0f} (from {naive_steps} steps)", ""],
        ["a step with its share of the preparation, s", f"{step:.3f}", f"{naive_step:.2f}", ratio],
        [f"NNFM, object of {LENGTH:.0f} px", *losses[0], ""],
        [f"NNFM, object of {size / 2:.0f} px", *losses[1], f"naive after {naive_steps} steps"],
        ["two objects, s", f"{both:.1f}", "", f"{both / ours:.2f} times one"],
        ["peak memory, GiB", f"{memory / 2**30:.2f}", "", ""],
    ]
    return table(["", "ours", "naive", ""], rows)


def main(options: Options) -> None:
    """Print the tables."""
    scene = ss.open(trained_scene("fox", downscale=1, gaussians=100_000))
    training, held_out = scene.working_views()
    assert held_out is not None
    style = read_style(STYLES / "van_gogh_starry_night_1024.jpg")
    bench = Bench(scene.splats, training, held_out, style_network(), style)
    print(f"{machine()}, calibration {calibration_ms():.0f} ms\n")
    print(storage(bench), end="\n\n", flush=True)
    print(speed(bench, options.naive_steps), end="\n\n", flush=True)
    print(shortcuts(bench))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
