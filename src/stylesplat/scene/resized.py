"""Captures made smaller, to work at a size of one's own."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.scene.cache import GIB, Cache
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import resize_labels
from stylesplat.scene.lazy import Lazy

KEPT = 2 * GIB  # for what is made smaller: 4,000 photos of 480 pixels

Size = Sequence[int]  # height and width


def at_most(capture: Capture, length: int) -> Capture:
    """The same capture with photos whose sides have at most so many pixels.

    Label maps and cameras become smaller with the photos. All is made on first access and then
    kept; at their own size photos are not.
    """
    cameras = capture.cameras.at_most(length)
    if cameras is capture.cameras:
        return capture
    cache, sizes = Cache[tuple[str, int]](KEPT), cameras.sizes.tolist()
    smaller: dict[str, Lazy[Any]] = {}
    for name, shrink in SHRINK.items():
        items = getattr(capture, name)
        if items is not None:
            smaller[name] = Lazy(
                [
                    partial(_kept, cache, (name, row), partial(_shrunk, items, row, size, shrink))
                    for row, size in enumerate(sizes)
                ]
            )
    factor = capture.cameras.shrink_to(length)
    return replace(
        capture,
        cameras=cameras,
        full=capture.full_cameras,
        downscale=capture.downscale * factor,
        **smaller,
    )


def _kept(
    cache: Cache[tuple[str, int]], key: tuple[str, int], make: Callable[[], Tensor | None]
) -> Tensor | None:
    (item,) = cache.get(key, lambda: (make(),))
    return item


def _shrunk(
    items: Sequence[Tensor | None],
    row: int,
    size: Size,
    shrink: Callable[[Any, Size], Tensor],
) -> Tensor | None:
    """An item of another width and height, if there is one."""
    item, (width, height) = items[row], size
    return None if item is None else shrink(item, (height, width))


def _averaged(pixels: UInt8[Tensor, "H W *D"], size: Size) -> UInt8[Tensor, "h w *D"]:
    """A picture in which every pixel averages what it covers."""
    return torch.from_numpy(cv2.resize(pixels.numpy(), size[::-1], interpolation=cv2.INTER_AREA))


# What a capture holds per photo and pixel
SHRINK: dict[str, Callable[[Any, Size], Tensor]] = {
    "photos": _averaged,
    "alphas": _averaged,
    "label_maps": resize_labels,
}
