"""Points of a surface, thinned until they lie evenly."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

POOLED = 0.6  # side of the cubes whose points are one, in distances of the points that are left
AROUND = 16  # points that a plane is fitted to
ROUNDS = 20  # after a few hardly any point is undecided


def pooled(size: float, points: Float[Tensor, "P 3"], values: Sequence[Tensor]) -> list[Tensor]:
    """The means of points, and of what else is known of them, that lie in the same small cube.

    Args:
        size: Of a cube.
        points: Where they are.
        values: What is known, each [P, _].
    """
    cells = (points / size).floor().long()
    cells -= cells.amin(dim=0)
    across, along, _ = (cells.amax(dim=0) + 1).tolist()
    keys = cells @ torch.tensor([1, across, across * along])
    _, index, counts = keys.unique(return_inverse=True, return_counts=True)
    means = []
    for value in (points, *values):
        sums = value.new_zeros(len(counts), value.shape[1]).index_add_(0, index, value)
        means.append(sums / counts[:, None])
    return means


def flattened(
    points: Float[Tensor, "P 3"], normals: Float[Tensor, "P 3"], rows: Int[Tensor, " L"]
) -> tuple[Float[Tensor, "L 3"], Float[Tensor, "L 3"]]:
    """Some points, moved along their normals onto the planes of their neighbours, and these'."""
    coordinates = points.double().numpy()
    count = min(AROUND, len(points))
    _, near = KDTree(coordinates).query(coordinates[rows.numpy()], k=count, workers=-1)
    near = torch.from_numpy(near).view(len(rows), -1)
    smooth = F.normalize(normals[near].mean(dim=1), dim=1)
    above = ((points[rows] - points[near].mean(dim=1)) * smooth).sum(dim=1, keepdim=True)
    return points[rows] - above * smooth, smooth


def thinned(points: Float[Tensor, "P 3"], distance: float, *, seed: int) -> Int[Tensor, " L"]:
    """Points no two of which are closer than a distance, and to one of which every other is.

    Args:
        points: All of them.
        distance: Between those that are left.
        seed: Of the order in which points are taken (as Luby 1986 takes independent sets).
    """
    pairs = KDTree(points.double().numpy()).query_pairs(distance, output_type="ndarray")
    ranks = np.random.default_rng(seed).permutation(len(points))
    left, taken = np.ones(len(points), bool), np.zeros(len(points), bool)
    for _ in range(ROUNDS):
        first, second = pairs.T
        beaten = np.zeros(len(points), bool)
        beaten[np.where(ranks[first] > ranks[second], first, second)] = True
        won = left & ~beaten
        taken |= won
        left &= beaten
        left[first[won[second]]] = left[second[won[first]]] = False
        pairs = pairs[left[first] & left[second]]
        if not left.any():
            break
    return torch.from_numpy(taken.nonzero()[0])
