"""What each Gaussian contributes to each pixel: summed over an image, or stored.

With geometry and opacities frozen an image is linear in the colours. The weights of the picked
Gaussians are stored for the 16 pixels of each block that they touch, as float16, tile by tile and
front to back.
"""

from typing import NamedTuple

import numba
import numpy as np

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.blend import (
    BLOCKS,
    NONE,
    PIXELS,
    aligned,
    block_corner,
    block_pixels,
    composite_pixels,
    open_block,
    tile_corner,
)
from stylesplat.rendering.kernels.jit import inner, kernel, serial_kernel
from stylesplat.rendering.kernels.vec import RowPlace, spread_row

COLORS = vec.channels(3)


class BlockWeights(NamedTuple):
    """The weights of some Gaussians in one image."""

    starts: np.ndarray
    """Cuts `gaussians` and `masks` into tiles: [tiles + 1]."""
    firsts: np.ndarray
    """Where each tile's weights begin, in blocks: [tiles]."""
    gaussians: np.ndarray
    """The number, among the picked, of every entry's Gaussian."""
    masks: np.ndarray
    """The blocks that it touches."""
    weights: np.ndarray
    """Float16 as uint16, 16 a block."""


@serial_kernel
def count_pairs(lists, picked, entries, pairs):
    """Count entries and (entry, block) pairs of picked ranks up, tile by tile [tiles + 1].

    What is filled holds zeros.
    """
    starts, ranks, masks = lists
    for tile in range(starts.shape[0] - 1):
        entries[tile + 1], pairs[tile + 1] = entries[tile], pairs[tile]
        for entry in range(starts[tile], starts[tile + 1]):
            todo = np.int64(masks[entry])
            if picked[ranks[entry]] >= 0 and todo != 0:
                entries[tile + 1] += 1
                while todo != 0:
                    todo &= todo - 1
                    pairs[tile + 1] += 1


@kernel
def store_weights(rows, lists, picked, size, blocks, threads):
    """Fill `blocks` from lists that `blend_forward` has cut.

    `picked` gives the number of a rank among the picked Gaussians, or -1.
    """
    starts, ranks, masks = lists
    block_starts, firsts, gaussians, block_masks, weights = blocks
    width, height = size
    for thread in numba.prange(threads):
        light = aligned(BLOCKS * PIXELS)
        for tile in range(thread, starts.shape[0] - 1, threads):
            corner = tile_corner(tile, width)
            for block in range(BLOCKS):
                x, y = block_corner(corner, block)
                open_block(light[block * PIXELS : (block + 1) * PIXELS], width - x, height - y)
            place, pair = block_starts[tile], firsts[tile]
            for entry in range(starts[tile], starts[tile + 1]):
                rank, todo = ranks[entry], np.int64(masks[entry])
                mine = picked[rank] >= 0 and todo != 0
                if mine:
                    gaussians[place], block_masks[place] = picked[rank], masks[entry]
                    place += 1
                row = RowPlace(rows.flat, rank * rows.stride)
                while todo != 0:
                    block = vec.lowest_bit(todo)
                    todo &= todo - 1
                    x, y = block_corner(corner, block)
                    pixel_x, pixel_y = block_pixels(x, y)
                    dx, dy = pixel_x - spread_row(row, 0), pixel_y - spread_row(row, 1)
                    step = composite_pixels(row, dx, dy, vec.load_vec(light, block * PIXELS))
                    vec.store_vec(light, block * PIXELS, step.after)
                    if mine:
                        vec.store_halves(weights, pair * PIXELS, step.weight)
                        pair += 1


@inner
def read_tile(state, image, depth, corner, size):
    """The channels of a tile's pixels, block by block, from a flat image; 0 outside it."""
    width, height = size
    for block in range(BLOCKS):
        left, top = block_corner(corner, block)
        for lane in range(PIXELS):
            x, y = left + (lane & 3), top + (lane >> 2)
            inside = x < width and y < height
            for c in range(depth):
                value = image[(y * width + x) * depth + c] if inside else np.float32(0)
                state[(block * depth + c) * PIXELS + lane] = value


@inner
def write_tile(state, image, corner, size):
    width, height = size
    for block in range(BLOCKS):
        left, top = block_corner(corner, block)
        for lane in range(PIXELS):
            x, y = left + (lane & 3), top + (lane >> 2)
            if x < width and y < height:
                for c in range(3):
                    image[(y * width + x) * 3 + c] = state[(block * 3 + c) * PIXELS + lane]


@kernel
def render_linear(blocks, colors, background, image, size, threads):
    """Fill a flat image with the background and what Gaussians of flat `colors` [M*4] add."""
    starts, firsts, gaussians, masks, weights = blocks
    for thread in numba.prange(threads):
        state = aligned(3 * BLOCKS * PIXELS)
        for tile in range(thread, firsts.shape[0], threads):
            corner = tile_corner(tile, size[0])
            read_tile(state, background, 3, corner, size)
            pair = firsts[tile]
            for entry in range(starts[tile], starts[tile + 1]):
                row, todo = np.int64(gaussians[entry]) * 4, np.int64(masks[entry])
                while todo != 0:
                    place = vec.lowest_bit(todo) * (3 * PIXELS)
                    todo &= todo - 1
                    weight = vec.load_halves(weights, pair * PIXELS)
                    sums = vec.load_vecs(state, place, COLORS)
                    sums = vec.add_scaled_row(sums, weight, colors, row)
                    vec.store_vecs(state, place, sums)
                    pair += 1
            write_tile(state, image, corner, size)


@kernel
def compose_backward(blocks, v_image, size, out):
    """Add each thread's gradients of the colours to its own flat rows `out` [threads, M*16]."""
    starts, firsts, gaussians, masks, weights = blocks
    for thread in numba.prange(out.shape[0]):
        state = aligned(3 * BLOCKS * PIXELS)
        mine = out[thread]
        for tile in range(thread, firsts.shape[0], out.shape[0]):
            if starts[tile] == starts[tile + 1]:
                continue
            read_tile(state, v_image, 3, tile_corner(tile, size[0]), size)
            pair = firsts[tile]
            for entry in range(starts[tile], starts[tile + 1]):
                todo = np.int64(masks[entry])
                sums = vec.zeros(COLORS)
                while todo != 0:
                    place = vec.lowest_bit(todo) * (3 * PIXELS)
                    todo &= todo - 1
                    weight = vec.load_halves(weights, pair * PIXELS)
                    sums = vec.add_products(sums, weight, vec.load_vecs(state, place, COLORS))
                    pair += 1
                row = np.int64(gaussians[entry]) * vec.LANES
                vec.add_lane_sums(mine, row, vec.zeros(NONE), sums)


@kernel
def open_light(light, size):
    """Fill `light` [tiles * BLOCKS * PIXELS] with 1 inside an image and 0 outside."""
    width, height = size
    for tile in numba.prange(light.shape[0] // (BLOCKS * PIXELS)):
        corner = tile_corner(tile, width)
        for block in range(BLOCKS):
            x, y = block_corner(corner, block)
            first = (tile * BLOCKS + block) * PIXELS
            open_block(light[first : first + PIXELS], width - x, height - y)


@kernel
def sum_weights(channels, rows, lists, light, image, size, out):
    """Add a flat image times the weights of ranks to each thread's flat rows `out` [threads, M*16].

    `light` [tiles * BLOCKS * PIXELS] is what nearer Gaussians leave of each pixel; it becomes what
    these leave.
    """
    starts, ranks, masks = lists
    depth = len(channels)
    for thread in numba.prange(out.shape[0]):
        state = aligned(depth * BLOCKS * PIXELS)
        mine = out[thread]
        for tile in range(thread, starts.shape[0] - 1, out.shape[0]):
            if starts[tile] == starts[tile + 1]:
                continue
            corner, first = tile_corner(tile, size[0]), tile * BLOCKS * PIXELS
            read_tile(state, image, depth, corner, size)
            unfinished = np.int64(2**BLOCKS - 1)
            for entry in range(starts[tile], starts[tile + 1]):
                rank, todo = ranks[entry], np.int64(masks[entry]) & unfinished
                if todo == 0:
                    continue
                row, sums = RowPlace(rows.flat, rank * rows.stride), vec.zeros(channels)
                while todo != 0:
                    block = vec.lowest_bit(todo)
                    todo &= todo - 1
                    pixel_x, pixel_y = block_pixels(*block_corner(corner, block))
                    dx, dy = pixel_x - spread_row(row, 0), pixel_y - spread_row(row, 1)
                    place = first + block * PIXELS
                    step = composite_pixels(row, dx, dy, vec.load_vec(light, place))
                    vec.store_vec(light, place, step.after)
                    values = vec.load_vecs(state, block * depth * PIXELS, channels)
                    sums = vec.add_products(sums, step.weight, values)
                    if vec.bits(step.live) == 0:
                        unfinished &= ~(np.int64(1) << block)
                vec.add_lane_sums(mine, np.int64(rank) * vec.LANES, vec.zeros(NONE), sums)
