"""Rows of numbers, and entries that many of them are like."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

FIRST = 64  # groups that all rows are parted in; more are found within these
GROWTH = 32  # entries to one of the groups before
MOST = 256  # entries of one group: more would be compared with all of its rows, which are many
SAMPLE = 2**16  # rows that show how to part them first
ROUNDS = 3  # of k-means; more change little
AT_ONCE = 2**14  # rows whose distances from all entries are in memory

Rows = Float[np.ndarray, "M D"]
Entries = Float[np.ndarray, "E D"]
Counts = Int[np.ndarray, " G"]
Labels = Int[np.ndarray, " M"]


def clustered(rows: Rows, most: int, *, seed: int = 0) -> tuple[Entries, Labels]:
    """Entries that stand for rows, and which one stands for each (k-means, Lloyd 1982).

    They are the leaves of a tree (Gray 1984): rows are parted in groups and these again, the finer
    the larger a group's squared error is. So a row is compared with hundreds of entries and not
    with all of 65536, and the error is a little larger than the least.

    Args:
        rows: At least one, of 32 bits.
        most: How many entries there may be.
        seed: Of the choice of rows that become the first entries.
    """
    order = np.random.default_rng(seed).permutation(len(rows))
    rows = rows[order]
    count, sample = np.array([min(FIRST, most, len(rows))]), rows[:SAMPLE]
    entries, _ = _parted(sample, np.array([len(sample)]), count)
    labels = _nearest(rows, np.array([len(rows)]), entries, count)
    while len(entries) < most:
        sorting = np.argsort(labels, kind="stable")  # groups lie together, each in random order
        rows, order, labels = rows[sorting], order[sorting], labels[sorting]
        sizes = np.bincount(labels, minlength=len(entries))
        errors = ((rows - entries[labels]) ** 2).sum(axis=1)
        errors = np.bincount(labels, errors, len(entries))
        counts = _shares(errors, np.minimum(sizes, MOST), min(most, GROWTH * len(entries)))
        if counts.sum() <= len(entries):
            break
        entries, labels = _parted(rows, sizes, counts)
    found = np.empty(len(rows), np.int64)
    found[order] = labels
    return _centred(rows, labels, entries), found


def _parted(rows: Rows, sizes: Counts, counts: Counts) -> tuple[Entries, Labels]:
    """The same within groups: so many rows that follow each other get so many entries."""
    starts, firsts = np.cumsum(sizes) - sizes, np.cumsum(counts) - counts
    entries = rows[np.repeat(starts - firsts, counts) + np.arange(counts.sum())]
    for _ in range(ROUNDS):
        entries = _centred(rows, _nearest(rows, sizes, entries, counts), entries)
    return entries, _nearest(rows, sizes, entries, counts)


def _nearest(rows: Rows, sizes: Counts, entries: Entries, counts: Counts) -> Labels:
    """Which of its group's entries each row is most like."""
    labels, start, first = np.empty(len(rows), np.int64), 0, 0
    squares = (entries**2).sum(axis=1)
    for size, count in zip(sizes.tolist(), counts.tolist(), strict=True):
        own = slice(first, first + count)
        turned = -2 * entries[own].T
        for low in range(start, start + size, AT_ONCE):
            part = slice(low, min(low + AT_ONCE, start + size))
            labels[part] = first + (rows[part] @ turned + squares[own]).argmin(axis=1)
        start, first = start + size, first + count
    return labels


def _centred(rows: Rows, labels: Labels, entries: Entries) -> Entries:
    """The entries, moved to the middle of their rows; those without any stay."""
    counts = np.bincount(labels, minlength=len(entries))[:, None]
    ones, ends = np.ones(len(rows), np.float32), np.arange(len(rows) + 1)
    sums = csr_array((ones, labels, ends), (len(rows), len(entries))).T @ rows
    return np.where(counts > 0, sums / np.maximum(counts, 1), entries).astype(np.float32)


def _shares(errors: Float[np.ndarray, " G"], sizes: Counts, most: int) -> Counts:
    """How many entries each group gets: one at least if it has rows, and no more than it has."""
    shares = np.minimum(sizes, 1)
    for _ in range(ROUNDS):  # what a small group cannot take goes to the others
        wanted = np.where(shares < sizes, errors, 0.0)
        if not wanted.any():
            break
        more = wanted / wanted.sum() * (most - shares.sum())
        shares = np.minimum(sizes, shares + more.astype(np.int64))
    return shares
