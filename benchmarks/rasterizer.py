"""Time and memory of one rasterised training step of a trained scene, by number of channels.

    .venv/bin/python benchmarks/rasterizer.py

Fox at 540x960 with 50,000 Gaussians: spherical harmonics, projection, binning, blending and the
way back to the gradients of all parameters. "identities" are 16 more channels; in training their
gradients stop at the features (`identity_geometry` off), "all gradients" lets them through. Poses
are trained only where asked for.
"""

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import torch
import tyro
from bench import (
    MIB,
    calibration_ms,
    capture,
    machine,
    median_ms,
    memory_now,
    peak_memory,
    processor_ms,
    release_memory,
    step,
    table,
    trained_fox,
)

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

ROUNDS = 5  # each measures every variant, so that a noisy moment hits them alike


@dataclass(frozen=True)
class Options:
    """What to rasterise."""

    gaussians: int = 50_000
    """Gaussians of the scene."""
    views: int = 5
    """How many views to take the mean over."""


def variants(splats: Splats, cameras: Cameras) -> dict[str, Callable[[], None]]:
    """The steps to compare, each over all cameras."""

    def over_cameras(
        identities: bool, all_gradients: bool, *, poses: bool = False
    ) -> Callable[[], None]:
        def run() -> None:
            for i in range(len(cameras)):
                step(
                    splats,
                    cameras[i],
                    identities=identities,
                    all_gradients=all_gradients,
                    poses=poses,
                )

        return run

    return {
        "colour, 3 channels": over_cameras(False, True),
        "the same, and the camera's pose": over_cameras(False, True, poses=True),
        "with identities, 19 channels": over_cameras(True, False),
        "the same 19, all gradients": over_cameras(True, True),
    }


def timings(splats: Splats, cameras: Cameras) -> str:
    """The table of times."""
    steps = variants(splats, cameras)
    wall: dict[str, list[float]] = {name: [] for name in steps}
    processor: dict[str, list[float]] = {name: [] for name in steps}
    calibration = []
    for _ in range(ROUNDS):
        calibration.append(calibration_ms())
        for name, run in steps.items():
            wall[name].append(median_ms(run, repeats=3, warm_up=1) / len(cameras))
            processor[name].append(processor_ms(run, repeats=1) / len(cameras))
    loop, first = median(calibration), median(next(iter(wall.values())))
    rows = [
        [
            name,
            f"{min(times):.1f}",
            f"{median(times):.1f}",
            f"{median(processor[name]):.1f}",
            f"{median(times) / first:.2f}",
            f"{median(times) / loop:.2f}",
        ]
        for name, times in wall.items()
    ]
    heads = ["step", "ms, best", "ms, median", "processor ms", "over 3 channels", "over the loop"]
    return f"{table(heads, rows)}\n\ncalibration loop: {loop:.1f} ms"


def memory(splats: Splats, camera: Cameras, *, identities: bool) -> list[object]:
    """A row: what the step cannot do without, and the most that the process held for it."""
    channels = 19 if identities else 3
    unused = set() if identities else {"identities"}
    numbers = sum(t.numel() for name, t in splats.tensors().items() if name not in unused)
    width, height = camera.size
    needed = 4 * (2 * numbers + 2 * width * height * (channels + 1))

    def run(gaussians: Splats, view: Cameras) -> None:
        step(gaussians, view, identities=identities, all_gradients=False)

    run(splats[torch.arange(100)], camera.downscale(8))  # loads the kernels
    release_memory()
    before = memory_now()
    peak = peak_memory(lambda: run(splats, camera)) - before + 4 * numbers
    return [channels, f"{needed / MIB:.0f} MiB", f"{peak / MIB:.0f} MiB", f"{peak / needed:.2f}"]


def main(options: Options) -> None:
    """Print both tables."""
    splats = trained_fox(options.gaussians)
    every = capture("fox").cameras
    cameras = every[:: max(len(every) // options.views, 1)][: options.views]
    width, height = cameras[0].size
    print(f"fox {width}x{height}, {len(splats):,} Gaussians, {len(cameras)} views, {machine()}\n")
    rows = [memory(splats, cameras[0], identities=identities) for identities in (False, True)]
    heads = ["channels", "parameters, gradients, images", "peak", "ratio"]
    print(timings(splats, cameras), table(heads, rows), sep="\n\n")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
