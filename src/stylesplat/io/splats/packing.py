"""What compressed formats of splats share: an order, small rotations, codebooks, clusters."""

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from scipy.sparse import csr_array
from torch import Tensor

MORTON_BITS = 21  # of each coordinate: three of them fill a signed integer of 64 bits
# Shifts and masks that spread the bits of a coordinate three apart
SPREADS = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
LARGEST = 0.5**0.5  # bound of a component of a unit quaternion that is not its largest
OTHERS = torch.tensor([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # components but the largest
CODEBOOK_SIZE = 256  # values that a byte can name
QUANTILES = 2**14  # of the sorted numbers, for the first guess of a codebook
LLOYD_ROUNDS = 20  # more change little
FIRST_CLUSTERS = 64  # clusters of the first level of the tree
GROWTH = 32  # clusters of the next level to one of this
MAX_BRANCHES = 256  # clusters that one cluster is split into
SAMPLE = 2**16  # rows that the first level is fitted to
KMEANS_ROUNDS = 3  # more change little
ROWS_AT_ONCE = 2**14  # rows whose distances from all centres are in memory

Rows = Float[np.ndarray, "M D"]
Centres = Float[np.ndarray, "E D"]
Counts = Int[np.ndarray, " G"]
Labels = Int[np.ndarray, " M"]


def morton_order(means: Float[Tensor, "N 3"]) -> Int[Tensor, " N"]:
    """The rows along a Z-order curve (Morton 1966), so that neighbours in space are neighbours."""
    if not len(means):
        return torch.zeros(0, dtype=torch.int64)
    points = means.double() - means.double().amin(dim=0)
    extent = points.max().clamp(min=torch.finfo(torch.float64).tiny)
    cells = (points / extent * (2**MORTON_BITS - 1)).long()
    for shift, mask in SPREADS:
        cells = (cells | cells << shift) & mask
    return (cells << torch.arange(3)).sum(dim=1).argsort(stable=True)


def unit_quats(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 4"]:
    """Quaternions of norm 1, also of those whose squares overflow or vanish in float32."""
    return torch.nn.functional.normalize(quats.double(), dim=1).float()


def smallest_three(quats: Float[Tensor, "N 4"]) -> tuple[Int[Tensor, " N"], Float[Tensor, "N 3"]]:
    """The index of the largest component of each rotation, and the others in +-`LARGEST`."""
    quats = unit_quats(quats)
    largest = quats.abs().argmax(dim=1)
    quats = quats * quats.gather(1, largest[:, None]).sign()
    return largest, quats.gather(1, OTHERS[largest])


def from_smallest_three(
    largest: Int[Tensor, " N"], others: Float[Tensor, "N 3"]
) -> Float[Tensor, "N 4"]:
    """The unit quaternions, wxyz, of which `smallest_three` gave the components."""
    quats = torch.zeros(len(largest), 4).scatter(1, OTHERS[largest], others)
    missing = (1 - others.square().sum(dim=1)).clamp(min=0).sqrt()
    return quats.scatter(1, largest[:, None], missing[:, None])


def fit_codebook(numbers: Float[np.ndarray, "*B"]) -> Float[np.ndarray, " 256"]:
    """256 rising values that approximate numbers with a small squared error.

    The first guess follows the cube root of the numbers' density, which is best for many values
    (Panter and Dite 1951) and leaves some for outliers; then each value is moved to the mean of its
    numbers, again and again (Lloyd 1982).
    """
    ordered = np.sort(numbers.ravel().astype(np.float64))
    if not len(ordered):
        return np.zeros(CODEBOOK_SIZE)
    quantiles = ordered[np.linspace(0, len(ordered) - 1, QUANTILES).round().astype(int)]
    along = np.concatenate([[0.0], np.cumsum(np.diff(quantiles) ** (2 / 3))])
    values = np.interp(np.linspace(0, along[-1], CODEBOOK_SIZE), along, quantiles)
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    for _ in range(LLOYD_ROUNDS):
        ends = np.searchsorted(ordered, (values[1:] + values[:-1]) / 2)
        starts, ends = np.concatenate([[0], ends]), np.concatenate([ends, [len(ordered)]])
        counts = ends - starts
        means = (sums[ends] - sums[starts]) / np.maximum(counts, 1)
        values = np.where(counts > 0, means, values)
    return np.sort(values)


def encode(
    numbers: Float[np.ndarray, "*B"], codebook: Float[np.ndarray, " 256"]
) -> UInt8[np.ndarray, "*B"]:
    """The index of the nearest value of the codebook for each number."""
    return np.searchsorted((codebook[1:] + codebook[:-1]) / 2, numbers).astype(np.uint8)


def tree_kmeans(rows: Rows, most: int, *, seed: int = 0) -> tuple[Centres, Labels]:
    """At most `most` centres for float32 rows, and the centre of each row.

    The centres are the leaves of a tree (Gray 1984): clusters are split again, into the more the
    larger their squared error is. So a row is compared with hundreds of centres, not with 65536,
    and the error is a little larger than that of plain k-means.
    """
    order = np.random.default_rng(seed).permutation(len(rows))
    rows = rows[order]
    count, sample = np.array([min(FIRST_CLUSTERS, most, len(rows))]), rows[:SAMPLE]
    centres, _ = _split(sample, np.array([len(sample)]), count)
    labels = _nearest(rows, np.array([len(rows)]), centres, count)
    while len(centres) < most:
        sorting = np.argsort(labels, kind="stable")  # clusters are contiguous, in random order
        rows, order, labels = rows[sorting], order[sorting], labels[sorting]
        sizes = np.bincount(labels, minlength=len(centres))
        errors = ((rows - centres[labels]) ** 2).sum(axis=1)
        errors = np.bincount(labels, errors, len(centres))
        counts = _branches(errors, np.minimum(sizes, MAX_BRANCHES), min(most, GROWTH * len(sizes)))
        if counts.sum() <= len(centres):
            break
        centres, labels = _split(rows, sizes, counts)
    found = np.empty(len(rows), np.int64)
    found[order] = labels
    return _mean_of(rows, labels, centres), found


def _split(rows: Rows, sizes: Counts, counts: Counts) -> tuple[Centres, Labels]:
    """K-means within each cluster of contiguous rows: `counts` new centres for `sizes` rows."""
    starts, firsts = np.cumsum(sizes) - sizes, np.cumsum(counts) - counts
    centres = rows[np.repeat(starts - firsts, counts) + np.arange(counts.sum())]
    for _ in range(KMEANS_ROUNDS):
        centres = _mean_of(rows, _nearest(rows, sizes, centres, counts), centres)
    return centres, _nearest(rows, sizes, centres, counts)


def _nearest(rows: Rows, sizes: Counts, centres: Centres, counts: Counts) -> Labels:
    """The nearest of the own cluster's centres for each row."""
    labels, start, first = np.empty(len(rows), np.int64), 0, 0
    squares = (centres**2).sum(axis=1)
    for size, count in zip(sizes.tolist(), counts.tolist(), strict=True):
        own = slice(first, first + count)
        turned = -2 * centres[own].T
        for low in range(start, start + size, ROWS_AT_ONCE):
            part = slice(low, min(low + ROWS_AT_ONCE, start + size))
            labels[part] = first + (rows[part] @ turned + squares[own]).argmin(axis=1)
        start, first = start + size, first + count
    return labels


def _mean_of(rows: Rows, labels: Labels, centres: Centres) -> Centres:
    """The mean of each centre's rows; centres without rows stay."""
    counts = np.bincount(labels, minlength=len(centres))[:, None]
    ones, ends = np.ones(len(rows), np.float32), np.arange(len(rows) + 1)
    sums = csr_array((ones, labels, ends), (len(rows), len(centres))).T @ rows
    return np.where(counts > 0, sums / np.maximum(counts, 1), centres).astype(np.float32)


def _branches(errors: Float[np.ndarray, " G"], sizes: Counts, most: int) -> Counts:
    """How many clusters each is split into: 1 to its size, in proportion to its error."""
    shares = np.minimum(sizes, 1)
    for _ in range(KMEANS_ROUNDS):  # what a small cluster cannot take goes to the others
        wanted = np.where(shares < sizes, errors, 0.0)
        if not wanted.any():
            break
        more = wanted / wanted.sum() * (most - shares.sum())
        shares = np.minimum(sizes, shares + more.astype(np.int64))
    return shares
