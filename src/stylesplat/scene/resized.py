"""Captures made smaller, to work at a size of one's own."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import resize_labels
from stylesplat.scene.lazy import Lazy, glance

Size = Sequence[int]  # height and width


def at_most(capture: Capture, length: int) -> Capture:
    """The same capture with photos whose sides have at most so many pixels.

    Label maps and cameras become smaller with the photos. All is made on access, from photos that
    are not kept at their own size.
    """
    cameras = capture.cameras.at_most(length)
    if cameras is capture.cameras:
        return capture
    smaller = {}
    for name, shrink in SHRINK.items():
        items = getattr(capture, name, None)
        if items is not None:
            sizes = [(height, width) for width, height in cameras.sizes.tolist()]
            makers = [partial(_shrunk, items, row, size, shrink) for row, size in enumerate(sizes)]
            smaller[name] = Lazy(makers)
    return replace(capture, cameras=cameras, **smaller)


def _shrunk(
    items: Sequence[Tensor | None], row: int, size: Size, shrink: Callable[[Any, Size], Tensor]
) -> Tensor | None:
    item = glance(items, row)
    return None if item is None else shrink(item, size)


def _averaged(pixels: UInt8[Tensor, "H W *D"], size: Size) -> UInt8[Tensor, "h w *D"]:
    """A picture in which every pixel averages what it covers."""
    return torch.from_numpy(cv2.resize(pixels.numpy(), size[::-1], interpolation=cv2.INTER_AREA))


# What a capture holds per photo and pixel
SHRINK: dict[str, Callable[[Any, Size], Tensor]] = {
    "photos": _averaged,
    "alphas": _averaged,
    "label_maps": resize_labels,
}
