"""Tuples of vectors, one per channel, held in registers: see `vec.py`.

`Vecs[n]` is n values of type `Vec`. n is the length of a tuple that the caller passes, hence part
of its type and known to the compiler, so each number of channels has its own unrolled code. The
tuple's elements mean nothing: `channels` makes one.
"""
# pyright: reportCallIssue=false
# (it cannot count the arguments of starred lists)

from llvmlite import ir
from numba import types
from numba.extending import models, register_model

from stylesplat.rendering.kernels.vec import (
    I32,
    LANES,
    VEC,
    emit_address,
    emit_broadcast,
    emit_fma,
    emit_load,
    emit_store,
    intrinsic,
    vec,
)


def channels(count: int) -> tuple[int, ...]:
    """So many channels, in the form in which kernels are compiled for their number."""
    return (0,) * count


class VecsType(types.Type):
    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(name=f"Vecs[{count}]")


@register_model(VecsType)
class _VecsModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.ArrayType(VEC, fe_type.count))


def _count(like):
    return like.count if isinstance(like, VecsType) else len(like)


def _unpack(builder, vecs, count):
    return [builder.extract_value(vecs, i) for i in range(count)]


def _pack(builder, values):
    packed = ir.Constant(ir.ArrayType(VEC, len(values)), ir.Undefined)
    for i, value in enumerate(values):
        packed = builder.insert_value(packed, value, i)
    return packed


@intrinsic
def zeros(typingctx, like):
    """`Vecs` of zeros, as many as `channels`."""

    def codegen(context, builder, signature, args):
        return _pack(builder, [ir.Constant(VEC, None)] * len(like))

    return VecsType(len(like))(like), codegen


@intrinsic
def load_vecs(typingctx, array, index, like):
    """`Vecs` from consecutive memory, as many as the `Vecs` or `channels` that it is to be like."""

    def codegen(context, builder, signature, args):
        first = emit_address(context, builder, signature.args[0], *args[:2])
        step = [builder.gep(first, [ir.Constant(I32, LANES * i)]) for i in range(_count(like))]
        return _pack(builder, [emit_load(builder, address) for address in step])

    return VecsType(_count(like))(array, types.intp, like), codegen


@intrinsic
def store_vecs(typingctx, array, index, vecs):
    def codegen(context, builder, signature, args):
        first = emit_address(context, builder, signature.args[0], *args[:2])
        for i, value in enumerate(_unpack(builder, args[2], vecs.count)):
            emit_store(builder, value, builder.gep(first, [ir.Constant(I32, LANES * i)]))
        return context.get_dummy_value()

    return types.none(array, types.intp, vecs), codegen


def _scalars(context, builder, array_type, array, index, count):
    first = emit_address(context, builder, array_type, array, index)
    return [builder.load(builder.gep(first, [ir.Constant(I32, i)])) for i in range(count)]


@intrinsic
def add_scaled_row(typingctx, vecs, weight, array, index):
    """`vecs[i] + weight * array[index + i]` for every i."""

    def codegen(context, builder, signature, args):
        row = _scalars(context, builder, signature.args[2], *args[2:], vecs.count)
        sums = _unpack(builder, args[0], vecs.count)
        pairs = zip(sums, row, strict=True)
        return _pack(
            builder, [emit_fma(builder, args[1], emit_broadcast(builder, r), s) for s, r in pairs]
        )

    return vecs(vecs, vec, array, types.intp), codegen


@intrinsic
def dot_row(typingctx, vecs, array, index):
    """The sum over i of `vecs[i] * array[index + i]`."""

    def codegen(context, builder, signature, args):
        row = _scalars(context, builder, signature.args[1], *args[1:], vecs.count)
        total = ir.Constant(VEC, None)
        for value, scalar in zip(_unpack(builder, args[0], vecs.count), row, strict=True):
            total = emit_fma(builder, value, emit_broadcast(builder, scalar), total)
        return total

    return vec(vecs, array, types.intp), codegen


@intrinsic
def add_products(typingctx, vecs, weight, others):
    """`vecs[i] + weight * others[i]` for every i."""

    def codegen(context, builder, signature, args):
        pairs = zip(*(_unpack(builder, args[i], vecs.count) for i in (0, 2)), strict=True)
        return _pack(builder, [emit_fma(builder, args[1], o, s) for s, o in pairs])

    return vecs(vecs, vec, others), codegen


@intrinsic
def add_moments(typingctx, moments, weight, x, y):
    """`Vecs` of six plus the weight times 1, x, y, x x, x y and y y."""

    def codegen(context, builder, signature, args):
        sums = _unpack(builder, args[0], 6)
        weight, x, y = args[1:]
        by_x, by_y = builder.fmul(weight, x), builder.fmul(weight, y)
        added = [builder.fadd(s, w) for s, w in zip(sums, (weight, by_x, by_y), strict=False)]
        squares = ((by_x, x), (by_x, y), (by_y, y))
        added += [emit_fma(builder, *pair, s) for pair, s in zip(squares, sums[3:], strict=True)]
        return _pack(builder, added)

    return moments(moments, vec, vec, vec), codegen


def _sum_16(builder, values):
    """One vector whose lane i is the sum over the lanes of `values[i]`, by 15 pairwise sums."""
    for step in (1, 2, 4, 8):
        low = [lane + (LANES - step if lane & step else 0) for lane in range(LANES)]
        high = [lane + (LANES if lane & step else step) for lane in range(LANES)]
        pairs = zip(values[::2], values[1::2], strict=True)
        values = [
            builder.fadd(_shuffle(builder, a, b, low), _shuffle(builder, a, b, high))
            for a, b in pairs
        ]
    return values[0]


def _shuffle(builder, a, b, lanes):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(I32, LANES), lanes))


@intrinsic
def add_lane_sums(typingctx, array, index, moments, vecs):
    """Add the sum over the lanes of each of `moments` and then `vecs` to consecutive numbers.

    The memory is read and written in whole vectors: rows are padded to a multiple of 16.
    """

    def codegen(context, builder, signature, args):
        first = emit_address(context, builder, signature.args[0], *args[:2])
        values = _unpack(builder, args[2], moments.count) + _unpack(builder, args[3], vecs.count)
        values += [ir.Constant(VEC, None)] * (-len(values) % LANES)
        for start in range(0, len(values), LANES):
            address = builder.gep(first, [ir.Constant(I32, start)])
            sums = _sum_16(builder, values[start : start + LANES])
            emit_store(builder, builder.fadd(emit_load(builder, address), sums), address)
        return context.get_dummy_value()

    return types.none(array, types.intp, moments, vecs), codegen
