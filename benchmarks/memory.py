"""The most memory that training on many photos takes, and how soon it begins.

    .venv/bin/python benchmarks/memory.py                # 300 photos of 1600x1066, 300 steps
    .venv/bin/python benchmarks/memory.py --scene fox --photos 1000 --max-gaussians 50000

The photos are noise, which no JPEG compresses well, with label maps of noise in blocks; or those of
a real scene, again and again under other names, with a little noise. They are made in a temporary
folder, in a minute or two. Training runs in a process of its own, whose peak is everything: Python,
torch, the kernels, what is kept of photos, and the Gaussians.
"""

import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
import tyro
from bench import MIB, capture, machine, peak_memory
from PIL import Image

from still_life.nerfstudio import write_transforms
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.label_maps import write_label_map
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.capture import Capture
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit
from stylesplat.training.state import State

OBJECTS = 6
BLOCK = 100  # pixels of a label
NOISE = 2.0  # standard deviation, of 255


@dataclass(frozen=True)
class Options:
    """What to train on."""

    photos: int = 300
    """How many."""
    width: int = 1600
    """Of a photo."""
    height: int = 1066
    """Of a photo."""
    steps: int = 300
    """Of training."""
    scene: str | None = None
    """Folder in `../shared/data`, whose photos are repeated at their size."""
    max_gaussians: int = 3000
    """Gaussians at most: few, for noise makes them large, and then the rasteriser's lists grow."""
    max_memory: float | None = None
    """GiB for photos and label maps; `train`'s own default if nothing is given."""
    folder: Path | None = None
    """A capture that is there already; what the process of its own is called with."""


def make_capture(folder: Path, options: Options) -> None:
    """Photos and label maps of noise, points in a cube."""
    random = np.random.default_rng(0)
    (folder / "images").mkdir(parents=True)
    cameras = ring(options)
    for name in cameras.names:
        pixels = random.integers(0, 256, (options.height, options.width, 3), np.uint8)
        Image.fromarray(pixels).save(folder / "images" / name, quality=80)
        rows, columns = -(-options.height // BLOCK), -(-options.width // BLOCK)
        ids = random.integers(0, OBJECTS, (rows, columns)).repeat(BLOCK, 0).repeat(BLOCK, 1)
        labels = torch.from_numpy(ids[: options.height, : options.width])
        write_label_map(labels, folder / "object_mask" / f"{Path(name).stem}.png")
    points = torch.rand(10_000, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    write_transforms(cameras, folder, points=points)


def repeat_capture(folder: Path, options: Options, scene: Capture) -> None:
    """Photos of a scene with noise, and its label maps."""
    random, count = np.random.default_rng(0), len(scene)
    (folder / "images").mkdir(parents=True)
    rows = [number % count for number in range(options.photos)]
    names = tuple(f"{number:04d}.jpg" for number in range(options.photos))
    for row, name in zip(rows, names, strict=True):
        noise = random.normal(0, NOISE, scene.photos[row].shape)
        pixels = (scene.photos[row].numpy() + noise).round().clip(0, 255).astype(np.uint8)
        Image.fromarray(pixels).save(folder / "images" / name, quality=95)
        labels = scene.labels(row)
        if labels is not None:
            write_label_map(labels, folder / "object_mask" / f"{Path(name).stem}.png")
    cameras = replace(scene.cameras[rows], names=names)
    write_transforms(cameras, folder, points=scene.points)


def ring(options: Options) -> Cameras:
    """Cameras around the origin."""
    count, size = options.photos, torch.tensor([options.width, options.height])
    turn = 2 * torch.pi * torch.arange(count) / count
    positions = torch.stack([3 * turn.cos(), 3 * turn.sin(), torch.ones(count)], dim=1)
    K = torch.diag(torch.tensor([options.width, options.width, 1.0]))
    K[:2, 2] = size / 2
    return Cameras(
        viewmats=look_at(positions, torch.zeros(3), torch.tensor([0.0, 0.0, 1.0])),
        Ks=K.repeat(count, 1, 1),
        sizes=size.repeat(count, 1),
        names=tuple(f"{i:03d}.jpg" for i in range(count)),
    )


def train(folder: Path, options: Options) -> None:
    """Train and print the peak."""
    config = TrainConfig(
        steps=options.steps, max_gaussians=options.max_gaussians, max_memory=options.max_memory
    )
    states, starts = list[State](), list[float]()
    begun = perf_counter()

    def note(state: State, loss: float, train_psnr: float) -> None:
        starts.append(perf_counter() - state.seconds - begun)

    def work() -> None:
        checkpoint = folder / "out" / "checkpoint.pt"
        states.append(fit(load(folder), config, checkpoint=checkpoint, on_progress=note))

    peak = peak_memory(work)
    width, height = load(folder).cameras[0].size
    print(
        f"{options.photos} photos of {width}x{height}, {options.steps} steps, "
        f"max_memory {options.max_memory or 'as usual'}: peak {peak / MIB:,.0f} MiB resident; "
        f"{perf_counter() - begun:.0f} s in all, the first step after {starts[0]:.1f} s, "
        f"{states[0].seconds:.0f} s of steps",
        flush=True,
    )


def main(options: Options) -> None:
    """Make the photos, and train in a process of its own."""
    if options.folder is not None:
        return train(options.folder, options)
    print(machine(), flush=True)
    with tempfile.TemporaryDirectory() as name:
        start = perf_counter()
        if options.scene is None:
            make_capture(Path(name) / "capture", options)
        else:
            repeat_capture(Path(name) / "capture", options, capture(options.scene))
        print(f"photos made in {perf_counter() - start:.0f} s", flush=True)
        folder = ["--folder", str(Path(name) / "capture")]
        subprocess.run([sys.executable, __file__, *sys.argv[1:], *folder], check=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
