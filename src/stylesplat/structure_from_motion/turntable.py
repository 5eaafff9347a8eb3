"""Photos of an object that turns before a camera that stands still: found, and where it shows.

The features of the room, which agree in all photos, would pose the room. Only those of what moves
are used.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from PIL import Image, ImageOps
from torch import Tensor

from stylesplat.imaging.still_background import (
    STILL_PHOTOS,
    STILL_SIDE,
    StillBackground,
    find_still_background,
)
from stylesplat.io.files import resolve_within
from stylesplat.io.images import image_sizes, open_image
from stylesplat.progress import track
from stylesplat.scene.sequences import evenly_spaced

TURNTABLE_LOOK = 12  # photos, which tell most captures from a turntable


@dataclass(frozen=True, eq=False)
class Turntable:
    photos: Path
    still: StillBackground

    def moving(self, name: str) -> Bool[np.ndarray, "h w"]:
        """Where a photo shows what turns, or its shadow, at most `STILL_SIDE` in size."""
        return self.still.moving(_small(self.photos, name)).numpy()

    def box(self, name: str) -> tuple[int, int, int, int]:
        """Around what turns in a photo, in its own pixels."""
        moving = self.moving(name)
        scale = image_sizes(resolve_within(self.photos, name))[1][0] / moving.shape[1]
        edges = [np.flatnonzero(moving.any(axis=axis))[[0, -1]] for axis in (0, 1)]
        (x0, x1), (y0, y1) = (scale * (each + np.array([0, 1])) for each in edges)
        return int(x0), int(y0), int(x1), int(y1)

    def masks(self, names: Sequence[str]) -> dict[str, Callable[[], Bool[np.ndarray, "h w"]]]:
        return {name: partial(self.moving, name) for name in names}


def find_turntable(photos: Path, names: Sequence[str]) -> Turntable | None:
    """What stands still in the photos of a folder, if the camera did while something moved."""
    still = None
    for count in (TURNTABLE_LOOK, STILL_PHOTOS):
        some = [names[row] for row in evenly_spaced(range(len(names)), count)]
        looked = track(some, "looking for a turntable", unit="photo")
        still = find_still_background([_small(photos, name) for name in looked])
        if still is None:
            return None
    assert still is not None
    return Turntable(photos, still)


def _small(photos: Path, name: str) -> UInt8[Tensor, "h w 3"]:
    with open_image(resolve_within(photos, name)) as image:
        image.draft("RGB", (2 * STILL_SIDE, 2 * STILL_SIDE))
        upright = ImageOps.exif_transpose(image).convert("RGB")
    upright.thumbnail((STILL_SIDE, STILL_SIDE), Image.Resampling.BOX)
    return torch.from_numpy(np.array(upright))
