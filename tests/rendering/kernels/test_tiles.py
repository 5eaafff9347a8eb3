"""Sorting Gaussians into tiles: nothing is out of order, whatever the threads."""

from itertools import pairwise

import numpy as np
import torch

from scenes import random_splats, two_cameras
from stylesplat.rendering import cpu
from stylesplat.rendering.kernels import tiles
from stylesplat.rendering.kernels.tiles import Ellipses
from stylesplat.rendering.kernels.vec import FlatRows
from stylesplat.rendering.reference import activated, views_of

GAUSSIANS = activated(random_splats())
SIZE = (70, 52)  # 5 x 4 tiles, the last ones cut


def test_lists_are_front_to_back_whatever_the_threads():
    projected = cpu.CpuRasterizer().project_gaussians(GAUSSIANS, views_of(two_cameras())[1])
    colors = torch.rand(len(GAUSSIANS.means), 3)
    ellipses = Ellipses(*projected[:3], colors)
    radii = projected.radii.numpy()
    order = tiles.depth_order(projected.depths.numpy(), radii)
    rows = FlatRows(torch.zeros(len(order) * 16).numpy(), 16)
    tiles.pack_rows(order, cpu.arrays(ellipses), rows)
    (totals,) = tiles.rank_groups(order, rows, radii, SIZE)
    starts, ranks, masks = expected = tiles.tile_lists(order, rows, radii, SIZE, totals, 1)
    for chunks in (2, 3, 16, 500):
        for found, wanted in zip(
            tiles.tile_lists(order, rows, radii, SIZE, totals, chunks), expected, strict=True
        ):
            assert np.array_equal(found, wanted)
    assert len(starts) == 21 and starts[0] == 0 and starts[-1] == len(ranks) == len(masks)
    for first, last in pairwise(starts):
        assert (np.diff(ranks[first:last]) > 0).all()


def test_ranks_are_cut_where_lists_would_become_too_long():
    count, size = 300, (3200, 3200)  # 40,000 tiles
    rows = FlatRows(np.full(count * 16, 1600, np.float32), 16)
    order = np.arange(count, dtype=np.int32)
    small, large = np.full((count, 2), 3, np.int32), np.full((count, 2), 1 << 30, np.int32)
    (whole,) = tiles.rank_groups(order, rows, small, size)
    assert len(whole) == count + 1 and whole[-1] <= 4 * count
    groups = tiles.rank_groups(order, rows, large, size)
    assert sum(len(totals) - 1 for totals in groups) == count and len(groups) > 2
    assert [totals[0] for totals in groups[1:]] == [totals[-1] for totals in groups[:-1]]
    assert all(totals[-1] - totals[0] <= tiles.ENTRIES_AT_ONCE for totals in groups)
    alone = tiles.rank_groups(order[:2], rows, large, (1 << 20, 1 << 17))
    assert [len(totals) for totals in alone] == [2, 2]  # one each, however many tiles it has
