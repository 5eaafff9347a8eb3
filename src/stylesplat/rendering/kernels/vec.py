"""Sixteen float32 lanes as one value inside numba kernels.

LLVM lowers `<16 x float>` to AVX-512, two AVX2 or four NEON registers. Plain loops that numba
vectorises by itself were several times slower here. `Vec` has `+ - * /` with another `Vec` or a
number, fused multiply-add, comparisons that give a 16-lane mask, and exp; `Vecs` are tuples of
vectors. numba does not notice edits of a file in the caches of its callers: after an edit of a
kernel that others import, delete `__pycache__` in this folder and in `stylization/`.
"""
# pyright: reportCallIssue=false
# (it cannot count the arguments of starred lists)

import operator
from collections.abc import Callable
from inspect import unwrap
from typing import Any, NamedTuple, no_type_check

import numba.extending
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_jitable, register_model

LANES = 16
F32 = ir.FloatType()
I32 = ir.IntType(32)
VEC = ir.VectorType(F32, LANES)
HALVES = ir.VectorType(ir.HalfType(), LANES)
MASK = ir.VectorType(ir.IntType(1), LANES)


class FlatRows(NamedTuple):
    """Rows of one length."""

    flat: np.ndarray
    stride: int
    """Length of a row: a multiple of 16 floats, one cache line."""

    def part(self, some: slice) -> "FlatRows":
        """Some of the rows."""
        return self._replace(flat=self.flat[some.start * self.stride : some.stop * self.stride])


class RowPlace(NamedTuple):
    """Where a row, or the pixels of a block, begin."""

    flat: np.ndarray
    first: int


class VecType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Vec")


class MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Mask")


vec, mask = VecType(), MaskType()


@register_model(VecType)
class _VecModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, VEC)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, MASK)


def intrinsic(function: Callable[..., Any]) -> Any:
    """numba's `intrinsic`, without what tests wrap every function in to check types."""
    return numba.extending.intrinsic(unwrap(function))


def emit_broadcast(builder, scalar):
    first = builder.insert_element(ir.Constant(VEC, ir.Undefined), scalar, ir.Constant(I32, 0))
    zeros = ir.Constant(ir.VectorType(I32, LANES), [0] * LANES)
    return builder.shuffle_vector(first, ir.Constant(VEC, ir.Undefined), zeros)


def emit_address(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


def emit_load(builder, address):
    return builder.load(builder.bitcast(address, VEC.as_pointer()), align=4)


def emit_store(builder, value, address):
    builder.store(value, builder.bitcast(address, VEC.as_pointer()), align=4)


def emit_call(builder, name, result, args):
    signature = ir.FunctionType(result, [a.type for a in args])
    function = cgutils.get_or_insert_function(builder.module, signature, name)
    return builder.call(function, args)


def emit_fma(builder, a, b, c):
    return emit_call(builder, "llvm.fma.v16f32", VEC, [a, b, c])


def _lanes(builder, types_, args):
    return [
        emit_broadcast(builder, a) if isinstance(t, types.Float) else a
        for t, a in zip(types_, args, strict=True)
    ]


NUMBERS = types.Float, types.Integer


def _lane_op(arity, emit, result=vec):
    """An intrinsic of Vecs or masks; numbers are broadcast to all lanes."""

    def typed(*operands):
        operands = [types.float32 if isinstance(o, NUMBERS) else o for o in operands]

        def codegen(context, builder, signature, args):
            return emit(builder, *_lanes(builder, signature.args, args))

        return result(*operands), codegen

    if arity == 1:
        return intrinsic(lambda typingctx, a: typed(a))
    if arity == 2:
        return intrinsic(lambda typingctx, a, b: typed(a, b))
    return intrinsic(lambda typingctx, a, b, c: typed(a, b, c))


def _overload_operator(symbol, name):
    """Give an operator a meaning for two Vecs, or a Vec and a number.

    Typed and lowered directly: numba's `overload` would compile a function per pair of types.
    """

    @infer_global(symbol)  # pyright: ignore[reportOptionalCall]
    class _Operator(AbstractTemplate):
        def generic(self, args, kws):
            if vec in args and all(isinstance(each, (VecType, *NUMBERS)) for each in args):
                return signature(vec, *(each if each is vec else types.float32 for each in args))
            return None

    def lower(context, builder, signature, args):
        return getattr(builder, name)(*_lanes(builder, signature.args, args))

    for operands in ((VecType, VecType), (VecType, types.Float), (types.Float, VecType)):
        lower_builtin(symbol, *operands)(lower)


_overload_operator(operator.add, "fadd")
_overload_operator(operator.sub, "fsub")
_overload_operator(operator.mul, "fmul")
_overload_operator(operator.truediv, "fdiv")

fma = _lane_op(3, emit_fma)
"""`a * b + c`, rounded once."""
minimum = _lane_op(2, lambda b, x, y: emit_call(b, "llvm.minnum.v16f32", VEC, [x, y]))
maximum = _lane_op(2, lambda b, x, y: emit_call(b, "llvm.maxnum.v16f32", VEC, [x, y]))
greater = _lane_op(2, lambda b, x, y: b.fcmp_ordered(">", x, y), mask)
greater_equal = _lane_op(2, lambda b, x, y: b.fcmp_ordered(">=", x, y), mask)
equal = _lane_op(2, lambda b, x, y: b.fcmp_ordered("==", x, y), mask)
both = _lane_op(2, lambda b, x, y: b.and_(x, y), mask)
select = _lane_op(3, lambda b, m, x, y: b.select(m, x, y))
"""Lanes of the second argument where the mask holds, else of the third."""
sqrt = _lane_op(1, lambda b, x: emit_call(b, "llvm.sqrt.v16f32", VEC, [x]))
ceil = _lane_op(1, lambda b, x: emit_call(b, "llvm.ceil.v16f32", VEC, [x]))
absolute = _lane_op(1, lambda b, x: emit_call(b, "llvm.fabs.v16f32", VEC, [x]))
reciprocal = _lane_op(
    1, lambda b, x: b.fdiv(ir.Constant(VEC, [1.0] * LANES), x, flags=("arcp", "contract"))
)
"""1 / x to float32 precision, by an estimate and a Newton step where the processor has one."""


@intrinsic
def load_vec(typingctx, array, index):
    """The 16 numbers of a flat float32 array that start at `index`."""

    def codegen(context, builder, signature, args):
        return emit_load(builder, emit_address(context, builder, signature.args[0], *args))

    return vec(array, types.intp), codegen


@intrinsic
def spread(typingctx, array, index):
    """All lanes set to one number of a flat float32 array; the index must not be negative."""

    def codegen(context, builder, signature, args):
        address = emit_address(context, builder, signature.args[0], *args)
        return emit_broadcast(builder, builder.load(address))

    return vec(array, types.intp), codegen


@intrinsic
def spread_row(typingctx, place, column):
    """All lanes set to one number of the row at a place; see `spread`."""

    def codegen(context, builder, signature, args):
        flat, first = cgutils.unpack_tuple(builder, args[0], 2)
        index = builder.add(first, args[1])
        address = emit_address(context, builder, place.types[0], flat, index)
        return emit_broadcast(builder, builder.load(address))

    return vec(place, types.intp), codegen


@intrinsic
def store_vec(typingctx, array, index, value):
    """Write 16 numbers to a flat float32 array, starting at `index`."""

    def codegen(context, builder, signature, args):
        emit_store(builder, args[2], emit_address(context, builder, signature.args[0], *args[:2]))
        return context.get_dummy_value()

    return types.none(array, types.intp, vec), codegen


@intrinsic
def load_halves(typingctx, array, index):
    """16 numbers of a flat array of float16, kept as uint16, that start at `index`."""

    def codegen(context, builder, signature, args):
        address = emit_address(context, builder, signature.args[0], *args)
        halves = builder.load(builder.bitcast(address, HALVES.as_pointer()), align=2)
        return builder.fpext(halves, VEC)

    return vec(array, types.intp), codegen


@intrinsic
def store_halves(typingctx, array, index, value):
    """Write 16 numbers, rounded to float16, to a flat array of uint16."""

    def codegen(context, builder, signature, args):
        address = emit_address(context, builder, signature.args[0], *args[:2])
        halves = builder.fptrunc(args[2], HALVES)
        builder.store(halves, builder.bitcast(address, HALVES.as_pointer()), align=2)
        return context.get_dummy_value()

    return types.none(array, types.intp, vec), codegen


@intrinsic
def prefetch(typingctx, array, index):
    """Ask for the cache line of `array[index]`."""

    def codegen(context, builder, signature, args):
        byte = ir.IntType(8).as_pointer()
        address = emit_address(context, builder, signature.args[0], *args)
        hints = [ir.Constant(I32, n) for n in (0, 3, 1)]  # read, keep, data
        arguments = [builder.bitcast(address, byte), *hints]
        emit_call(builder, "llvm.prefetch.p0", ir.VoidType(), arguments)
        return context.get_dummy_value()

    return types.none(array, types.intp), codegen


@intrinsic
def bits(typingctx, lanes):
    """A mask as an integer, lane 0 in the lowest bit."""

    def codegen(context, builder, signature, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))

    return types.int64(lanes), codegen


@intrinsic
def lowest_bit(typingctx, integer):
    """Position of the lowest set bit of an integer that is not 0."""

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen


def _constant(numbers):
    """An intrinsic without operands: a constant vector."""

    @intrinsic
    def constant(typingctx):
        return vec(), lambda context, builder, signature, args: ir.Constant(VEC, numbers)

    return constant


zero = _constant([0.0] * LANES)
"""All lanes 0."""
columns = _constant([float(lane % 4) for lane in range(LANES)])
"""Lane l holds the column of pixel l in a 4 x 4 block, 0 to 3."""
rows = _constant([float(lane // 4) for lane in range(LANES)])
"""Lane l holds the row of pixel l in a 4 x 4 block, 0 to 3."""


# Minimax polynomial of exp on -0.7..0, relative error 2e-7 before the eighth power.
EXP_TERMS = (
    *(0.9999999403953552, 0.9999925494193031, 0.4998825788497925),
    *(0.1659739762544632, 0.039772555232048035, 0.005846756976097822),
)


@register_jitable
@no_type_check
def exp_of_eighth(y):
    """exp(8 y) for -0.7 <= y <= 0, to 2e-6 relative: a polynomial, to the eighth power."""
    p = fma(y, EXP_TERMS[5], EXP_TERMS[4])
    p = fma(p, y, EXP_TERMS[3])
    p = fma(p, y, EXP_TERMS[2])
    p = fma(p, y, EXP_TERMS[1])
    p = fma(p, y, EXP_TERMS[0])
    p = p * p
    p = p * p
    return p * p


# Tuples of vectors, one per channel, held in registers. `Vecs[n]` is n values of type `Vec`. n is
# the length of a tuple that the caller passes, hence part of its type and known to the compiler, so
# each number of channels has its own unrolled code. The tuple's elements mean nothing: `channels`
# makes one.


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
