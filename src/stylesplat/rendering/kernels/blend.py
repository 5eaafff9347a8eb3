"""Compositing tiles front to back, and the gradients of everything that goes in.

A vector holds the 16 pixels of a 4 x 4 block. A pixel's transmittance turns 0 when the pixel is
finished (or lies outside the image), which stops the blending; what is left of the light is 1
minus the coverage.
"""

from typing import no_type_check

import numba
import numpy as np

from stylesplat.rendering import constants as const
from stylesplat.rendering.kernels import vec, vecs
from stylesplat.rendering.kernels.tiles import BLOCK, ROW_COLORS, TILE

BLOCKS = 16
PIXELS = 16  # in a block: the lanes of a vector
AHEAD = 6  # entries by which rows are prefetched
MOMENTS = 6  # gradient numbers of the ellipse, in front of the colours'
MOMENT_CHANNELS = (0,) * MOMENTS
HEAD = vec.LANES - MOMENTS  # channels whose sums share the first vector of a row with the moments


@no_type_check
@numba.njit(cache=True)
def gradient_stride(channels):
    """Length of a row of gradients: a multiple of 16 floats."""
    return -(-(MOMENTS + channels) // vec.LANES) * vec.LANES


@no_type_check
@numba.njit(cache=True)
def aligned(length):
    """An empty float32 array that starts at a cache line: vectors across two lines are slow."""
    array = np.empty(length + vec.LANES, np.float32)
    start = -(array.ctypes.data // 4) % vec.LANES
    return array[start : start + length]


@no_type_check
@numba.njit(cache=True)
def prefetch_row(array, start, length):
    """Ask for all cache lines of a row."""
    for line in range(start, start + length, vec.LANES):
        vec.prefetch(array, line)


@no_type_check
@numba.njit(cache=True)
def eighth_exponents(rows, row, dx, dy):
    """An eighth of the logarithm of a Gaussian's falloff at some pixels."""
    x_part = dx * vec.fma(dx, vec.spread(rows, row + 2), dy * vec.spread(rows, row + 3))
    return vec.fma(dy * vec.spread(rows, row + 4), dy, x_part)


@no_type_check
@numba.njit(cache=True)
def pass_light(rows, row, y, hit, transmittance):
    """Composite one Gaussian over some pixels.

    Returns:
        Unclamped alpha, alpha (0 where it is not hit), weight, the new transmittance (0 where the
        pixel is finished), and which pixels are unfinished.
    """
    raw = vec.exp_of_eighth(y) * vec.spread(rows, row + 6)
    alpha = vec.select(hit, vec.minimum(raw, np.float32(const.MAX_ALPHA)), np.float32(0))
    weight = alpha * transmittance
    after = transmittance - weight
    live = vec.greater(after, np.float32(const.MIN_TRANSMITTANCE))
    weight = vec.select(live, weight, np.float32(0))
    return raw, alpha, weight, vec.select(live, after, np.float32(0)), live


@no_type_check
@numba.njit(cache=True)
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
@numba.njit(cache=True)
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
        if vec.bits(hit) != 0:
            _, _, weight, transmittance, live = pass_light(rows, row, y, hit, transmittance)
            coverage = coverage + weight
            sums = vecs.add_scaled_row(sums, weight, rows, row + ROW_COLORS)
            if vec.bits(live) == 0:
                break
    vec.store(state, 0, coverage)
    vecs.store_vecs(state, PIXELS, sums)
    return looked_at


@no_type_check
@numba.njit(cache=True)
def open_block(state, columns, rows):
    """Transmittance 1 in the columns and rows inside the image, 0 outside."""
    for lane in range(PIXELS):
        state[lane] = 1 if (lane & 3) < columns and (lane >> 2) < rows else 0


@no_type_check
@numba.njit(cache=True)
def close_block(channels, state, columns, rows, first, width, image, alphas):
    """Write a block's coverage and colours to the flat image, from pixel `first` on."""
    for y in range(min(rows, BLOCK)):
        for x in range(min(columns, BLOCK)):
            lane, pixel = y * BLOCK + x, first + y * width + x
            alphas[pixel] = state[lane]
            for c in range(len(channels)):
                image[pixel * len(channels) + c] = state[lane + (c + 1) * PIXELS]


@no_type_check
@numba.njit(cache=True, parallel=True)
def blend(channels, rows, row_stride, lists, width, height, image, alphas, threads):
    """Fill the flat image [H*W*D] and its coverage [H*W].

    Block by block, so that a block's colours stay in registers. Blocks that are finished are
    struck from the masks of the entries behind, so that the backward pass visits just what this
    one has drawn. `channels` is a tuple of length D.
    """
    starts, ranks, masks = lists
    tiles_x = -(-width // TILE)
    room = np.diff(starts).max()
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


@no_type_check
@numba.njit(cache=True)
def open_gradients(channels, state, columns, rows, first, width, pixels, geometry_channels):
    """Per block: transmittance, the gradient-weighted light still to come, pixel gradients.

    All are 0 outside the image.
    """
    image, alphas, v_image, v_alphas = pixels
    stride = PIXELS * (len(channels) + 2)
    if rows < TILE or columns < TILE:
        state[:] = 0
    for y in range(rows):
        for x in range(columns):
            block, lane = (y >> 2) * 4 + (x >> 2), (y & 3) * 4 + (x & 3)
            place, pixel = block * stride + lane, first + y * width + x
            rest = (alphas[pixel] - np.float32(1)) * v_alphas[pixel]
            for c in range(len(channels)):
                gradient = v_image[pixel * len(channels) + c]
                if c < geometry_channels:
                    rest += gradient * image[pixel * len(channels) + c]
                state[place + (c + 2) * PIXELS] = gradient
            state[place], state[place + PIXELS] = np.float32(1), rest


@no_type_check
@numba.njit(cache=True)
def block_corners():
    """Column of the left and row of the upper pixels of the blocks of a tile [2 * BLOCKS]."""
    corners = aligned(2 * BLOCKS)
    for block in range(BLOCKS):
        corners[block] = BLOCK * (block & 3)
        corners[block + BLOCKS] = BLOCK * (block >> 2)
    return corners


@no_type_check
@numba.njit(cache=True)
def block_gradients(geometry, rows, row, dx, dy, state, place, moments, sums):
    """Add one block's share to a Gaussian's gradients; see `blend_backward`."""
    transmittance = vec.load(state, place)
    y = eighth_exponents(rows, row, dx, dy)
    hit = vec.greater_equal(y, vec.spread(rows, row + 5))
    raw, alpha, weight, after, live = pass_light(rows, row, y, hit, transmittance)
    gradients = vecs.load_vecs(state, place + 2 * PIXELS, geometry)
    gain = weight * vecs.dot_row(gradients, rows, row + ROW_COLORS)
    rest = vec.load(state, place + PIXELS) - gain
    sums = vecs.add_products(sums, weight, vecs.load_vecs(state, place + 2 * PIXELS, sums))
    vec.store(state, place, after)
    vec.store(state, place + PIXELS, rest)
    follows = vec.both(vec.both(hit, live), vec.greater_equal(np.float32(const.MAX_ALPHA), raw))
    behind = alpha * rest * vec.reciprocal(np.float32(1) - alpha)
    v_s = vec.select(follows, gain - behind, np.float32(0))
    return weight, vecs.add_moments(moments, v_s, dx, dy), sums


@no_type_check
@numba.njit(cache=True, parallel=True)
def blend_backward(head, tail, geometry, rows, row_stride, lists, width, height, pixels, out):
    """Add each thread's gradients to its own rows `out` [threads, M * stride].

    `pixels` are the flat image and coverage of `blend` and their gradients. A row of `out`
    holds the moments sum(v_s) of 1, x, y, x x, x y, y y, where v_s is the gradient of the
    exponent at a pixel and x, y its offset from the Gaussian; then the gradients of the colours.
    `head` and `tail` are tuples that cut the channels in two, the first of `HEAD` at most: so
    many sums as fit the registers. Only the first `len(geometry)` channels count for v_s.
    """
    starts, ranks, masks = lists
    tiles_x = -(-width // TILE)
    channels = head + tail
    stride = PIXELS * (len(channels) + 2)
    out_stride = gradient_stride(len(channels))
    for thread in numba.prange(out.shape[0]):
        state, weights = aligned(BLOCKS * stride), aligned(BLOCKS * PIXELS)
        corners = block_corners()
        mine = out[thread]
        for tile in range(thread, starts.shape[0] - 1, out.shape[0]):
            x, y = tile % tiles_x, tile // tiles_x
            inside_x, inside_y = min(TILE, width - TILE * x), min(TILE, height - TILE * y)
            first = TILE * (y * width + x)
            open_gradients(channels, state, inside_x, inside_y, first, width, pixels, len(geometry))
            left, top = TILE * x + np.float32(0.5), TILE * y + np.float32(0.5)
            for entry in range(starts[tile], starts[tile + 1]):
                ahead = ranks[min(entry + AHEAD, ranks.shape[0] - 1)]
                prefetch_row(rows, ahead * row_stride, row_stride)
                prefetch_row(mine, ahead * out_stride, out_stride)
                if masks[entry] == 0:
                    continue
                row, place = ranks[entry] * row_stride, ranks[entry] * out_stride
                moments, sums = vecs.zeros(MOMENT_CHANNELS), vecs.zeros(head)
                first_dx = (vec.columns() + left) - vec.spread(rows, row)
                first_dy = (vec.rows() + top) - vec.spread(rows, row + 1)
                todo = np.int64(masks[entry])
                while todo != 0:
                    block = vec.lowest_bit(todo)
                    todo &= todo - 1
                    dx = first_dx + vec.spread(corners, block)
                    dy = first_dy + vec.spread(corners, block + BLOCKS)
                    weight, moments, sums = block_gradients(
                        geometry, rows, row, dx, dy, state, block * stride, moments, sums
                    )
                    if len(tail) > 0:
                        vec.store(weights, block * PIXELS, weight)
                vecs.add_lane_sums(mine, place, moments, sums)
                if len(tail) > 0:
                    sums = vecs.zeros(tail)
                    todo = np.int64(masks[entry])
                    while todo != 0:
                        block = vec.lowest_bit(todo)
                        todo &= todo - 1
                        weight = vec.load(weights, block * PIXELS)
                        at = block * stride + (2 + len(head)) * PIXELS
                        sums = vecs.add_products(sums, weight, vecs.load_vecs(state, at, tail))
                    vecs.add_lane_sums(mine, place + vec.LANES, vecs.zeros(()), sums)


@no_type_check
@numba.njit(cache=True, parallel=True)
def collect_gradients(order, rows, partial, v_means2d, v_conics, v_opacities, v_colors):
    """Sum the threads' rows [threads, M, stride] into the gradients of the Gaussians drawn."""
    for rank in numba.prange(order.shape[0]):
        i = order[rank]
        total = partial[0, rank]
        for thread in range(1, partial.shape[0]):
            total += partial[thread, rank]
        a, b, c = -16 * rows[rank, 2], -8 * rows[rank, 3], -16 * rows[rank, 4]
        v_means2d[i, 0] = a * total[1] + b * total[2]
        v_means2d[i, 1] = b * total[1] + c * total[2]
        v_conics[i, 0], v_conics[i, 1], v_conics[i, 2] = -0.5 * total[3], -total[4], -0.5 * total[5]
        v_opacities[i] = total[0] / rows[rank, 6]
        for channel in range(v_colors.shape[1]):
            v_colors[i, channel] = total[MOMENTS + channel]
