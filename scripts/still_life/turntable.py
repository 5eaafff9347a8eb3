"""Photos of a turntable: the still life's objects turn before a camera and a room that stand still.

    python -m scripts.still_life.turntable -o turntable

Writes `photos/`, the exact label maps in `masks/` (all objects are 1) and `cameras.json`, the
world-to-camera matrices in the objects' frame.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from stylesplat.io.label_maps import write_label_map

from .make import PHOTO_JPEG
from .photos import TARGET, View, arrange, dome_cameras, photograph

# Of the vase: its pattern repeats every few degrees, so that it looks the same when it has turned
ELSEWHERE = (100.0, 0.0)
STAND = 6  # view of `dome_cameras` whose camera is taken


def turned_layouts(views: int) -> list[Float[np.ndarray, "5 5"]]:
    """The arrangement of the objects at each step of a full turn around the middle."""
    layout, middle = arrange(0), np.array(TARGET[:2])
    layout[0, :2] = ELSEWHERE
    layouts = []
    for angle in 2 * np.pi * np.arange(views) / views:
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        spots, directions = layout[:, :2] - middle, layout[:, 2:4]
        layouts.append(np.hstack([spots @ turn + middle, directions @ turn, layout[:, 4:]]))
    return layouts


def turntable(views: int, width: int, height: int) -> tuple[Iterator[View], Float[Tensor, "C 4 4"]]:
    """The photos, and their world-to-camera matrices in the frame of the objects."""
    camera = dome_cameras(48, width, height)[STAND]
    pictures = (next(photograph(camera, layout)) for layout in turned_layouts(views))
    viewmats = []
    for angle in 2 * np.pi * np.arange(views) / views:
        c, s = np.cos(angle), np.sin(angle)
        turn = torch.eye(4, dtype=torch.float64)
        turn[:2, :2] = torch.tensor([[c, -s], [s, c]])
        middle = torch.tensor([*TARGET[:2], 0.0], dtype=torch.float64)
        turn[:3, 3] = middle - turn[:3, :3] @ middle
        viewmats.append(camera.viewmats[0].double() @ turn)
    return pictures, torch.stack(viewmats)


def write_turntable(folder: Path, *, views: int = 66, width: int = 480, height: int = 360) -> None:
    """Write photos, masks and cameras into a folder that does not exist."""
    pictures, viewmats = turntable(views, width, height)
    (folder / "photos").mkdir(parents=True)
    for row, view in enumerate(pictures):
        Image.fromarray(view.photo.numpy()).save(folder / f"photos/{row:03}.jpg", **PHOTO_JPEG)
        write_label_map((view.labels > 0).int(), folder / f"masks/{row:03}.png")
    (folder / "cameras.json").write_text(json.dumps(viewmats.tolist()), encoding="utf-8")


def main() -> None:
    """Write the turntable of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--views", type=int, default=66)
    parser.add_argument("--width", type=int, default=480)
    options = parser.parse_args()
    width = options.width
    write_turntable(options.output, views=options.views, width=width, height=3 * width // 4)


if __name__ == "__main__":
    main()
