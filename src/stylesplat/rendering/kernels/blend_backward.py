"""Gradients of everything that goes into blending, front to back once more."""

from typing import no_type_check

import numba
import numpy as np

from stylesplat.rendering import constants as const
from stylesplat.rendering.kernels import vec, vecs
from stylesplat.rendering.kernels.blend import (
    BLOCKS,
    PIXELS,
    aligned,
    eighth_exponents,
    pass_light,
    prefetch_row,
)
from stylesplat.rendering.kernels.jit import inlined, inner, kernel, serial_kernel
from stylesplat.rendering.kernels.tiles import BLOCK, ROW_COLORS, TILE

AHEAD = 6  # entries by which rows are prefetched
MOMENTS = 6  # gradient numbers of the ellipse, in front of the colours'
MOMENT_CHANNELS = (0,) * MOMENTS
HEAD = vec.LANES - MOMENTS  # channels whose sums share the first vector of a row with the moments


@no_type_check
@serial_kernel
def gradient_stride(channels):
    """Length of a row of gradients: a multiple of 16 floats."""
    return -(-(MOMENTS + channels) // vec.LANES) * vec.LANES


@no_type_check
@inner
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
@inner
def block_corners():
    """Column of the left and row of the upper pixels of the blocks of a tile [2 * BLOCKS]."""
    corners = aligned(2 * BLOCKS)
    for block in range(BLOCKS):
        corners[block] = BLOCK * (block & 3)
        corners[block + BLOCKS] = BLOCK * (block >> 2)
    return corners


@no_type_check
@inlined
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
    follows = vec.both(vec.both(hit, live), vec.greater_equal(const.MAX_ALPHA, raw))
    behind = alpha * rest * vec.reciprocal(1 - alpha)
    v_s = vec.select(follows, gain - behind, 0)
    return weight, vecs.add_moments(moments, v_s, dx, dy), sums


@no_type_check
@inlined
def entry_gradients(
    head, tail, geometry, rows, row, blocks, origin, corners, state, weights, out, place
):
    """Add a tile's share to a Gaussian's gradients; see `blend_backward`.

    Two passes over the blocks, with as many sums as fit the registers in each.
    """
    stride = PIXELS * (len(head) + len(tail) + 2)
    moments, sums = vecs.zeros(MOMENT_CHANNELS), vecs.zeros(head)
    first_dx = (vec.columns() + origin[0]) - vec.spread(rows, row)
    first_dy = (vec.rows() + origin[1]) - vec.spread(rows, row + 1)
    todo = blocks
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
    vecs.add_lane_sums(out, place, moments, sums)
    if len(tail) > 0:
        rest = vecs.zeros(tail)
        while blocks != 0:
            block = vec.lowest_bit(blocks)
            blocks &= blocks - 1
            weight = vec.load(weights, block * PIXELS)
            at = block * stride + (2 + len(head)) * PIXELS
            rest = vecs.add_products(rest, weight, vecs.load_vecs(state, at, tail))
        vecs.add_lane_sums(out, place + vec.LANES, vecs.zeros(()), rest)


@no_type_check
@kernel
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
            origin = TILE * x + np.float32(0.5), TILE * y + np.float32(0.5)
            for entry in range(starts[tile], starts[tile + 1]):
                ahead = ranks[min(entry + AHEAD, ranks.shape[0] - 1)]
                prefetch_row(rows, ahead * row_stride, row_stride)
                prefetch_row(mine, ahead * out_stride, out_stride)
                if masks[entry] == 0:
                    continue
                row, place = ranks[entry] * row_stride, ranks[entry] * out_stride
                entry_gradients(
                    *(head, tail, geometry, rows, row, np.int64(masks[entry]), origin),
                    *(corners, state, weights, mine, place),
                )


@no_type_check
@kernel
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
