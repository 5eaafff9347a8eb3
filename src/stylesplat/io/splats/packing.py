"""What formats of splats share: bounds, an order, small rotations, codebooks, clusters."""

import math
import warnings

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped, UInt8
from scipy.cluster.vq import kmeans2, vq
from torch import Tensor

from stylesplat.progress import track

PACKED_SMALLEST = torch.finfo(torch.float32).tiny  # a standard deviation of 0 has no logarithm
PACKED_NEAR = 1e-6  # of an opacity to 0 and 1, which have no logit; splat-transform's bound for SOG
OPAQUE = 1 - 2.0**-25  # an opacity: 1 has no logit, and float32 has no number between
MORTON_BITS = 21  # of each coordinate: three of them fill a signed integer of 64 bits
# Shifts and masks that spread the bits of a coordinate three apart
SPREADS = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
PACKED_LARGEST = 0.5**0.5  # bound of a component of a unit quaternion that is not its largest
# Components but the largest
PACKED_OTHERS = torch.tensor([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
CODEBOOK_SIZE = 256  # values that a byte can name
QUANTILES = 2**14  # of the sorted numbers, for the first guess of a codebook
LLOYD_ROUNDS = 20  # more change little
FIRST_CLUSTERS = 256  # at most, of the first of two levels: as many as one of them may have
PACKED_SAMPLE = 2**15  # rows that the first level is fitted to
MAX_DISTANCES = 2**25  # between rows and centres that are in memory together
KMEANS_ROUNDS = 3  # more change little

Rows = Float[np.ndarray, "M D"]
Centres = Float[np.ndarray, "E D"]
LabelRows = Int[np.ndarray, " M"]


def morton_order(means: Float[Tensor, "N 3"]) -> Int[Tensor, " N"]:
    """The rows along a Z-order curve (Morton 1966), so that neighbours in space are neighbours."""
    if not len(means):
        return torch.zeros(0, dtype=torch.int64)
    points = means.double() - means.double().amin(dim=0)
    extent = points.max().clamp(min=torch.finfo(torch.float64).tiny)
    cells = (points / extent * (2**MORTON_BITS - 1)).long()
    for shift, mask in SPREADS:
        cells = (cells | cells << shift) & mask
    return (cells << torch.arange(3, device=cells.device)).sum(dim=1).argsort(stable=True)


def to_bytes(values: Float[Tensor, "*B"]) -> UInt8[np.ndarray, "*B"]:
    return values.round().clamp(0, 255).to(torch.uint8).numpy()


def to_floats(values: Shaped[np.ndarray, "*B"]) -> Float[Tensor, "*B"]:
    return torch.from_numpy(np.array(values, np.float32))


def logits(opacities: Float[Tensor, " N"]) -> Float[Tensor, " N"]:
    """Logits of opacities from 0 to 1, and NaN of others, which `drawable` leaves out."""
    alphas = opacities.double()
    impossible = (alphas < 0) | (alphas > 1)
    return alphas.clamp(PACKED_SMALLEST, OPAQUE).logit().where(~impossible, math.nan).float()


def unit_quats(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 4"]:
    """Quaternions of norm 1, also of those whose squares overflow or vanish in float32."""
    return torch.nn.functional.normalize(quats.double(), dim=1).float()


def smallest_three(quats: Float[Tensor, "N 4"]) -> tuple[Int[Tensor, " N"], Float[Tensor, "N 3"]]:
    """The index of the largest component of each rotation, and the others in +-`PACKED_LARGEST`."""
    quats = unit_quats(quats)
    largest = quats.abs().argmax(dim=1)
    quats = quats * quats.gather(1, largest[:, None]).sign()
    return largest, quats.gather(1, PACKED_OTHERS[largest])


def from_smallest_three(
    largest: Int[Tensor, " N"], others: Float[Tensor, "N 3"]
) -> Float[Tensor, "N 4"]:
    """The unit quaternions, wxyz, of which `smallest_three` gave the components."""
    quats = torch.zeros(len(largest), 4).scatter(1, PACKED_OTHERS[largest], others)
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


def tree_kmeans(rows: Rows, most: int) -> tuple[Centres, LabelRows]:
    """At most `most` centres for float32 rows, and the centre of each row.

    K-means within each cluster of k-means (Gray 1984), into the more clusters the larger the
    squared error of the first is, and again within those that are still large. So a row is compared
    with hundreds of centres, not with 65536, and the error is a little larger than that of plain
    k-means.
    """
    filled = rows.any(axis=1)
    if most > 1 and not filled.all():  # one entry serves all rows of zeros, as paint has them
        found = np.zeros(len(rows), np.int64)
        if not filled.any():
            return rows[:1], found
        centres, inner = tree_kmeans(rows[filled], most - 1)
        found[filled] = inner + 1
        return np.concatenate([np.zeros_like(rows[:1]), centres]), found
    count = min(FIRST_CLUSTERS, math.isqrt(most))
    sample = np.random.default_rng(0).permutation(len(rows))[:PACKED_SAMPLE]
    labels, distances = vq(rows, kmeans(rows[sample], count)[0])
    sizes, errors = np.bincount(labels), np.bincount(labels, distances**2)
    counts = np.minimum(sizes, 1)
    for _ in range(KMEANS_ROUNDS):  # what a small cluster cannot take goes to the others
        wanted = np.where(counts < sizes, errors, 0.0)
        more = wanted / max(wanted.sum(), np.finfo(float).tiny) * (most - counts.sum())
        counts = np.minimum(sizes, counts + more.astype(np.int64))
    centres, found = list[Centres](), np.empty(len(rows), np.int64)
    clusters = np.split(np.argsort(labels, kind="stable"), np.cumsum(sizes)[:-1])
    pairs = zip(clusters, counts.tolist(), strict=True)
    for cluster, count in track(pairs, "palette of colours", unit="part", total=len(clusters)):
        if len(cluster):
            is_large = len(cluster) * count > MAX_DISTANCES and len(cluster) < len(rows)
            own, inner = (tree_kmeans if is_large else kmeans)(rows[cluster], count)
            found[cluster] = sum(map(len, centres)) + inner
            centres.append(own)
    return np.concatenate(centres), found


def kmeans(rows: Rows, count: int, *, rounds: int = KMEANS_ROUNDS) -> tuple[Centres, LabelRows]:
    """At most `count` centres that have rows, and the centre of each row."""
    with warnings.catch_warnings(action="ignore"):  # of equal rows, which leave centres empty
        chosen = np.random.default_rng(0).permutation(len(rows))[:count]
        centres, labels = kmeans2(rows, rows[chosen], iter=rounds, minit="matrix")
    used, labels = np.unique(labels, return_inverse=True)
    return centres[used], labels
