"""What lies in a box, among very many."""

from jaxtyping import Int, Shaped
from torch import Tensor


def overlapping(
    lows: Shaped[Tensor, "N D"],
    highs: Shaped[Tensor, "N D"],
    low: Shaped[Tensor, " D"],
    high: Shaped[Tensor, " D"],
) -> Int[Tensor, " M"]:
    """Which boxes share a point with another one, in order.

    One axis after the other is looked at: few are left after the first.

    Args:
        lows: Their lower corners; for points, these.
        highs: Their upper corners.
        low: The lower corner of the other one.
        high: Its upper corner.
    """
    rows = ((lows[:, 0] <= high[0]) & (highs[:, 0] >= low[0])).nonzero()[:, 0]
    for axis in range(1, len(low)):
        shared = (lows[rows, axis] <= high[axis]) & (highs[rows, axis] >= low[axis])
        rows = rows[shared]
    return rows
