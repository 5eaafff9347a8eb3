"""Numbers as bytes: which of 256 values of a list, the codebook, they are nearest to."""

import numpy as np
from jaxtyping import Float, UInt8

VALUES = 256  # as many as a byte can name
PARTS = 2**14  # of the sorted numbers, for the first guess
ROUNDS = 20  # of moving the values; more change little

Numbers = Float[np.ndarray, "*B"]
Codebook = Float[np.ndarray, " 256"]


def codebook_of(numbers: Numbers) -> Codebook:
    """Values that numbers are nearest to with a small squared error, in rising order.

    The first guess follows the third root of the numbers' density, which is best for many values
    (Panter and Dite 1951) and leaves some for outliers; then each value is moved to the mean of
    its numbers, again and again (Lloyd 1982).
    """
    ordered = np.sort(numbers.ravel().astype(np.float64))
    if not len(ordered):
        return np.zeros(VALUES)
    quantiles = ordered[np.linspace(0, len(ordered) - 1, PARTS).round().astype(int)]
    along = np.concatenate([[0.0], np.cumsum(np.diff(quantiles) ** (2 / 3))])
    values = np.interp(np.linspace(0, along[-1], VALUES), along, quantiles)
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    for _ in range(ROUNDS):
        ends = np.searchsorted(ordered, (values[1:] + values[:-1]) / 2)
        starts, ends = np.concatenate([[0], ends]), np.concatenate([ends, [len(ordered)]])
        counts = ends - starts
        means = (sums[ends] - sums[starts]) / np.maximum(counts, 1)
        values = np.where(counts > 0, means, values)
    return np.sort(values)


def coded(numbers: Numbers, codebook: Codebook) -> UInt8[np.ndarray, "*B"]:
    """Which value of the codebook each number is nearest to."""
    return np.searchsorted((codebook[1:] + codebook[:-1]) / 2, numbers).astype(np.uint8)
