"""The CPU kernels compiled by a second process, while the first one does what needs none of them.

numba compiles on one core at a time. What it compiles it keeps for all processes.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Literal

import torch

from stylesplat.demo.still_life import dome_cameras
from stylesplat.scene.capture import Capture
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style import Style
from stylesplat.training.train_config import TrainConfig
from stylesplat.verbs.render import render
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize
from stylesplat.verbs.train import train

Part = Literal["train", "stylize"]

VIEWS, WIDTH, HEIGHT = 9, 96, 72
GAUSSIANS = 400
LONGEST = 120  # seconds; whoever waited so long compiles what is missing


@contextmanager
def compiled_meanwhile(part: Part) -> Iterator[None]:
    """Compile the kernels of a part of the demo in another process; the block ends when it has."""
    process = subprocess.Popen(
        [sys.executable, "-m", __name__, part],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield
        process.wait(LONGEST)
    except subprocess.TimeoutExpired:
        pass
    finally:
        process.kill()
        process.wait()


def rehearse(part: Part) -> None:
    """Train on noise, and paint it too, in a few seconds, so that every kernel is called once."""
    generator = torch.Generator().manual_seed(0)
    cameras = dome_cameras(VIEWS, WIDTH, HEIGHT)
    photos = torch.randint(
        256, (VIEWS, HEIGHT, WIDTH, 3), dtype=torch.uint8, generator=generator
    ).unbind()
    points = torch.randn(GAUSSIANS, 3, generator=generator) / 2
    labels = torch.ones(HEIGHT, WIDTH, dtype=torch.long)
    capture = Capture(
        cameras,
        photos,
        label_maps=[labels] * VIEWS,
        points=points,
        point_colors=torch.full((GAUSSIANS, 3), 99, dtype=torch.uint8),
    )
    config = replace(TrainConfig(), steps=2, coarse_to_fine=False)
    scene = select(train(capture, config, segment="lift", device="cpu"), "noise", id=1)
    if part == "train":
        return
    style = Style(torch.rand(64, 64, 3), config=StyleConfig(steps=2, pattern="large"))
    stylize(scene, {"noise": style}, device="cpu")
    next(render(scene, "test", what="identities").pictures)


if __name__ == "__main__":
    rehearse("train" if sys.argv[1:] == ["train"] else "stylize")
