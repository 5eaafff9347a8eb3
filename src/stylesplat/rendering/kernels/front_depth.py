"""The mean depth of a part of a pixel's weight, from one share to another, front to back."""

import numba
import numpy as np

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.blend import (
    BLOCKS,
    PIXELS,
    aligned,
    block_corner,
    block_pixels,
    composite_pixels,
    list_blocks,
    open_block,
    tile_corner,
)
from stylesplat.rendering.kernels.jit import inner, kernel
from stylesplat.rendering.kernels.tiles import BLOCK
from stylesplat.rendering.kernels.vec import RowPlace, spread_row

TINY = np.float32(1e-20)


@inner
def block_depths(rows, planes, ranks, entries, pixels, light, weights, shares):
    """Replace the weights of one block's pixels by depths; see `front_depths`."""
    pixel_x, pixel_y = pixels
    transmittance, total = vec.load_vec(light, 0), vec.load_vec(weights, 0)
    first, last = total * shares[0], total * shares[1]
    reached, found = vec.zero(), vec.zero()
    for entry in entries:
        row = RowPlace(rows.flat, ranks[entry] * rows.stride)
        plane = RowPlace(planes, ranks[entry] * 4)
        dx, dy = pixel_x - spread_row(row, 0), pixel_y - spread_row(row, 1)
        step = composite_pixels(row, dx, dy, transmittance)
        transmittance = step.after
        before = reached
        reached = vec.fma(step.weight, spread_row(plane, 3), reached)
        inside = vec.minimum(reached, last) - vec.maximum(before, first)
        slope = vec.fma(dy, spread_row(plane, 2), dx * spread_row(plane, 1))
        found = vec.fma(vec.maximum(inside, vec.zero()), slope + spread_row(plane, 0), found)
        if vec.bits(vec.greater(last, reached)) == 0:
            break
    length = vec.minimum(reached, last) - first
    shows = vec.greater(length, np.float32(0))
    vec.store_vec(weights, 0, vec.select(shows, found / vec.maximum(length, TINY), vec.zero()))


@kernel
def front_depths(rows, planes, lists, depths, size, shares, threads):
    """Replace pixels' weights, in `depths` [H*W], by the mean depths between two shares of them.

    `planes` [R*4] has, of each rank, the depth at its centre, the slopes in x and y, and how much
    its weight counts. The lists are those that `blend_forward` has cut.
    """
    starts, ranks, _ = lists
    width, height = size
    room = 0
    for tile in range(starts.shape[0] - 1):
        room = max(room, starts[tile + 1] - starts[tile])
    for thread in numba.prange(threads):
        light, wanted = aligned(PIXELS), aligned(PIXELS)
        entries, counts = np.empty((BLOCKS, room), np.int32), np.empty(BLOCKS, np.int64)
        for tile in range(thread, starts.shape[0] - 1, threads):
            list_blocks(lists, tile, rows, entries, counts)
            corner = tile_corner(tile, width)
            for block in range(BLOCKS):
                x, y = block_corner(corner, block)
                if x >= width or y >= height:
                    continue
                open_block(light, width - x, height - y)
                wanted[:] = 0
                for row in range(min(height - y, BLOCK)):
                    for column in range(min(width - x, BLOCK)):
                        wanted[row * BLOCK + column] = depths[(y + row) * width + x + column]
                mine = entries[block, : counts[block]]
                block_depths(rows, planes, ranks, mine, block_pixels(x, y), light, wanted, shares)
                for row in range(min(height - y, BLOCK)):
                    for column in range(min(width - x, BLOCK)):
                        depths[(y + row) * width + x + column] = wanted[row * BLOCK + column]
