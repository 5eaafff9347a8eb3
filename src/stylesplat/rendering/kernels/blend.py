"""Compositing tiles front to back, and the gradients of everything that goes in.

Inside a tile the state of each 4 x 4 block is a few vectors of 16 pixels. A pixel's transmittance
turns negative when the pixel is finished (or lies outside the image): its magnitude still holds
the value, its sign stops the blending.
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
def lane_place(x, y, stride):
    """Where the state of a tile holds its pixel x, y: in a block, there in a lane."""
    return ((y >> 2) * 4 + (x >> 2)) * stride + (y & 3) * 4 + (x & 3)


@no_type_check
@numba.njit(cache=True)
def offsets(rows, row, block, tile_x, tile_y):
    """Distance in x and y from a Gaussian's centre to the pixel centres of a block."""
    left = np.float32(TILE * tile_x + BLOCK * (block & 3)) + np.float32(0.5)
    top = np.float32(TILE * tile_y + BLOCK * (block >> 2)) + np.float32(0.5)
    return vec.columns() + (left - rows[row]), vec.rows() + (top - rows[row + 1])


@no_type_check
@numba.njit(cache=True)
def exponents(rows, row, dx, dy):
    """Logarithm of a Gaussian's falloff at some pixels, at most 0."""
    x_part = dx * vec.fma(dx, rows[row + 2], dy * rows[row + 3])
    return vec.minimum(vec.fma(dy * rows[row + 4], dy, x_part), np.float32(0))


@no_type_check
@numba.njit(cache=True)
def visible(rows, row, s, transmittance):
    """Lanes that are unfinished and in which the Gaussian reaches the least alpha."""
    reached = vec.greater_equal(s, rows[row + 5])
    return vec.both(reached, vec.greater(transmittance, np.float32(0)))


@no_type_check
@numba.njit(cache=True)
def pass_light(rows, row, s, hit, transmittance):
    """Composite one Gaussian over some pixels.

    Returns:
        Unclamped alpha, alpha and weight (0 where it is not drawn), and the new transmittance.
    """
    raw = vec.exp(s) * rows[row + 6]
    alpha = vec.select(hit, vec.minimum(raw, np.float32(const.MAX_ALPHA)), np.float32(0))
    weight = alpha * transmittance
    after = transmittance - weight
    finished = vec.greater_equal(np.float32(const.MIN_TRANSMITTANCE), after)
    after = vec.select(finished, vec.negative(vec.absolute(transmittance)), after)
    return raw, alpha, vec.select(finished, np.float32(0), weight), after


@no_type_check
@numba.njit(cache=True)
def open_tile(state, stride, columns, rows):
    """Transmittance 1 in the columns and rows inside the image, -1 outside; the rest 0."""
    state[:] = 0
    for y in range(TILE):
        for x in range(TILE):
            state[lane_place(x, y, stride)] = 1 if x < columns and y < rows else -1


@no_type_check
@numba.njit(cache=True)
def close_tile(channels, state, stride, columns, rows, first, width, image, transmittances):
    """Write a tile's colours and transmittances to the flat image, from pixel `first` on."""
    for y in range(rows):
        for x in range(columns):
            place, pixel = lane_place(x, y, stride), first + y * width + x
            transmittances[pixel] = abs(state[place])
            for c in range(len(channels)):
                image[pixel * len(channels) + c] = state[place + (c + 1) * PIXELS]


@no_type_check
@numba.njit(cache=True)
def blend_entry(channels, rows, row, block, tile_x, tile_y, state, place):
    """Composite one Gaussian into one block; True if the block has unfinished pixels left."""
    dx, dy = offsets(rows, row, block, tile_x, tile_y)
    transmittance = vec.load(state, place)
    s = exponents(rows, row, dx, dy)
    hit = visible(rows, row, s, transmittance)
    if vec.bits(hit) == 0:
        return True
    _, _, weight, after = pass_light(rows, row, s, hit, transmittance)
    vec.store(state, place, after)
    sums = vecs.load_vecs(state, place + PIXELS, channels)
    sums = vecs.add_scaled_row(sums, weight, rows, row + ROW_COLORS)
    vecs.store_vecs(state, place + PIXELS, sums)
    return vec.bits(vec.greater(after, np.float32(0))) != 0


@no_type_check
@numba.njit(cache=True, parallel=True)
def blend(channels, rows, row_stride, lists, width, height, image, transmittances, threads):
    """Fill the flat image [H*W*D] and the transmittance that is left [H*W].

    Blocks that are finished are struck from the masks of the entries behind, so that the backward
    pass visits just what this one has drawn. `channels` is a tuple of length D.
    """
    starts, ranks, masks = lists
    tiles_x = -(-width // TILE)
    stride = PIXELS * (len(channels) + 1)
    for thread in numba.prange(threads):
        state = aligned(BLOCKS * stride)
        for tile in range(thread, starts.shape[0] - 1, threads):
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            inside_x, inside_y = min(TILE, width - TILE * tile_x), min(TILE, height - TILE * tile_y)
            open_tile(state, stride, inside_x, inside_y)
            live = (1 << BLOCKS) - 1
            for entry in range(starts[tile], starts[tile + 1]):
                ahead = min(entry + AHEAD, ranks.shape[0] - 1)
                prefetch_row(rows, ranks[ahead] * row_stride, row_stride)
                todo = np.int64(masks[entry]) & live
                masks[entry] = todo
                while todo != 0:
                    block = vec.lowest_bit(todo)
                    todo &= todo - 1
                    row = ranks[entry] * row_stride
                    place = block * stride
                    if not blend_entry(channels, rows, row, block, tile_x, tile_y, state, place):
                        live &= ~(1 << block)
            first = TILE * (tile_y * width + tile_x)
            close_tile(
                channels, state, stride, inside_x, inside_y, first, width, image, transmittances
            )


@no_type_check
@numba.njit(cache=True)
def open_gradients(channels, state, stride, columns, rows, first, width, pixels, geometry_channels):
    """Per block: transmittance, the gradient-weighted light still to come, pixel gradients."""
    image, transmittances, v_image, v_alphas = pixels
    open_tile(state, stride, columns, rows)
    for y in range(rows):
        for x in range(columns):
            place, pixel = lane_place(x, y, stride), first + y * width + x
            rest = -transmittances[pixel] * v_alphas[pixel]
            for c in range(len(channels)):
                gradient = v_image[pixel * len(channels) + c]
                if c < geometry_channels:
                    rest += gradient * image[pixel * len(channels) + c]
                state[place + (c + 2) * PIXELS] = gradient
            state[place + PIXELS] = rest


@no_type_check
@numba.njit(cache=True)
def entry_gradients(rows, row, dx, dy, state, place, moments, sums):
    """Add one block's share to a Gaussian's gradients; see `blend_backward`."""
    transmittance = vec.load(state, place)
    s = exponents(rows, row, dx, dy)
    hit = visible(rows, row, s, transmittance)
    if vec.bits(hit) == 0:
        return moments, sums
    raw, alpha, weight, after = pass_light(rows, row, s, hit, transmittance)
    gradients = vecs.load_vecs(state, place + 2 * PIXELS, sums)
    gain = weight * vecs.dot_row(gradients, rows, row + ROW_COLORS)
    rest = vec.load(state, place + PIXELS) - gain
    vec.store(state, place, after)
    vec.store(state, place + PIXELS, rest)
    drawn = vec.both(
        vec.greater(weight, np.float32(0)),
        vec.greater_equal(np.float32(const.MAX_ALPHA), raw),
    )
    v_s = vec.select(drawn, gain - alpha * rest / (np.float32(1) - alpha), np.float32(0))
    moments = vecs.add_products(moments, v_s, vecs.monomials(dx, dy))
    return moments, vecs.add_products(sums, weight, gradients)


@no_type_check
@numba.njit(cache=True, parallel=True)
def blend_backward(
    channels, rows, row_stride, lists, width, height, pixels, geometry_channels, out
):
    """Add each thread's gradients to its own rows `out` [threads, M * stride].

    `pixels` are the flat image and transmittances of `blend` and their gradients. A row of `out`
    holds the moments sum(v_s) of 1, x, y, x x, x y, y y, where v_s is the gradient of the
    exponent at a pixel and x, y its offset from the Gaussian; then the gradients of the colours.
    Channels from `geometry_channels` on do not count for v_s; their colours in `rows` must be 0.
    """
    starts, ranks, masks = lists
    tiles_x = -(-width // TILE)
    stride = PIXELS * (len(channels) + 2)
    out_stride = gradient_stride(len(channels))
    for thread in numba.prange(out.shape[0]):
        state = aligned(BLOCKS * stride)
        mine = out[thread]
        for tile in range(thread, starts.shape[0] - 1, out.shape[0]):
            x, y = tile % tiles_x, tile // tiles_x
            inside_x, inside_y = min(TILE, width - TILE * x), min(TILE, height - TILE * y)
            first = TILE * (y * width + x)
            open_gradients(
                channels, state, stride, inside_x, inside_y, first, width, pixels, geometry_channels
            )
            for entry in range(starts[tile], starts[tile + 1]):
                ahead = ranks[min(entry + AHEAD, ranks.shape[0] - 1)]
                prefetch_row(rows, ahead * row_stride, row_stride)
                prefetch_row(mine, ahead * out_stride, out_stride)
                todo = np.int64(masks[entry])
                if todo == 0:
                    continue
                row = ranks[entry] * row_stride
                moments, sums = vecs.zeros(MOMENT_CHANNELS), vecs.zeros(channels)
                while todo != 0:
                    block = vec.lowest_bit(todo)
                    todo &= todo - 1
                    dx, dy = offsets(rows, row, block, x, y)
                    moments, sums = entry_gradients(
                        rows, row, dx, dy, state, block * stride, moments, sums
                    )
                vecs.add_lane_sums(mine, ranks[entry] * out_stride, moments, sums)


@no_type_check
@numba.njit(cache=True, parallel=True)
def collect_gradients(order, rows, partial, v_means2d, v_conics, v_opacities, v_colors):
    """Sum the threads' rows [threads, M, stride] into the gradients of the Gaussians drawn."""
    for rank in numba.prange(order.shape[0]):
        i = order[rank]
        total = partial[0, rank]
        for thread in range(1, partial.shape[0]):
            total += partial[thread, rank]
        a, b, c = -2 * rows[rank, 2], -rows[rank, 3], -2 * rows[rank, 4]
        v_means2d[i, 0] = a * total[1] + b * total[2]
        v_means2d[i, 1] = b * total[1] + c * total[2]
        v_conics[i, 0], v_conics[i, 1], v_conics[i, 2] = -0.5 * total[3], -total[4], -0.5 * total[5]
        v_opacities[i] = total[0] / rows[rank, 6]
        for channel in range(v_colors.shape[1]):
            v_colors[i, channel] = total[MOMENTS + channel]
