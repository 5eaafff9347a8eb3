"""Compositing tiles front to back; `blend_backward` has the gradients.

A vector holds the 16 pixels of a 4 x 4 block. A pixel's transmittance turns 0 when the pixel is
finished (or lies outside the image), which stops the blending; what is left of the light is 1
minus the coverage.
"""

from typing import no_type_check

import numba
import numpy as np

from stylesplat.rendering import constants as const
from stylesplat.rendering.kernels import vec, vecs
from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.rendering.kernels.tiles import BLOCK, ROW_COLORS, TILE

BLOCKS = 16
PIXELS = 16  # in a block: the lanes of a vector


@no_type_check
@inner
def aligned(length):
    """An empty float32 array that starts at a cache line: vectors across two lines are slow."""
    array = np.empty(length + vec.LANES, np.float32)
    start = -(array.ctypes.data // 4) % vec.LANES
    return array[start : start + length]


@no_type_check
@inner
def prefetch_row(array, start, length):
    """Ask for all cache lines of a row."""
    for line in range(start, start + length, vec.LANES):
        vec.prefetch(array, line)


@no_type_check
@inner
def eighth_exponents(rows, row, dx, dy):
    """An eighth of the logarithm of a Gaussian's falloff at some pixels."""
    x_part = dx * vec.fma(dx, vec.spread(rows, row + 2), dy * vec.spread(rows, row + 3))
    return vec.fma(dy * vec.spread(rows, row + 4), dy, x_part)


@no_type_check
@inner
def pass_light(rows, row, y, hit, transmittance):
    """Composite one Gaussian over some pixels.

    Returns:
        Unclamped alpha, alpha (0 where it is not hit), weight, the new transmittance (0 where the
        pixel is finished), and which pixels are unfinished.
    """
    raw = vec.exp_of_eighth(y) * vec.spread(rows, row + 6)
    alpha = vec.select(hit, vec.minimum(raw, const.MAX_ALPHA), 0)
    weight = alpha * transmittance
    after = transmittance - weight
    live = vec.greater(after, const.MIN_TRANSMITTANCE)
    weight = vec.select(live, weight, 0)
    return raw, alpha, weight, vec.select(live, after, 0), live


@no_type_check
@inner
def list_blocks(lists, tile, rows, row_stride, entries, counts):
    """Sort a tile's entries by block: `entries` [BLOCKS, room], `counts` [BLOCKS].

    Asks for the entries' rows on the way.
    """
    starts, ranks, masks = lists
    counts[:] = 0
    for entry in range(starts[tile], starts[tile + 1]):
        prefetch_row(rows, ranks[entry] * row_stride, row_stride)
        todo = np.int64(masks[entry])
        while todo != 0:
            block = vec.lowest_bit(todo)
            todo &= todo - 1
            entries[block, counts[block]] = entry
            counts[block] += 1


@no_type_check
@inner
def blend_block(channels, rows, row_stride, ranks, entries, left, top, state):
    """Composite the entries over one block, front to back, until its pixels are finished.

    `state` holds the pixels' transmittance, and takes their coverage and colours.

    Returns:
        How many entries were looked at.
    """
    transmittance, coverage = vec.load(state, 0), vec.zero()
    sums = vecs.zeros(channels)
    pixel_x, pixel_y = vec.columns() + left, vec.rows() + top
    looked_at = 0
    for entry in entries:
        looked_at += 1
        row = ranks[entry] * row_stride
        dx, dy = pixel_x - vec.spread(rows, row), pixel_y - vec.spread(rows, row + 1)
        y = eighth_exponents(rows, row, dx, dy)
        hit = vec.greater_equal(y, vec.spread(rows, row + 5))
        _, _, weight, transmittance, live = pass_light(rows, row, y, hit, transmittance)
        coverage = coverage + weight
        sums = vecs.add_scaled_row(sums, weight, rows, row + ROW_COLORS)
        if vec.bits(live) == 0:
            break
    vec.store(state, 0, coverage)
    vecs.store_vecs(state, PIXELS, sums)
    return looked_at


@no_type_check
@inner
def open_block(state, columns, rows):
    """Transmittance 1 in the columns and rows inside the image, 0 outside."""
    for lane in range(PIXELS):
        state[lane] = 1 if (lane & 3) < columns and (lane >> 2) < rows else 0


@no_type_check
@inner
def close_block(channels, state, columns, rows, first, width, image, alphas):
    """Write a block's coverage and colours to the flat image, from pixel `first` on."""
    for y in range(min(rows, BLOCK)):
        for x in range(min(columns, BLOCK)):
            lane, pixel = y * BLOCK + x, first + y * width + x
            alphas[pixel] = state[lane]
            for c in range(len(channels)):
                image[pixel * len(channels) + c] = state[lane + (c + 1) * PIXELS]


@no_type_check
@kernel
def blend(channels, rows, row_stride, lists, width, height, image, alphas, threads):
    """Fill the flat image [H*W*D] and its coverage [H*W].

    Block by block, so that a block's colours stay in registers. Blocks that are finished are
    struck from the masks of the entries behind, so that the backward pass visits just what this
    one has drawn. `channels` is a tuple of length D.
    """
    starts, ranks, masks = lists
    tiles_x = -(-width // TILE)
    room = 0
    for tile in range(starts.shape[0] - 1):
        room = max(room, starts[tile + 1] - starts[tile])
    for thread in numba.prange(threads):
        state = aligned(PIXELS * (len(channels) + 1))
        entries, counts = np.empty((BLOCKS, room), np.int32), np.empty(BLOCKS, np.int64)
        for tile in range(thread, starts.shape[0] - 1, threads):
            list_blocks(lists, tile, rows, row_stride, entries, counts)
            for block in range(BLOCKS):
                x = TILE * (tile % tiles_x) + BLOCK * (block & 3)
                y = TILE * (tile // tiles_x) + BLOCK * (block >> 2)
                if x >= width or y >= height:
                    continue
                open_block(state, width - x, height - y)
                left, top = np.float32(x) + np.float32(0.5), np.float32(y) + np.float32(0.5)
                mine = entries[block, : counts[block]]
                done = blend_block(channels, rows, row_stride, ranks, mine, left, top, state)
                for entry in mine[done:]:
                    masks[entry] &= ~np.uint16(1 << block)
                first = y * width + x
                close_block(channels, state, width - x, height - y, first, width, image, alphas)
