"""Sorting Gaussians into tiles: nothing is lost, nothing is out of order."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from scenes import random_splats, two_cameras
from stylesplat.rendering import cpu
from stylesplat.rendering.gaussians import MIN_ALPHA, activated, views_of
from stylesplat.rendering.kernels import tiles
from stylesplat.rendering.kernels.tiles import Ellipses
from stylesplat.rendering.kernels.vec import Rows

GAUSSIANS = activated(random_splats())
SIZE = (70, 52)  # 5 x 4 tiles, the last ones cut


@pytest.fixture(scope="module")
def packed() -> tuple[np.ndarray, Rows, np.ndarray, Ellipses]:
    """The order, rows and radii of a scene in the second view, and what was packed."""
    projected = cpu.project_gaussians(GAUSSIANS, views_of(two_cameras())[1])
    ellipses = Ellipses(
        projected.means2d,
        projected.conics,
        GAUSSIANS.opacities,
        torch.rand(len(GAUSSIANS.means), 3),
    )
    order = tiles.depth_order(projected.depths.numpy(), projected.radii.numpy())
    rows = Rows(torch.zeros(len(order) * 16).numpy(), 16)
    tiles.pack_rows(order, cpu.arrays(ellipses), rows)
    return order, rows, projected.radii.numpy(), ellipses


@pytest.mark.parametrize("count", [0, 1, 2, 1000])
def test_depth_order_is_a_stable_sort_of_what_is_seen(count: int):
    generator = torch.Generator().manual_seed(count)
    depths = torch.rand(count, generator=generator) * 10.0 ** torch.randint(-2, 6, (count,))
    depths[::3] = 0.25  # ties
    radii = torch.randint(0, 3, (count, 1), generator=generator, dtype=torch.int32).repeat(1, 2)
    seen = (radii[:, 0] > 0).nonzero()[:, 0]
    expected = seen[torch.argsort(depths[seen], stable=True)]
    found = tiles.depth_order(depths.numpy(), radii.numpy())
    assert found.tolist() == expected.tolist()


def visible(ellipses: Ellipses, order: np.ndarray) -> torch.Tensor:
    """Whether the Gaussian of each rank is visible in each pixel [ranks, H, W]."""
    width, height = SIZE
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    means, conics, opacities = (t[order] for t in ellipses[:3])
    dx, dy = x - means[:, 0, None, None], y - means[:, 1, None, None]
    a, b, c = (conics[:, i, None, None] for i in range(3))
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    return opacities[:, None, None] * torch.exp(-sigma) >= MIN_ALPHA


def listed(lists: tiles.TileLists) -> dict[tuple[int, int], int]:
    """The mask of each (tile, rank)."""
    starts, ranks, masks = lists
    cuts = pairwise(starts)
    return {
        (tile, int(ranks[i])): int(masks[i])
        for tile, (first, last) in enumerate(cuts)
        for i in range(first, last)
    }


def test_every_pixel_finds_every_gaussian_that_it_sees(packed):
    order, rows, radii, ellipses = packed
    masks = listed(tiles.tile_lists(order, rows, radii, SIZE, 2))
    pairs = visible(ellipses, order).nonzero().tolist()
    assert len(pairs) > 10_000
    for rank, y, x in pairs:
        block = y % 16 // 4 * 4 + x % 16 // 4
        assert masks.get((y // 16 * 5 + x // 16, rank), 0) >> block & 1


def test_blocks_are_listed_for_a_reason(packed):
    # A block is listed if the ellipse reaches the box of its pixel centres, so now and then it
    # passes between them: one listed block in ten is without a visible pixel here, and of the
    # bounding boxes' blocks more than a third.
    order, rows, radii, ellipses = packed
    width, height = SIZE
    seen = torch.nn.functional.pad(
        visible(ellipses, order).float(), (0, 80 - width, 0, 64 - height)
    )
    blocks = torch.nn.functional.max_pool2d(seen, 4).sum()
    entries = listed(tiles.tile_lists(order, rows, radii, SIZE, 2)).values()
    assert blocks <= sum(mask.bit_count() for mask in entries) < 1.25 * blocks


@pytest.mark.parametrize("chunks", [1, 2, 3, 16, 500])
def test_lists_are_front_to_back_whatever_the_threads(packed, chunks: int):
    order, rows, radii, _ = packed
    starts, ranks, masks = tiles.tile_lists(order, rows, radii, SIZE, chunks)
    expected = tiles.tile_lists(order, rows, radii, SIZE, 1)
    for found, wanted in zip((starts, ranks, masks), expected, strict=True):
        assert np.array_equal(found, wanted)
    assert len(starts) == 21 and starts[0] == 0 and starts[-1] == len(ranks) == len(masks)
    for first, last in pairwise(starts):
        assert (np.diff(ranks[first:last]) > 0).all()
