"""Compositing tiles front to back, and the gradients of everything that goes into it.

A vector holds the 16 pixels of a 4 x 4 block. A pixel's transmittance turns 0 when the pixel is
finished (or lies outside the image), which stops the blending; what is left of the light is 1
minus the coverage.
"""

from typing import NamedTuple

import numba
import numpy as np

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inlined, inner, kernel, serial_kernel
from stylesplat.rendering.kernels.tiles import BLOCK, ROW_COLORS, TILE
from stylesplat.rendering.kernels.vec import FlatRows, RowPlace, spread_row
from stylesplat.rendering.reference import MAX_ALPHA, MIN_TRANSMITTANCE

BLOCKS = 16
PIXELS = 16  # in a block: the lanes of a vector
AHEAD = 6  # entries by which rows are prefetched
MOMENTS = 6  # gradient numbers of the ellipse, in front of the colours'
MOMENT_CHANNELS = vec.channels(MOMENTS)
NONE = vec.channels(0)
HEAD = vec.LANES - MOMENTS  # channels whose sums share the first vector of a row with the moments


class FlatImage(NamedTuple):
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
    transmittance, coverage = vec.load_vec(state, light), vec.load_vec(state, 0)
    sums = vec.load_vecs(state, PIXELS, channels)
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
        sums = vec.add_scaled_row(sums, step.weight, row.flat, row.first + ROW_COLORS)
        if vec.bits(step.live) == 0:
            break
    vec.store_vec(state, light, transmittance)
    vec.store_vec(state, 0, coverage)
    vec.store_vecs(state, PIXELS, sums)
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
        if vec.bits(vec.greater(vec.load_vec(states, first + length - PIXELS), 0)) != 0:
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


class ChannelSplit(NamedTuple):
    """The channels of an image, as `vec.channels`."""

    head: tuple[int, ...]
    """The first, `HEAD` at most: as many sums as fit the registers."""
    tail: tuple[int, ...]
    """The others."""
    geometry: tuple[int, ...]
    """Those, from the first on, whose gradients reach the ellipses."""


class Totals(NamedTuple):
    """Sums over pixels, `Vecs` each: moments of the ellipse's gradient, gradients of channels."""

    moments: object
    channels: object


class TileBuffers(NamedTuple):
    """What a thread works on: one tile."""

    state: np.ndarray
    """Per block: transmittance, gradient-weighted light still to come, gradients of the pixels."""
    weights: np.ndarray
    """Per block: what the Gaussian at hand contributes."""
    corners: np.ndarray
    """Column of the left and row of the upper pixels of the blocks of a tile [2 * BLOCKS]."""


def split_channels(count: int, geometry: int) -> ChannelSplit:
    """So many channels, of which the first reach the geometry."""
    head = min(count, HEAD)
    return ChannelSplit(*(vec.channels(n) for n in (head, count - head, geometry)))


@serial_kernel
def gradient_stride(channels):
    """Length of a row of gradients: a multiple of 16 floats."""
    return -(-(MOMENTS + channels) // vec.LANES) * vec.LANES


@inner
def block_stride(channels):
    """Length of what `TileBuffers.state` holds of a block."""
    return PIXELS * (len(channels.head) + len(channels.tail) + 2)


@inner
def tile_buffers(channels):
    """Room for a tile's numbers."""
    corners = aligned(2 * BLOCKS)
    for block in range(BLOCKS):
        corners[block] = BLOCK * (block & 3)
        corners[block + BLOCKS] = BLOCK * (block >> 2)
    return TileBuffers(aligned(BLOCKS * block_stride(channels)), aligned(BLOCKS * PIXELS), corners)


@inner
def open_gradients(channels, state, tile, picture, v_picture):
    """Fill `TileBuffers.state` for a tile, with 0 outside the image."""
    image, alphas, width, _ = picture
    v_image, v_alphas, _, _ = v_picture
    stride, depth = block_stride(channels), len(channels.head) + len(channels.tail)
    if tile.rows < TILE or tile.columns < TILE:
        state[:] = 0
    for y in range(tile.rows):
        for x in range(tile.columns):
            block, lane = (y >> 2) * 4 + (x >> 2), (y & 3) * 4 + (x & 3)
            place, pixel = block * stride + lane, tile.first + y * width + x
            rest = (alphas[pixel] - np.float32(1)) * v_alphas[pixel]
            for c in range(depth):
                gradient = v_image[pixel * depth + c]
                if c < len(channels.geometry):
                    rest += gradient * image[pixel * depth + c]
                state[place + (c + 2) * PIXELS] = gradient
            state[place], state[place + PIXELS] = np.float32(1), rest


@inlined
def block_gradients(geometry, row, pixels, block, totals):
    """Add one block's share to a Gaussian's gradients, and take its light from the block.

    `pixels` are their places from the Gaussian's centre.

    Returns:
        What the Gaussian contributes to the pixels, and the new totals.
    """
    state, first = block
    step = composite_pixels(row, pixels[0], pixels[1], vec.load_vec(state, first))
    weight = step.weight
    gradients = vec.load_vecs(state, first + 2 * PIXELS, geometry)
    gain = weight * vec.dot_row(gradients, row.flat, row.first + ROW_COLORS)
    rest = vec.load_vec(state, first + PIXELS) - gain
    v_colors = vec.load_vecs(state, first + 2 * PIXELS, totals.channels)
    sums = vec.add_products(totals.channels, weight, v_colors)
    vec.store_vec(state, first, step.after)
    vec.store_vec(state, first + PIXELS, rest)
    follows = vec.both(vec.both(step.counts, step.live), vec.greater_equal(MAX_ALPHA, step.raw))
    behind = step.alpha * rest * vec.reciprocal(1 - step.alpha)
    v_s = vec.select(follows, gain - behind, 0)
    return weight, Totals(vec.add_moments(totals.moments, v_s, pixels[0], pixels[1]), sums)


@inlined
def entry_gradients(channels, row, blocks, origin, buffers, out):
    """Add a tile's share to a Gaussian's gradients, from the place `out` on; see `blend_backward`.

    Two passes over the blocks, with as many sums as fit the registers in each.
    """
    head, tail, geometry = channels
    state, weights, corners = buffers
    stride = block_stride(channels)
    totals = Totals(vec.zeros(MOMENT_CHANNELS), vec.zeros(head))
    first_dx = (vec.columns() + origin[0]) - spread_row(row, 0)
    first_dy = (vec.rows() + origin[1]) - spread_row(row, 1)
    todo = blocks
    while todo != 0:
        block = vec.lowest_bit(todo)
        todo &= todo - 1
        dx = first_dx + vec.spread(corners, block)
        dy = first_dy + vec.spread(corners, block + BLOCKS)
        place = RowPlace(state, block * stride)
        weight, totals = block_gradients(geometry, row, (dx, dy), place, totals)
        if len(tail) > 0:
            vec.store_vec(weights, block * PIXELS, weight)
    vec.add_lane_sums(out.flat, out.first, totals.moments, totals.channels)
    if len(tail) > 0:
        rest = vec.zeros(tail)
        while blocks != 0:
            block = vec.lowest_bit(blocks)
            blocks &= blocks - 1
            weight = vec.load_vec(weights, block * PIXELS)
            at = block * stride + (2 + len(head)) * PIXELS
            rest = vec.add_products(rest, weight, vec.load_vecs(state, at, tail))
        vec.add_lane_sums(out.flat, out.first + vec.LANES, vec.zeros(NONE), rest)


@kernel
def blend_backward(channels, rows, lists, picture, v_picture, out):
    """Add each thread's gradients to its own rows `out` [threads, M * stride].

    `picture` is the result of `blend_forward`. A row of `out` holds the moments sum(v_s) of 1, x,
    y, x x, x y, y y, where v_s is the gradient of the exponent at a pixel and x, y its offset from
    the Gaussian; then the gradients of the colours.
    """
    starts, ranks, masks = lists
    head, tail, geometry = channels
    width, height = picture.width, picture.height
    out_stride = gradient_stride(len(head) + len(tail))
    for thread in numba.prange(out.shape[0]):
        parts = ChannelSplit(head, tail, geometry)  # prange takes flat tuples only
        buffers = tile_buffers(parts)
        mine = FlatRows(out[thread], out_stride)
        for tile in range(thread, starts.shape[0] - 1, out.shape[0]):
            x, y = tile_corner(tile, width)
            patch = Patch(y * width + x, min(TILE, width - x), min(TILE, height - y))
            open_gradients(parts, buffers.state, patch, picture, v_picture)
            origin = x + np.float32(0.5), y + np.float32(0.5)
            for entry in range(starts[tile], starts[tile + 1]):
                ahead = ranks[min(entry + AHEAD, ranks.shape[0] - 1)]
                prefetch_row(rows, ahead)
                prefetch_row(mine, ahead)
                if masks[entry] == 0:
                    continue
                row = RowPlace(rows.flat, ranks[entry] * rows.stride)
                place = RowPlace(mine.flat, ranks[entry] * mine.stride)
                entry_gradients(parts, row, np.int64(masks[entry]), origin, buffers, place)


@kernel
def collect_gradients(order, rows, partial, v_ellipses):
    """Sum the threads' rows [threads, M, stride] into the gradients of the Gaussians drawn."""
    v_means2d, v_conics, v_opacities, v_colors = v_ellipses
    flat, stride = rows
    for rank in numba.prange(order.shape[0]):
        i, row = order[rank], rank * stride
        total = partial[0, rank]
        for thread in range(1, partial.shape[0]):
            total += partial[thread, rank]
        a, b, c = -16 * flat[row + 2], -8 * flat[row + 3], -16 * flat[row + 4]
        v_means2d[i, 0] = a * total[1] + b * total[2]
        v_means2d[i, 1] = b * total[1] + c * total[2]
        v_conics[i, 0], v_conics[i, 1], v_conics[i, 2] = -0.5 * total[3], -total[4], -0.5 * total[5]
        v_opacities[i] = total[0] / flat[row + 6]
        for channel in range(v_colors.shape[1]):
            v_colors[i, channel] = total[MOMENTS + channel]
