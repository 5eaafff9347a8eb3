"""Training photos and label classes at every size that the schedule asks for."""

from collections.abc import Callable

import cv2
import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import resize_labels

Views = Callable[[int, int], tuple[Cameras, Float[Tensor, "H W 3"], Int[Tensor, "H W"] | None]]
"""From a row of the capture and a downscale to its camera, photo in 0..1 and classes."""


def split_views(capture: Capture, test_every: int) -> tuple[list[int], list[int]]:
    """Rows to train on and rows held out: every `test_every`-th, none if that is 0."""
    rows = range(len(capture))
    held_out = list(rows[::test_every]) if test_every > 0 and len(rows) > 1 else []
    return [row for row in rows if row not in held_out], held_out


def training_views(capture: Capture, ids: tuple[int, ...], device: torch.device) -> Views:
    """A loader that keeps what it has resized."""
    known = torch.tensor(ids)
    cache: dict[tuple[int, int], tuple[Cameras, Tensor, Tensor | None]] = {}

    def load(row: int, factor: int) -> tuple[Cameras, Tensor, Tensor | None]:
        camera = capture.cameras[row].downscale(factor)
        size = camera.size
        photo = cv2.resize(capture.photos[row].numpy(), size, interpolation=cv2.INTER_AREA)
        labels = capture.label_maps[row] if capture.label_maps is not None else None
        if labels is None:
            return camera, torch.from_numpy(photo), None
        nearest = resize_labels(labels, size[::-1])
        classes = torch.searchsorted(known, nearest.long())
        return camera, torch.from_numpy(photo), classes.to(torch.int32)

    def view(row: int, factor: int) -> tuple[Cameras, Tensor, Tensor | None]:
        if (row, factor) not in cache:
            cache[row, factor] = load(row, factor)
        camera, photo, classes = cache[row, factor]
        moved = None if classes is None else classes.to(device).long()
        return camera, photo.to(device).float() / 255, moved

    return view
