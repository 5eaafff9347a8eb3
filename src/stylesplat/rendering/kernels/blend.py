"""Compositing tiles front to back; `blend_backward` has the gradients.

A vector holds the 16 pixels of a 4 x 4 block. A pixel's transmittance turns 0 when the pixel is
finished (or lies outside the image), which stops the blending; what is left of the light is 1
minus the coverage.
"""

from typing import NamedTuple

import numba
import numpy as np

from stylesplat.rendering.gaussians import MAX_ALPHA, MIN_TRANSMITTANCE
from stylesplat.rendering.kernels import vec, vecs
from stylesplat.rendering.kernels.jit import inner, kernel, serial_kernel
from stylesplat.rendering.kernels.tiles import BLOCK, ROW_COLORS, TILE
from stylesplat.rendering.kernels.vec import RowPlace, spread_row

BLOCKS = 16
PIXELS = 16  # in a block: the lanes of a vector


class Picture(NamedTuple):
    """A flat image [H*W*D] and its coverage [H*W]; or the gradients of both."""

    image: np.ndarray
    alphas: np.ndarray
    width: int
    height: int


class Patch(NamedTuple):
    """A part of an image: its first pixel, and how many columns and rows there are from there."""

    first: int
    columns: int
    rows: int


class Composite(NamedTuple):
    """What one Gaussian does to the light of some pixels, a vector or mask each."""

    raw: object
    """Alpha before it is clamped."""
    alpha: object
    """0 where the Gaussian is too faint."""
    weight: object
    """Alpha times transmittance: what the Gaussian adds to the pixel."""
    after: object
    """The new transmittance, 0 where the pixel is finished."""
    counts: object
    """Where the Gaussian is not too faint."""
    live: object
    """Where the pixel is unfinished."""


@inner
def aligned(length):
    """An empty float32 array that starts at a cache line: vectors across two lines are slow."""
    array = np.empty(length + vec.LANES, np.float32)
    start = -(array.ctypes.data // 4) % vec.LANES
    return array[start : start + length]


@inner
def prefetch_row(rows, number):
    """Ask for all cache lines of a row."""
    first = number * rows.stride
    for line in range(first, first + rows.stride, vec.LANES):
        vec.prefetch(rows.flat, line)


@inner
def composite_pixels(row, dx, dy, transmittance):
    """Send the light of some pixels through the Gaussian of a packed row; see `Composite`.

    `dx` and `dy` are the pixels' places from its centre.
    """
    x_part = dx * vec.fma(dx, spread_row(row, 2), dy * spread_row(row, 3))
    eighth = vec.fma(dy * spread_row(row, 4), dy, x_part)
    counts = vec.greater_equal(eighth, spread_row(row, 5))
    raw = vec.exp_of_eighth(eighth) * spread_row(row, 6)
    alpha = vec.select(counts, vec.minimum(raw, MAX_ALPHA), 0)
    weight = alpha * transmittance
    after = transmittance - weight
    live = vec.greater(after, MIN_TRANSMITTANCE)
    weight = vec.select(live, weight, 0)
    return Composite(raw, alpha, weight, vec.select(live, after, 0), counts, live)


@inner
def list_blocks(lists, tile, rows, entries, counts):
    """Sort a tile's entries by block: `entries` [BLOCKS, room], `counts` [BLOCKS].

    Asks for the entries' rows on the way.
    """
    starts, ranks, masks = lists
    counts[:] = 0
    for entry in range(starts[tile], starts[tile + 1]):
        prefetch_row(rows, ranks[entry])
        todo = np.int64(masks[entry])
        while todo != 0:
            block = vec.lowest_bit(todo)
            todo &= todo - 1
            entries[block, counts[block]] = entry
            counts[block] += 1


@inner
def tile_corner(tile, width):
    """Left column and upper row of a tile of an image of this width."""
    tiles_x = -(-width // TILE)
    return TILE * (tile % tiles_x), TILE * (tile // tiles_x)


@inner
def block_corner(corner, block):
    """Left column and upper row of a block, from those of its tile."""
    return corner[0] + BLOCK * (block & 3), corner[1] + BLOCK * (block >> 2)


@inner
def block_pixels(x, y):
    """The centres of the pixels of a block."""
    left, top = np.float32(x) + np.float32(0.5), np.float32(y) + np.float32(0.5)
    return vec.columns() + left, vec.rows() + top


@serial_kernel
def state_length(channels):
    """Length of the state of a block: its pixels' coverage, colours and transmittance."""
    return PIXELS * (len(channels) + 2)


@inner
def blend_block(channels, rows, ranks, entries, pixels, state):
    """Composite the entries over one block, front to back, until its pixels are finished.

    Returns how many entries were visited.
    """
    light = PIXELS * (len(channels) + 1)
    transmittance, coverage = vec.load(state, light), vec.load(state, 0)
    sums = vecs.load_vecs(state, PIXELS, channels)
    pixel_x, pixel_y = pixels
    visited = 0
    if vec.bits(vec.greater(transmittance, 0)) == 0:
        return visited
    for entry in entries:
        visited += 1
        row = RowPlace(rows.flat, ranks[entry] * rows.stride)
        dx, dy = pixel_x - spread_row(row, 0), pixel_y - spread_row(row, 1)
        step = composite_pixels(row, dx, dy, transmittance)
        transmittance = step.after
        coverage = coverage + step.weight
        sums = vecs.add_scaled_row(sums, step.weight, row.flat, row.first + ROW_COLORS)
        if vec.bits(step.live) == 0:
            break
    vec.store(state, light, transmittance)
    vec.store(state, 0, coverage)
    vecs.store_vecs(state, PIXELS, sums)
    return visited


@inner
def open_block(light, columns, rows):
    """Transmittance 1 in the columns and rows inside the image, 0 outside."""
    for lane in range(PIXELS):
        light[lane] = 1 if (lane & 3) < columns and (lane >> 2) < rows else 0


@inner
def strike(masks, entries, block):
    """Take a block from the masks of some entries."""
    for entry in entries:
        masks[entry] &= ~np.uint16(1 << block)


@inner
def close_block(channels, state, block, picture):
    """Write a block's coverage and colours to the picture."""
    image, alphas, width, _ = picture
    for y in range(min(block.rows, BLOCK)):
        for x in range(min(block.columns, BLOCK)):
            lane, pixel = y * BLOCK + x, block.first + y * width + x
            alphas[pixel] = state[lane]
            for c in range(len(channels)):
                image[pixel * len(channels) + c] = state[lane + (c + 1) * PIXELS]


@serial_kernel
def is_finished(channels, states):
    """Whether no pixel of the blocks of some states has light left."""
    length = state_length(channels)
    for first in range(0, states.shape[0], length):
        if vec.bits(vec.greater(vec.load(states, first + length - PIXELS), 0)) != 0:
            return False
    return True


@kernel
def blend_forward(channels, rows, lists, picture, states, begins, threads):
    """Fill the picture.

    Block by block, so that a block's colours stay in registers. Blocks that are finished are
    struck from the masks of the entries behind, and blocks outside the image from all, so that the
    backward pass visits just what this one has drawn.

    `states` [tiles * BLOCKS * state_length] is for lists that come in groups, else empty: what a
    group leaves the next goes on from. `begins` says that this is the first.
    """
    starts, ranks, masks = lists
    width, height = picture.width, picture.height
    room = 0
    for tile in range(starts.shape[0] - 1):
        room = max(room, starts[tile + 1] - starts[tile])
    for thread in numba.prange(threads):
        length = state_length(channels)
        state = aligned(length)
        entries, counts = np.empty((BLOCKS, room), np.int32), np.empty(BLOCKS, np.int64)
        for tile in range(thread, starts.shape[0] - 1, threads):
            list_blocks(lists, tile, rows, entries, counts)
            corner = tile_corner(tile, width)
            for block in range(BLOCKS):
                mine = entries[block, : counts[block]]
                x, y = block_corner(corner, block)
                if x >= width or y >= height:
                    strike(masks, mine, block)
                    continue
                if states.shape[0] > 0:
                    place = (tile * BLOCKS + block) * length
                    state = states[place : place + length]
                if begins:
                    state[:] = 0
                    open_block(state[length - PIXELS :], width - x, height - y)
                done = blend_block(channels, rows, ranks, mine, block_pixels(x, y), state)
                strike(masks, mine[done:], block)
                close_block(channels, state, Patch(y * width + x, width - x, height - y), picture)
