"""Rows of numbers as a byte or two each: which entry of a palette they are like."""

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

ENTRIES = 256  # as many as a byte can name; the first is all zeros
SAMPLE = 20_000  # rows that a palette is made from
ROUNDS = 6  # of k-means; more change little
AT_ONCE = 16_384  # rows whose distances from all entries are in memory
MIDDLE, STEPS = 128, 127  # the byte of 0, and how many there are on each side

Bytes = UInt8[Tensor, "E D"]


def palette_of(values: Float[Tensor, "M D"], *, seed: int = 0) -> tuple[Bytes, float]:
    """Entries that rows are like (k-means, Lloyd 1982), rounded to bytes.

    Args:
        values: The rows.
        seed: Of the choice of rows that it is made from.

    Returns:
        The entries, and what the largest byte means.
    """
    generator = torch.Generator().manual_seed(seed)
    rows = values.ne(0).any(dim=1).nonzero()[:, 0]
    rows = rows[torch.randperm(len(rows), generator=generator)[:SAMPLE]]
    sample = values[rows]
    entries = values.new_zeros(ENTRIES, values.shape[1])
    first = sample[: ENTRIES - 1]
    entries[1 : 1 + len(first)] = first
    for _ in range(ROUNDS if len(sample) > len(first) else 0):
        entry = nearest(sample, entries)
        counts = torch.bincount(entry, minlength=ENTRIES)
        sums = torch.zeros_like(entries).index_add(0, entry, sample)
        found = counts > 0
        found[0] = False  # stays zero: rows without anything are so exactly
        entries[found] = sums[found] / counts[found, None]
    strongest = float(entries.abs().max()) or 1.0
    return (entries / strongest * STEPS + MIDDLE).round().byte(), strongest


def meant(palette: Bytes, strongest: float) -> Float[Tensor, "E D"]:
    """The values of a palette's bytes."""
    return (palette.float() - MIDDLE) / STEPS * strongest


def nearest(values: Float[Tensor, "M D"], entries: Float[Tensor, "E D"]) -> Int[Tensor, " M"]:
    """The entry that each row is most like."""
    squares = entries.square().sum(dim=1)
    parts = [(squares - 2 * part @ entries.T).argmin(dim=1) for part in values.split(AT_ONCE)]
    return torch.cat(parts) if parts else torch.zeros(0, dtype=torch.int64)
