"""Compile the kernels of stylisation in another process, while this one trains.

Numba compiles on one core, and keeps machine code on disk for all processes.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import IDENTITY_SIZE, Classifier, Splats
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style import Style
from stylesplat.verbs.load import load
from stylesplat.verbs.render import render
from stylesplat.verbs.stylize import stylize


@contextmanager
def warm_up_stylization(capture: Path) -> Iterator[None]:
    """Compile the kernels of stylisation in another process, which ends with the block."""
    command = [sys.executable, "-m", __name__, capture]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def stylize_noise(capture: Path, count: int = 400) -> None:
    """Paint and render a cloud of random Gaussians, which calls every kernel once."""
    cameras = load(capture, downscale=5.0).cameras
    generator = torch.Generator().manual_seed(0)
    splats = Splats(
        means=torch.randn(count, 3, generator=generator) / 2,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), -3.0),
        opacities=torch.full((count,), 2.0),
        sh0=torch.randn(count, 1, 3, generator=generator),
        shN=torch.zeros(count, 8, 3),
        identities=torch.randn(count, IDENTITY_SIZE, generator=generator),
        classifier=Classifier(torch.eye(IDENTITY_SIZE)[:2], torch.zeros(2), ids=(0, 1)),
    )
    noise = {"noise": SceneObject(torch.ones(count, dtype=torch.bool), {})}
    scene = Scene(splats, cameras, held_out=cameras.names[:1], objects=noise)
    style = Style(torch.rand(64, 64, 3), config=StyleConfig(steps=2, object_size=112))
    stylize(scene, {"noise": style}, device="cpu")
    next(render(scene, "test", what="identities").pictures)


if __name__ == "__main__":
    stylize_noise(Path(sys.argv[1]))
