"""Rows of numbers: in one flat array, and as columns of sixteen in vectors."""

from typing import NamedTuple, no_type_check

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner
from stylesplat.rendering.kernels.vec import emit_address, emit_broadcast
from stylesplat.rendering.kernels.vec import vec as vec_signature


class Rows(NamedTuple):
    """Rows of one length."""

    flat: np.ndarray
    stride: int
    """Length of a row: a multiple of 16 floats, one cache line."""


class RowPlace(NamedTuple):
    """Where a row, or the pixels of a block, begin."""

    flat: np.ndarray
    first: int


@intrinsic
@no_type_check
def spread_row(typingctx, place, column):
    """All lanes set to one number of the row at a place; see `vec.spread`."""

    def codegen(context, builder, signature, args):
        flat, first = cgutils.unpack_tuple(builder, args[0], 2)
        index = builder.add(first, args[1])
        address = emit_address(context, builder, place.types[0], flat, index)
        return emit_broadcast(builder, builder.load(address))

    return vec_signature(place, types.intp), codegen


class Lanes(NamedTuple):
    """Which rows of the arrays the lanes of a vector are."""

    first: int
    rows: int
    """How many, up to 16."""
    mask: object
    """The lanes that are not 0."""
    buffer: np.ndarray
    """Room for a vector."""


@no_type_check
@inner
def span(rows, thread, threads):
    """First row of a thread's share and the one after its last; shares are whole vectors."""
    vectors = -(-rows // vec.LANES)
    low, high = vectors * thread // threads, vectors * (thread + 1) // threads
    return low * vec.LANES, min(high * vec.LANES, rows)


@no_type_check
@inner
def read_columns(array, first, count, columns, buffer):
    """Copy the first columns of up to 16 rows into `buffer`, one after the other."""
    for lane in range(count):
        for column in range(columns):
            buffer[column * vec.LANES + lane] = array[first + lane, column]


@no_type_check
@inner
def read_two(array, first, count, buffer):
    """Two columns of up to 16 rows from `first` on; `buffer` has room for four."""
    read_columns(array, first, count, 2, buffer)
    return vec.load(buffer, 0), vec.load(buffer, vec.LANES)


@no_type_check
@inner
def read_three(array, first, count, buffer):
    """Three columns; see `read_two`."""
    read_columns(array, first, count, 3, buffer)
    return (
        vec.load(buffer, 0),
        vec.load(buffer, vec.LANES),
        vec.load(buffer, 2 * vec.LANES),
    )


@no_type_check
@inner
def read_four(array, first, count, buffer):
    """Four columns; see `read_two`."""
    read_columns(array, first, count, 4, buffer)
    first_two = vec.load(buffer, 0), vec.load(buffer, vec.LANES)
    return (
        *first_two,
        vec.load(buffer, 2 * vec.LANES),
        vec.load(buffer, 3 * vec.LANES),
    )


@no_type_check
@inner
def write_column(array, column, lanes, value):
    """Write a column of up to 16 rows."""
    first, count, mask, buffer = lanes
    vec.store(buffer, 0, vec.select(mask, value, 0))
    for lane in range(count):
        array[first + lane, column] = buffer[lane]
