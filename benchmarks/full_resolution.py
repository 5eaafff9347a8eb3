"""A whole capture in, a scene out, at full resolution in bounded memory.

    .venv/bin/python benchmarks/full_resolution.py

Runs `stylesplat train` on fox at 540x960 with 200,000 Gaussians and its label maps, and prints
the most memory that the process held. Target: under 4 GB.
"""

import json
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import tyro
from bench import DATA, capture, machine, table


@dataclass(frozen=True)
class Options:
    """What to train."""

    seconds: float = 180
    """Training time."""
    max_gaussians: int = 200_000
    """Gaussians at most."""


def main(options: Options) -> None:
    """Train in a process of its own and print the table."""
    capture("fox")
    with tempfile.TemporaryDirectory() as folder:
        command = Path(sys.executable).with_name("stylesplat")
        bounds = f"--max-seconds {options.seconds} --max-gaussians {options.max_gaussians}".split()
        done = subprocess.run(
            [command, "train", DATA / "fox", "-o", f"{folder}/scene", "--json", *bounds],
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    metrics = json.loads(done.stdout)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
    print(f"fox 540x960, {machine()}")
    heads = ["Gaussians", "steps", "training", "held-out PSNR", "SSIM", "mIoU", "peak memory"]
    line = [
        f"{metrics['gaussians']:,}",
        metrics["steps"],
        f"{metrics['seconds']:.0f} s",
        f"{metrics['psnr']:.2f} dB",
        f"{metrics['ssim']:.3f}",
        f"{metrics['miou']:.3f}",
        f"{peak:.2f} GB",
    ]
    print(table(heads, [line]))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
