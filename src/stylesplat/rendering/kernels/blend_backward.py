"""Gradients of everything that goes into blending, front to back once more."""

from typing import NamedTuple

import numba
import numpy as np

from stylesplat.rendering.gaussians import MAX_ALPHA
from stylesplat.rendering.kernels import vec, vecs
from stylesplat.rendering.kernels.blend import (
    BLOCKS,
    PIXELS,
    Patch,
    aligned,
    composite_pixels,
    prefetch_row,
    tile_corner,
)
from stylesplat.rendering.kernels.jit import inlined, inner, kernel, serial_kernel
from stylesplat.rendering.kernels.tiles import BLOCK, ROW_COLORS, TILE
from stylesplat.rendering.kernels.vec import RowPlace, Rows, spread_row

AHEAD = 6  # entries by which rows are prefetched
MOMENTS = 6  # gradient numbers of the ellipse, in front of the colours'
MOMENT_CHANNELS = vecs.channels(MOMENTS)
NONE = vecs.channels(0)
HEAD = vec.LANES - MOMENTS  # channels whose sums share the first vector of a row with the moments


class Channels(NamedTuple):
    """The channels of an image, as `vecs.channels`."""

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


def split_channels(count: int, geometry: int) -> Channels:
    """So many channels, of which the first reach the geometry."""
    head = min(count, HEAD)
    return Channels(*(vecs.channels(n) for n in (head, count - head, geometry)))


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
    step = composite_pixels(row, pixels[0], pixels[1], vec.load(state, first))
    weight = step.weight
    gradients = vecs.load_vecs(state, first + 2 * PIXELS, geometry)
    gain = weight * vecs.dot_row(gradients, row.flat, row.first + ROW_COLORS)
    rest = vec.load(state, first + PIXELS) - gain
    v_colors = vecs.load_vecs(state, first + 2 * PIXELS, totals.channels)
    sums = vecs.add_products(totals.channels, weight, v_colors)
    vec.store(state, first, step.after)
    vec.store(state, first + PIXELS, rest)
    follows = vec.both(vec.both(step.counts, step.live), vec.greater_equal(MAX_ALPHA, step.raw))
    behind = step.alpha * rest * vec.reciprocal(1 - step.alpha)
    v_s = vec.select(follows, gain - behind, 0)
    return weight, Totals(vecs.add_moments(totals.moments, v_s, pixels[0], pixels[1]), sums)


@inlined
def entry_gradients(channels, row, blocks, origin, buffers, out):
    """Add a tile's share to a Gaussian's gradients, from the place `out` on; see `blend_backward`.

    Two passes over the blocks, with as many sums as fit the registers in each.
    """
    head, tail, geometry = channels
    state, weights, corners = buffers
    stride = block_stride(channels)
    totals = Totals(vecs.zeros(MOMENT_CHANNELS), vecs.zeros(head))
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
            vec.store(weights, block * PIXELS, weight)
    vecs.add_lane_sums(out.flat, out.first, totals.moments, totals.channels)
    if len(tail) > 0:
        rest = vecs.zeros(tail)
        while blocks != 0:
            block = vec.lowest_bit(blocks)
            blocks &= blocks - 1
            weight = vec.load(weights, block * PIXELS)
            at = block * stride + (2 + len(head)) * PIXELS
            rest = vecs.add_products(rest, weight, vecs.load_vecs(state, at, tail))
        vecs.add_lane_sums(out.flat, out.first + vec.LANES, vecs.zeros(NONE), rest)


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
        parts = Channels(head, tail, geometry)  # prange takes flat tuples only
        buffers = tile_buffers(parts)
        mine = Rows(out[thread], out_stride)
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
