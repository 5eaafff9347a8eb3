"""Statistical outlier removal: drop the Gaussians that float away from their object."""

import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

NEIGHBOURS = 20  # a floating clump of a dozen Gaussians must not vouch for itself
# Standard deviations. Measured on eight objects of two scenes: 2 takes away most of what floats
# for 1% of the object's own visible area at most (a thin plaque: 2%); 0.5 takes a fifth of it.
SPREAD = 2.0
MIN_POINTS = 20  # fewer are too few to tell what is usual


def inliers(
    points: Float[Tensor, "N 3"],
    *,
    reaches: Float[Tensor, " N"] | None = None,
    neighbours: int = NEIGHBOURS,
    spread: float = SPREAD,
) -> Bool[Tensor, " N"]:
    """Which points lie about as close to their neighbours as the others do.

    A point is dropped when the logarithm of its mean distance to its nearest neighbours exceeds
    the mean of all points by `spread` standard deviations. Densities in a splat span orders of
    magnitude; the logarithm makes them roughly normal and keeps a few distant floaters from
    inflating the deviation they are judged by. (PCL and Open3D use the plain distance.) What
    is large has far neighbours wherever it lies: `reaches` vouch for it.

    Args:
        points: Centres of one object's Gaussians.
        reaches: Mean distance to the neighbours up to which a point is kept in any case.
        neighbours: How many neighbours to average over; half of the others at most.
        spread: Standard deviations above the mean at which a point is dropped.

    Returns:
        True for the points to keep; sets of fewer than 20 are kept whole.
    """
    keep = torch.ones(len(points), dtype=torch.bool, device=points.device)
    if len(points) < MIN_POINTS:
        return keep
    neighbours = min(neighbours, len(points) // 2)
    positions = points.detach().cpu().double().numpy()
    distances, _ = KDTree(positions).query(positions, k=neighbours + 1, workers=-1)
    gaps = torch.from_numpy(distances[:, 1:]).mean(dim=1)  # column 0 is the point itself
    log_gaps = gaps.clamp(min=torch.finfo(torch.float32).tiny).log()
    usual = log_gaps <= log_gaps.mean() + spread * log_gaps.std()
    if reaches is not None:
        usual |= gaps <= reaches.detach().cpu()
    return usual.to(points.device)
