"""From projected Gaussians to one front-to-back list per image tile.

A tile is 16 x 16 pixels, cut into 16 blocks of 4 x 4. Every entry of a tile's list carries a
16-bit mask of the blocks that the Gaussian's ellipse truly touches, so that the blending kernels
never look at the others.
"""

from math import ceil, floor, log
from typing import no_type_check

import numba
import numpy as np

from stylesplat.rendering import constants as const
from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner, kernel, serial_kernel

TILE = 16
BLOCK = 4
HALF = np.float32(0.5)
ROW_COLORS = 8  # where the colours start in a packed row
RADIX_BITS = 11
SLACK = np.float32(1e-4)  # widens the block test: rounding must not lose a pixel


def row_stride(channels: int) -> int:
    """Length of a packed row: a multiple of 16 floats, one cache line."""
    return -(-(ROW_COLORS + channels) // vec.LANES) * vec.LANES


@no_type_check
@serial_kernel
def depth_order(depths, radii):
    """Indices of the Gaussians with a radius, nearest first: a stable radix sort."""
    order = np.empty(depths.shape[0], np.int32)
    count = 0
    for i in range(depths.shape[0]):
        if radii[i, 0] > 0:
            order[count] = i
            count += 1
    order, other = order[:count], np.empty(count, np.int32)
    keys = depths.view(np.uint32)  # positive floats sort like their bits
    bucket_mask = np.uint32((1 << RADIX_BITS) - 1)
    starts = np.empty((1 << RADIX_BITS) + 1, np.int64)
    for shift in (np.uint32(0), np.uint32(RADIX_BITS), np.uint32(2 * RADIX_BITS)):
        starts[:] = 0
        for i in order:
            starts[np.int64((keys[i] >> shift) & bucket_mask) + 1] += 1
        for bucket in range(1, starts.shape[0]):
            starts[bucket] += starts[bucket - 1]
        for i in order:
            bucket = np.int64((keys[i] >> shift) & bucket_mask)
            other[starts[bucket]] = i
            starts[bucket] += 1
        order, other = other, order
    return order


@no_type_check
@kernel
def pack_rows(order, means2d, conics, opacities, colors, rows):
    """Gather what blending reads of a Gaussian into one row, in depth order.

    Columns: mean x y; factors of x x, x y and y y in an eighth of the exponent (see `vec.py`); the
    eighth below which it is invisible; opacity; unused; colours.
    """
    for rank in numba.prange(order.shape[0]):
        i = order[rank]
        rows[rank, 0], rows[rank, 1] = means2d[i, 0], means2d[i, 1]
        rows[rank, 2], rows[rank, 3] = -conics[i, 0] / 16, -conics[i, 1] / 8
        rows[rank, 4] = -conics[i, 2] / 16
        rows[rank, 5] = -log(opacities[i] / const.MIN_ALPHA) / 8
        rows[rank, 6] = opacities[i]
        for c in range(colors.shape[1]):
            rows[rank, ROW_COLORS + c] = colors[i, c]


@no_type_check
@inner
def block_mask(rows, row, slope_x, slope_y, left, top):
    """Bit b is set if the ellipse of a packed row reaches a pixel centre's box in block b.

    `left` and `top` are the first pixel centre of the tile, relative to the Gaussian's. The
    exponent is greatest over a box at the Gaussian's centre if that is inside, else on one of the
    two sides that face it: lane b tries both. Along a side at x it is greatest at `slope_y` x.
    """
    a, b, c = vec.spread(rows, row + 2), vec.spread(rows, row + 3), vec.spread(rows, row + 4)
    low_x, low_y = vec.fma(vec.columns(), BLOCK, left), vec.fma(vec.rows(), BLOCK, top)
    high_x, high_y = low_x + (BLOCK - 1), low_y + (BLOCK - 1)
    near_x = vec.minimum(vec.maximum(low_x, 0), high_x)
    near_y = vec.minimum(vec.maximum(low_y, 0), high_y)
    best_y = vec.minimum(vec.maximum(near_x * slope_y, low_y), high_y)
    best_x = vec.minimum(vec.maximum(near_y * slope_x, low_x), high_x)
    side_x = vec.fma(near_x, vec.fma(near_x, a, best_y * b), best_y * best_y * c)
    side_y = vec.fma(best_x, vec.fma(best_x, a, near_y * b), near_y * near_y * c)
    return vec.bits(vec.greater_equal(vec.maximum(side_x, side_y), rows[row + 5] - SLACK))


@no_type_check
@inner
def tile_span(center, radius, tiles):
    """First tile and the one after the last that an interval of pixels touches."""
    first = max(floor((center - radius) / TILE), 0)
    return first, min(ceil((center + radius) / TILE), tiles)


@no_type_check
@kernel
def list_entries(order, rows, stride, radii, tiles_x, tiles_y, starts, tiles, ranks, masks):
    """List (tile, rank, mask) chunk by chunk; count the entries of each chunk and tile.

    Returns:
        counts [chunks, tiles] and, per chunk, how many entries it wrote from `starts[chunk]` on.
    """
    chunks = starts.shape[0] - 1
    counts = np.zeros((chunks, tiles_x * tiles_y), np.int64)
    written = np.zeros(chunks, np.int64)
    n = order.shape[0]
    for chunk in numba.prange(chunks):
        entry = starts[chunk]
        for rank in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            row, i = rank * stride, order[rank]
            x, y = rows[row], rows[row + 1]
            first_x, last_x = tile_span(x, radii[i, 0], tiles_x)
            first_y, last_y = tile_span(y, radii[i, 1], tiles_y)
            lean = np.float32(-0.5) * rows[row + 3]
            slope_x, slope_y = lean / rows[row + 2], lean / rows[row + 4]
            for tile_y in range(first_y, last_y):
                top = np.float32(TILE * tile_y) + HALF - y
                for tile_x in range(first_x, last_x):
                    left = np.float32(TILE * tile_x) + HALF - x
                    mask = block_mask(rows, row, slope_x, slope_y, left, top)
                    if mask != 0:
                        tile = tile_y * tiles_x + tile_x
                        tiles[entry], ranks[entry], masks[entry] = tile, rank, mask
                        counts[chunk, tile] += 1
                        entry += 1
        written[chunk] = entry - starts[chunk]
    return counts, written


@no_type_check
@inner
def entry_bounds(order, rows, stride, radii, tiles_x, tiles_y, chunks):
    """Where each chunk may start to write its entries: the tiles under the bounding boxes."""
    starts = np.zeros(chunks + 1, np.int64)
    n, total = order.shape[0], 0
    for chunk in range(chunks):
        for rank in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            row, i = rank * stride, order[rank]
            first_x, last_x = tile_span(rows[row], radii[i, 0], tiles_x)
            first_y, last_y = tile_span(rows[row + 1], radii[i, 1], tiles_y)
            total += max(last_x - first_x, 0) * max(last_y - first_y, 0)
        starts[chunk + 1] = total
    return starts


@no_type_check
@kernel
def scatter_entries(starts, written, tiles, ranks, masks, offsets, tile_ranks, tile_masks):
    """Move the chunks' entries to their tiles; chunks are in depth order, so lists are too."""
    for chunk in numba.prange(written.shape[0]):
        for entry in range(starts[chunk], starts[chunk] + written[chunk]):
            place = offsets[chunk, tiles[entry]]
            tile_ranks[place], tile_masks[place] = ranks[entry], masks[entry]
            offsets[chunk, tiles[entry]] = place + 1


@no_type_check
@serial_kernel
def tile_lists(order, rows, stride, radii, width, height, chunks):
    """The list of every tile, made by `chunks` threads, from flat `rows` of length `stride`.

    Returns:
        `tile_starts` [tiles + 1], and the `ranks` and `masks` that they cut into lists.
    """
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    starts = entry_bounds(order, rows, stride, radii, tiles_x, tiles_y, chunks)
    room = starts[-1]
    tiles, ranks = np.empty(room, np.int32), np.empty(room, np.int32)
    masks = np.empty(room, np.uint16)
    counts, written = list_entries(
        order, rows, stride, radii, tiles_x, tiles_y, starts, tiles, ranks, masks
    )
    tile_starts = np.zeros(tiles_x * tiles_y + 1, np.int64)
    offsets = np.empty_like(counts)
    place = 0
    for tile in range(counts.shape[1]):
        for chunk in range(counts.shape[0]):
            offsets[chunk, tile] = place
            place += counts[chunk, tile]
        tile_starts[tile + 1] = place
    tile_ranks, tile_masks = np.empty(place, np.int32), np.empty(place, np.uint16)
    scatter_entries(starts, written, tiles, ranks, masks, offsets, tile_ranks, tile_masks)
    return tile_starts, tile_ranks, tile_masks
