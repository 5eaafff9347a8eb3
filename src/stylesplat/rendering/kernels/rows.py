"""Rows of numbers in one flat array, and places in such arrays."""

from typing import NamedTuple, no_type_check

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from stylesplat.rendering.kernels.vec import emit_address, emit_broadcast, vec


class Rows(NamedTuple):
    """Rows of one length."""

    flat: np.ndarray
    stride: int
    """Length of a row: a multiple of 16 floats, one cache line."""


class Place(NamedTuple):
    """Where a row, or the pixels of a block, begin."""

    flat: np.ndarray
    first: int


@intrinsic
@no_type_check
def spread(typingctx, place, column):
    """All lanes set to one number of the row at a place; see `vec.spread`."""

    def codegen(context, builder, signature, args):
        flat, first = cgutils.unpack_tuple(builder, args[0], 2)
        index = builder.add(first, args[1])
        address = emit_address(context, builder, place.types[0], flat, index)
        return emit_broadcast(builder, builder.load(address))

    return vec(place, types.intp), codegen
