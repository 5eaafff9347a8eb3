"""Samples: items at equal distances or at random, cameras that are far from each other."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

import torch

from stylesplat.scene.cameras import Cameras

T = TypeVar("T")


def evenly(items: Sequence[T], count: int) -> list[T]:
    """At most `count` of the items, at equal distances."""
    count = min(count, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]


def drawn(items: Sequence[T], count: int, generator: torch.Generator) -> Iterator[T]:
    """Draws `count` items in random order, each equally often."""
    order: list[int] = []
    for _ in range(count):
        order = order or torch.randperm(len(items), generator=generator).tolist()
        yield items[order.pop()]


def far_apart(cameras: Cameras, count: int) -> list[int]:
    """Rows of cameras chosen by farthest point sampling, the first farthest from the mean."""
    positions = cameras.positions.cpu()
    gaps = (positions - positions.mean(dim=0)).norm(dim=1)
    rows: list[int] = []
    while len(rows) < min(count, len(cameras)):
        row = int(gaps.argmax())
        distances = (positions - positions[row]).norm(dim=1)
        gaps = distances if not rows else torch.minimum(gaps, distances)
        rows.append(row)
        gaps[rows] = -1.0  # also where several cameras share a position
    return rows
