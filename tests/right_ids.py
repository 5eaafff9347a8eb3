"""How well ids are kept over views, when they are not the truth's own."""

from collections.abc import Sequence

import torch
from jaxtyping import Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

OwnLabels = Int[Tensor, "_ _"]  # one of several label maps, which may differ in size


def right_pixels(found: Sequence[OwnLabels], truth: Sequence[OwnLabels]) -> float:
    """The share of the objects' pixels that have the one id which stands for their object.

    Every id stands for one object at most, in all views; the pairs are those that get most right.
    """
    ids, row = torch.cat([each.flatten() for each in found]).unique(return_inverse=True)
    objects, column = torch.cat([each.flatten() for each in truth]).unique(return_inverse=True)
    pixels = (row * len(objects) + column).bincount(minlength=len(ids) * len(objects))
    table = pixels.reshape(len(ids), len(objects))[ids != 0][:, objects != 0]
    whole = pixels.reshape(len(ids), len(objects)).sum(dim=0)[objects != 0].sum()
    return float(table[linear_sum_assignment(table, maximize=True)].sum() / whole)
