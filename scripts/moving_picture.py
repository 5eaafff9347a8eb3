"""A moving picture of a painted scene: a round trip, with a wipe from before to after.

python scripts/moving_picture.py demo-output/styled before_after.webp --size 460 460 --around vase
"""

import argparse
import math
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

import stylesplat as ss

EDGE = 2  # pixels of the line between before and after
QUALITY = 60  # of WebP: 96 frames of 560x380 take 1.6 MB


def frames_of(
    scene: ss.Scene, count: int, size: tuple[int, int], around: str | None
) -> list[Tensor]:
    """Pictures of a round trip, before to the right of an edge that moves to and fro."""
    cameras = ss.orbit(scene, frames=count, size=size, around=around)
    before = ss.adjust(scene, undo=True)
    pairs = zip(ss.render(before, cameras), ss.render(scene, cameras), strict=True)
    frames = []
    for number, ((_, old), (_, new)) in enumerate(pairs):
        edge = round(size[0] * (0.5 - 0.55 * math.cos(4 * math.pi * number / count)))
        frame = torch.where(torch.arange(size[0])[:, None] < edge, new, old)
        frame[:, max(edge, 0) : max(edge + EDGE, 0)] = 255
        frames.append(frame)
    return frames


def main() -> None:
    """Render and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, help="folder of a painted scene")
    parser.add_argument("output", type=Path, help="a .webp")
    parser.add_argument("--around", help="the object in the middle")
    parser.add_argument("--frames", type=int, default=96)
    parser.add_argument("--size", type=int, nargs=2, default=(560, 380))
    options = parser.parse_args()
    scene = ss.open(options.scene)
    frames = frames_of(scene, options.frames, tuple(options.size), options.around)
    first, *rest = [Image.fromarray(each.numpy()) for each in frames]
    first.save(
        options.output,
        save_all=True,
        append_images=rest,
        duration=80,
        loop=0,
        quality=QUALITY,
        method=6,
    )


if __name__ == "__main__":
    main()
