import tracemalloc

import numpy as np
import pytest
import torch

from stylesplat.io.splats.packing import (
    encode,
    fit_codebook,
    morton_order,
    tree_kmeans,
)


def rows(count: int, columns: int = 9) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, columns)).astype(np.float32)


def error(values: np.ndarray, entries: np.ndarray, labels: np.ndarray) -> float:
    return float(((values - entries[labels]) ** 2).mean())


def test_many_equal_rows_take_few_entries():
    """As painted objects have them, whose higher bands are all 0."""
    values = np.concatenate([rows(500), np.zeros((5000, 9), np.float32)])
    entries, labels = tree_kmeans(values, 4096)
    assert len(entries) < 600 and error(values, entries, labels) < 1e-3


def test_memory_is_limited_where_most_rows_are_zeros():
    """Distances of all rows from all entries would take 280 MB."""
    values = np.concatenate([rows(3000), np.zeros((55_000, 9), np.float32)])
    tracemalloc.start()
    entries, labels = tree_kmeans(values, 4096)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6
    assert len(entries) <= 3001 and error(values, entries, labels) < 1e-3


@pytest.mark.parametrize("numbers", [[], [3.5], [2.0] * 50, [1.0, 2.0]])
def test_few_numbers_are_exact(numbers: list[float]):
    values = np.array(numbers)
    codebook = fit_codebook(values)
    np.testing.assert_allclose(codebook[encode(values, codebook)], values)


def test_an_order_in_which_neighbours_follow_each_other():
    corners = torch.cartesian_prod(*[torch.tensor([0.0, 1.0, 8.0, 9.0])] * 3)
    shuffled = corners[torch.randperm(64, generator=torch.Generator().manual_seed(0))]
    for octant in shuffled[morton_order(shuffled)].split(8):  # each is done before the next begins
        assert (octant.amax(dim=0) - octant.amin(dim=0)).tolist() == [1, 1, 1]
    assert morton_order(torch.zeros(3, 3)).tolist() == [0, 1, 2]
    assert not len(morton_order(torch.zeros(0, 3)))
