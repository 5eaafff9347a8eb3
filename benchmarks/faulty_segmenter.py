"""A segmenter that makes mistakes, from exact label maps: to try tracking without any model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.demo.faults import FaultConfig, corrupt_label_maps
from stylesplat.masks.tracking import Segmenter, labels_to_masks, masks_to_labels

Mask = Bool[Tensor, "H W"]
OwnLabels = Int[Tensor, "_ _"]  # one of several label maps, which may differ in size


@dataclass(frozen=True)
class Mistakes:
    """How bad the segmenter is; everything is a chance."""

    single: FaultConfig = field(
        default_factory=lambda: FaultConfig(missing=0.15, merged=0.2, fragments=0.3)
    )
    """In single photos."""
    halved: float = 0.15
    """That an object is found as two halves."""
    lost: float = 0.1
    """That an object which is followed is lost along a row of photos."""
    swapped: float = 0.1
    """That the segmenter goes on with a neighbour instead."""


def faulty_segmenter(
    truth: Sequence[OwnLabels], *, seed: int = 0, mistakes: Mistakes | None = None
) -> Segmenter:
    """A segmenter that knows the truth and spoils it.

    Args:
        truth: Exact label maps, one per photo.
        seed: Of all chances; the same photos are spoilt alike each time.
        mistakes: Which and how many.
    """
    bad = mistakes or Mistakes()

    def propose(row: int) -> list[Mask]:
        rng = np.random.default_rng((seed, row))
        (labels,) = corrupt_label_maps([truth[row]], seed=seed + 7919 * row, config=bad.single)
        found = []
        for mask in labels_to_masks(labels).values():
            found += _halves(mask) if rng.random() < bad.halved else [mask]
        return found

    def propagate(rows: Sequence[int], seeds: Mapping[int, Mask]) -> list[dict[int, Mask]]:
        rng = np.random.default_rng((seed, *rows))
        targets = {id: _meant(mask, truth[rows[0]]) for id, mask in seeds.items()}
        found = [dict(seeds)]
        for row in rows[1:]:
            for id, objects in targets.items():
                if rng.random() < bad.lost / len(rows):
                    targets[id] = []
                elif objects and rng.random() < bad.swapped / len(rows):
                    targets[id] = [int(rng.choice([*labels_to_masks(truth[row])] or objects))]
            frayed = FaultConfig(bad.single.border, missing=0.0, merged=0.0, fragments=0.0)
            (labels,) = corrupt_label_maps([truth[row]], seed=seed + 104729 + row, config=frayed)
            masks = {id: _union(labels, objects) for id, objects in targets.items()}
            found.append(
                labels_to_masks(
                    masks_to_labels({i: m for i, m in masks.items() if m.any()}, labels.shape)
                )
            )
        return found

    return Segmenter(lambda row: (truth[row].shape[0], truth[row].shape[1]), propose, propagate)


def _halves(mask: Mask) -> list[Mask]:
    columns = mask.any(dim=0).nonzero().flatten()
    middle = int(columns.float().mean())
    left = mask.clone()
    left[:, middle:] = False
    return [half for half in (left, mask & ~left) if half.any()]


def _meant(mask: Mask, exact: Int[Tensor, "H W"]) -> list[int]:
    """The objects that most of the mask shows, or that it holds most of."""
    overlap = {
        id: (int((mask & each).sum()), int(each.sum()))
        for id, each in labels_to_masks(exact).items()
    }
    return [
        id for id, (both, size) in overlap.items() if 2 * both > size or 2 * both > int(mask.sum())
    ]


def _union(labels: Int[Tensor, "H W"], objects: Sequence[int]) -> Mask:
    return torch.isin(labels, torch.tensor(objects, dtype=labels.dtype))
