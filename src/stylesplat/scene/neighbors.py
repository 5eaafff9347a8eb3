"""The nearest of some points."""

from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor, from_numpy


def nearest_points(
    points: Float[Tensor, "P 3"], places: Float[Tensor, "Q 3"], count: int = 1
) -> tuple[Float[Tensor, "Q k"], Int[Tensor, "Q k"]]:
    """Distances (float64) of each place's nearest points, and the rows of these, nearest first.

    There are `count` of each, or as many as there are points; of no points one, infinitely far.
    """
    count = max(1, min(count, len(points)))
    tree = KDTree(points.detach().cpu().double().numpy())
    found = tree.query(places.detach().cpu().double().numpy(), k=count, workers=-1)
    far, rows = (from_numpy(each).view(-1, count).to(points.device) for each in found)
    return far, rows
