"""From projected Gaussians to one front-to-back list per image tile.

A tile is 16 x 16 pixels, cut into 16 blocks of 4 x 4. Every entry of a tile's list carries a
16-bit mask of the blocks that the Gaussian's ellipse truly touches, so that the blending kernels
never look at the others.

Where Gaussians are so large that lists would take much memory, they are listed and blended a group
at a time, the nearest first; entries that blending has struck are dropped in between. What is left
is bounded, whatever the number of Gaussians: the light of a pixel lasts for some hundred.
"""

from collections.abc import Sequence
from math import ceil, floor, log
from typing import NamedTuple

import numba
import numpy as np
from torch import Tensor

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner, kernel, serial_kernel
from stylesplat.rendering.kernels.vec import FlatRows, RowPlace, spread_row
from stylesplat.rendering.reference import MIN_ALPHA

TILE = 16
BLOCK = 4
HALF = np.float32(0.5)
ROW_COLORS = 8  # where the colours start in a packed row
RADIX_BITS = 11
ENTRIES_AT_ONCE = 1 << 22  # of 16 bytes while they are sorted; half a million Gaussians have fewer
ENDLESS = np.float32(1e-30)  # factor of an exponent that is constant: one is not divided by 0
SLACK = np.float32(1e-4)  # widens the block test: rounding must not lose a pixel


class Ellipses(NamedTuple):
    """What is blended: projected Gaussians with their colours; or the gradients of all that."""

    means2d: Tensor
    conics: Tensor
    opacities: Tensor
    colors: Tensor


class Entries(NamedTuple):
    """Tiles, and the ranks of Gaussians that reach them, with the blocks that they touch."""

    tiles: np.ndarray
    ranks: np.ndarray
    masks: np.ndarray


class TileLists(NamedTuple):
    """The entries of every tile, front to back."""

    starts: np.ndarray
    """Cuts the others into tiles: [tiles + 1]."""
    ranks: np.ndarray
    masks: np.ndarray


def row_stride(channels: int) -> int:
    """Length of a packed row: a multiple of 16 floats, one cache line."""
    return -(-(ROW_COLORS + channels) // vec.LANES) * vec.LANES


def depth_order(depths: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Indices of the Gaussians with a radius, nearest first: [visible], int32."""
    order = np.empty(len(depths), np.int32)
    return order[: sort_by_depth(depths, radii, order)]


@serial_kernel
def sort_by_depth(depths, radii, order):
    """Put what `depth_order` returns into the head of `order`, by radix sort; return the number."""
    found, count = np.empty(order.shape[0], np.int32), 0
    for i in range(depths.shape[0]):
        if radii[i, 0] > 0:
            found[count] = i
            count += 1
    now, then = found[:count], order[:count]
    keys = depths.view(np.uint32)  # positive floats sort like their bits
    bucket_mask = np.uint32((1 << RADIX_BITS) - 1)
    starts = np.empty((1 << RADIX_BITS) + 1, np.int64)
    for shift in (np.uint32(0), np.uint32(RADIX_BITS), np.uint32(2 * RADIX_BITS)):
        starts[:] = 0
        for i in now:
            starts[np.int64((keys[i] >> shift) & bucket_mask) + 1] += 1
        for bucket in range(1, starts.shape[0]):
            starts[bucket] += starts[bucket - 1]
        for i in now:
            bucket = np.int64((keys[i] >> shift) & bucket_mask)
            then[starts[bucket]] = i
            starts[bucket] += 1
        now, then = then, now  # three times, so that the last is `order`
    return count


@kernel
def pack_rows(order, ellipses, rows):
    """Gather what blending reads of a Gaussian into one row, in depth order.

    Columns: mean x y; factors of x x, x y and y y in an eighth of the exponent (see `vec.py`); the
    eighth below which it is invisible; opacity; unused; colours.
    """
    means2d, conics, opacities, colors = ellipses
    flat, stride = rows
    for rank in numba.prange(order.shape[0]):
        i, row = order[rank], rank * stride
        flat[row], flat[row + 1] = means2d[i, 0], means2d[i, 1]
        flat[row + 2], flat[row + 3] = -conics[i, 0] / 16, -conics[i, 1] / 8
        flat[row + 4] = -conics[i, 2] / 16
        flat[row + 5] = -log(opacities[i] / MIN_ALPHA) / 8
        flat[row + 6] = opacities[i]
        for c in range(colors.shape[1]):
            flat[row + ROW_COLORS + c] = colors[i, c]


@inner
def side_slopes(row):
    """Slopes of the lines on which a packed row's exponent is greatest, over x and over y.

    Among the points of one x it is greatest at y = `slope_y` x, among those of one y at x =
    `slope_x` y.
    """
    lean = np.float32(-0.5) * row.flat[row.first + 3]
    a, c = row.flat[row.first + 2], row.flat[row.first + 4]
    return lean / min(a, -ENDLESS), lean / min(c, -ENDLESS)


@inner
def block_mask(row, slopes, left, top):
    """Bit b is set if the ellipse of a packed row reaches a pixel centre's box in block b.

    `left` and `top` are the first pixel centre of the tile, relative to the Gaussian's. The
    exponent is greatest over a box at the Gaussian's centre if that is inside, else on one of the
    two sides that face it: lane b tries both. See `side_slopes`.
    """
    a, b, c = spread_row(row, 2), spread_row(row, 3), spread_row(row, 4)
    slope_x, slope_y = slopes
    low_x, low_y = vec.fma(vec.columns(), BLOCK, left), vec.fma(vec.rows(), BLOCK, top)
    high_x, high_y = low_x + (BLOCK - 1), low_y + (BLOCK - 1)
    near_x = vec.minimum(vec.maximum(low_x, 0), high_x)
    near_y = vec.minimum(vec.maximum(low_y, 0), high_y)
    best_y = vec.minimum(vec.maximum(near_x * slope_y, low_y), high_y)
    best_x = vec.minimum(vec.maximum(near_y * slope_x, low_x), high_x)
    side_x = vec.fma(near_x, vec.fma(near_x, a, best_y * b), best_y * best_y * c)
    side_y = vec.fma(best_x, vec.fma(best_x, a, near_y * b), near_y * near_y * c)
    threshold = spread_row(row, 5) - SLACK
    return vec.bits(vec.greater_equal(vec.maximum(side_x, side_y), threshold))


@inner
def tile_span(center, radius, tiles):
    """First tile and the one after the last that an interval of pixels touches."""
    first = max(floor((center - radius) / TILE), 0)
    return first, min(ceil((center + radius) / TILE), tiles)


@kernel
def list_entries(order, rows, radii, grid, starts, entries, counts, written):
    """List the entries chunk by chunk; count those of each chunk and tile, [chunks, tiles].

    `written` becomes how many entries each chunk wrote from `starts[chunk]` on.
    """
    tiles, ranks, masks = entries
    flat, stride = rows
    columns, lines = grid
    chunks, n = written.shape[0], order.shape[0]
    for chunk in numba.prange(chunks):
        entry = starts[chunk]
        for rank in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            row, i = RowPlace(flat, rank * stride), order[rank]
            x, y = flat[row.first], flat[row.first + 1]
            slopes = side_slopes(row)
            first_x, last_x = tile_span(x, radii[i, 0], columns)
            first_y, last_y = tile_span(y, radii[i, 1], lines)
            for tile_y in range(first_y, last_y):
                top = np.float32(TILE * tile_y) + HALF - y
                for tile_x in range(first_x, last_x):
                    left = np.float32(TILE * tile_x) + HALF - x
                    mask = block_mask(row, slopes, left, top)
                    if mask != 0:
                        tile = tile_y * columns + tile_x
                        tiles[entry], ranks[entry], masks[entry] = tile, rank, mask
                        counts[chunk, tile] += 1
                        entry += 1
        written[chunk] = entry - starts[chunk]


@serial_kernel
def count_tiles(order, rows, radii, size, totals):
    """Fill how many tiles the bounding boxes of all ranks before each cover: [M + 1]."""
    columns, lines = -(-size[0] // TILE), -(-size[1] // TILE)
    totals[0] = 0
    for rank in range(order.shape[0]):
        row, i = rank * rows.stride, order[rank]
        first_x, last_x = tile_span(rows.flat[row], radii[i, 0], columns)
        first_y, last_y = tile_span(rows.flat[row + 1], radii[i, 1], lines)
        covered = max(last_x - first_x, 0) * max(last_y - first_y, 0)
        totals[rank + 1] = totals[rank] + covered


@kernel
def scatter_entries(entries, starts, written, places, lists):
    """Move the chunks' entries to their tiles; chunks are in depth order, so lists are too.

    `places` [chunks, tiles] says where the next entry of a chunk and tile belongs.
    """
    tiles, ranks, masks = entries
    _, tile_ranks, tile_masks = lists
    for chunk in numba.prange(written.shape[0]):
        for entry in range(starts[chunk], starts[chunk] + written[chunk]):
            place = places[chunk, tiles[entry]]
            tile_ranks[place], tile_masks[place] = ranks[entry], masks[entry]
            places[chunk, tiles[entry]] = place + 1


@serial_kernel
def list_tiles(order, rows, radii, size, starts, lists):
    """Fill the lists of all tiles; each chunk has the room between `starts`. Return the number."""
    room, chunks = starts[-1], starts.shape[0] - 1
    grid = -(-size[0] // TILE), -(-size[1] // TILE)
    tiles, ranks = np.empty(room, np.int32), np.empty(room, np.int32)
    entries = Entries(tiles, ranks, np.empty(room, np.uint16))
    counts = np.zeros((chunks, grid[0] * grid[1]), np.int64)
    written = np.zeros(chunks, np.int64)
    list_entries(order, rows, radii, grid, starts, entries, counts, written)
    places, place = np.empty_like(counts), 0
    for tile in range(counts.shape[1]):
        lists.starts[tile] = place
        for chunk in range(chunks):
            places[chunk, tile] = place
            place += counts[chunk, tile]
    lists.starts[-1] = place
    scatter_entries(entries, starts, written, places, lists)
    return place


def tile_count(size: tuple[int, int]) -> int:
    width, height = size
    return -(-width // TILE) * -(-height // TILE)


def rank_groups(
    order: np.ndarray, rows: FlatRows, radii: np.ndarray, size: tuple[int, int]
) -> list[np.ndarray]:
    """Cut the ranks into groups, mostly one, whose lists take bounded memory.

    Returns:
        For each group the `count_tiles` of its ranks, from the first on, and of the one behind.
    """
    totals = np.empty(len(order) + 1, np.int64)
    count_tiles(order, rows, radii, size, totals)
    if totals[-1] <= ENTRIES_AT_ONCE:
        return [totals]
    groups, first = [], 0
    while first < len(order):
        end = np.searchsorted(totals, totals[first] + ENTRIES_AT_ONCE, side="right") - 1
        end = max(int(end), first + 1)
        groups.append(totals[first : end + 1])
        first = end
    return groups


def tile_lists(
    order: np.ndarray,
    rows: FlatRows,
    radii: np.ndarray,
    size: tuple[int, int],
    totals: np.ndarray,
    chunks: int,
) -> TileLists:
    """The list of every tile of an image of a width and height, made by `chunks` threads.

    `totals` are the `count_tiles` of these ranks.
    """
    starts = totals[np.arange(chunks + 1) * len(order) // chunks] - totals[0]
    room = starts[-1]
    tile_starts = np.empty(tile_count(size) + 1, np.int64)
    lists = TileLists(tile_starts, np.empty(room, np.int32), np.empty(room, np.uint16))
    count = list_tiles(order, rows, radii, size, starts, lists)
    return TileLists(tile_starts, lists.ranks[:count], lists.masks[:count])


@serial_kernel
def drop_struck(lists, first):
    """Move entries that touch blocks to the front and add `first` to ranks; return their number."""
    starts, ranks, masks = lists
    place, entry = 0, 0
    for tile in range(starts.shape[0] - 1):
        starts[tile] = place
        while entry < starts[tile + 1]:
            if masks[entry] != 0:
                ranks[place], masks[place] = first + ranks[entry], masks[entry]
                place += 1
            entry += 1
    starts[-1] = place
    return place


def kept_entries(lists: TileLists, first: int) -> TileLists:
    """The entries of a group that blending has not struck, by ranks of all groups."""
    count = drop_struck(lists, first)
    return TileLists(lists.starts, lists.ranks[:count].copy(), lists.masks[:count].copy())


@serial_kernel
def add_group(group, places, lists):
    """Copy a group's entries to the tiles' `places` [tiles], which move on."""
    starts, ranks, masks = group
    for tile in range(starts.shape[0] - 1):
        for entry in range(starts[tile], starts[tile + 1]):
            place = places[tile]
            lists.ranks[place], lists.masks[place] = ranks[entry], masks[entry]
            places[tile] = place + 1


def joined_lists(groups: Sequence[TileLists]) -> TileLists:
    """The lists of groups, the nearest first, as one."""
    starts = np.sum([group.starts for group in groups], axis=0)
    lists = TileLists(starts, np.empty(starts[-1], np.int32), np.empty(starts[-1], np.uint16))
    places = starts[:-1].copy()
    for group in groups:
        add_group(group, places, lists)
    return lists
