"""How well ids are kept over views, when they are not the truth's own."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from stylesplat.scene.labels import BACKGROUND

FOUND = 0.5  # IoU from which an object counts as found in a view

Labels = Int[Tensor, "H W"]
OwnLabels = Int[Tensor, "_ _"]  # one of several label maps, which may differ in size


@dataclass(frozen=True)
class RightIds:
    """Two measures, from 0 to 1."""

    right_pixels: float
    """Share of the objects' pixels that have the one id which stands for their object."""
    idf1: float
    """F1 of objects found under that id, over all views (Ristani et al. 2016)."""


def right_ids(found: Sequence[OwnLabels], truth: Sequence[OwnLabels]) -> RightIds:
    """Compare label maps whose ids differ.

    Every object is stood for by one id over all views, and every id stands for one object at
    most; the pairs are those that get most right.

    Args:
        found: What is judged, one map per view.
        truth: Of the same views and sizes.
    """
    pixels, hits = dict[tuple[int, int], int](), dict[tuple[int, int], int]()
    objects, detections, area = 0, 0, 0
    for labels, exact in zip(found, truth, strict=True):
        sizes, whole = _sizes(labels), _sizes(exact)
        objects += len(whole)
        detections += len(sizes)
        area += sum(whole.values())
        for (id, object), both in _overlaps(labels, exact).items():
            pixels[id, object] = pixels.get((id, object), 0) + both
            either = sizes[id] + whole[object] - both
            hits[id, object] = hits.get((id, object), 0) + (both >= FOUND * either)
    return RightIds(
        right_pixels=_best(pixels) / max(1, area),
        idf1=2 * _best(hits) / max(1, objects + detections),
    )


def _sizes(labels: Labels) -> dict[int, int]:
    ids, counts = labels.unique(return_counts=True)
    sizes = dict(zip(ids.tolist(), counts.tolist(), strict=True))
    sizes.pop(BACKGROUND, None)
    return sizes


def _overlaps(labels: Labels, exact: Labels) -> dict[tuple[int, int], int]:
    ids, row = labels.unique(return_inverse=True)
    objects, column = exact.unique(return_inverse=True)
    pixels = (row * len(objects) + column).flatten().bincount(minlength=len(ids) * len(objects))
    table = zip(itertools.product(ids.tolist(), objects.tolist()), pixels.tolist(), strict=True)
    return {pair: count for pair, count in table if count and BACKGROUND not in pair}


def _best(counts: dict[tuple[int, int], int]) -> int:
    """The sum over the pairing, one to one, that has most."""
    if not counts:
        return 0
    ids, objects = (sorted({pair[side] for pair in counts}) for side in (0, 1))
    table = np.zeros((len(ids), len(objects)), int)
    for (a, b), count in counts.items():
        table[ids.index(a), objects.index(b)] = count
    return int(table[linear_sum_assignment(table, maximize=True)].sum())
