"""Explicit SIMD vectors for numba kernels, of the width of this processor's registers.

LLVM packs a plain loop only as far as its cost model dares, which on processors with registers of 512 bits is half of
one, and it neither keeps several sums in registers over an inner loop nor stores x, y, z one after the other without
scattering. With the type of this module a kernel says what is packed, and LLVM makes the instructions.

Measured on one thread of an AMD processor (AVX-512, 493 vertices, 8 modes, MWTS): 2.1 times as many instances a second
as the plain loops of :mod:`modalshell.kernels.frame` in float64, 3.4 times in float32.
"""

# ruff: noqa: ARG001, ARG002 (numba calls code generators by position)

from __future__ import annotations

import operator
from typing import Any

import llvmlite.binding
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, Signature, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from modalshell.kernels.compiler import njit

_features = numba.config.CPU_FEATURES  # type: ignore[attr-defined]
if _features is None:
    _features = llvmlite.binding.get_host_cpu_features().flatten()
BYTES = 64 if "+avx512f" in _features.split(",") else 32
"""Size of a packed number; the kernels are compiled, and their cache is kept, for one kind of processor.

That is this machine's, or the one of numba's ``NUMBA_CPU_NAME`` and ``NUMBA_CPU_FEATURES``.
"""

LANES = BYTES // 8
"""Numbers of float64 in a packed register."""

_intrinsic: Any = intrinsic  # its annotations count the typing context as an argument of the call

# Multiplications and additions may be fused; nothing is reordered.
_FLAGS = ("contract", "nsz")


class Packed(types.Type):
    """Numba type of a SIMD vector of one precision."""

    def __init__(self, scalar: Any) -> None:
        self.scalar = scalar
        self.lanes = 8 * BYTES // scalar.bitwidth
        super().__init__(name=f"Packed({scalar} x {self.lanes})")


@register_model(Packed)
class _PackedModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Packed) -> None:
        scalar = ir.FloatType() if kind.scalar == types.float32 else ir.DoubleType()
        super().__init__(manager, kind, ir.VectorType(scalar, kind.lanes))  # type: ignore[no-untyped-call]


def _operator(function: Any, instruction: str) -> None:
    @infer_global(function)  # type: ignore[no-untyped-call]
    class _Typing(AbstractTemplate):
        def generic(self, args: tuple[Any, ...], kws: Any) -> Signature | None:
            both = len(args) == 2 and isinstance(args[0], Packed) and args[0] == args[1]
            return signature(args[0], *args) if both else None  # type: ignore[no-untyped-call]

    @lower_builtin(function, Packed, Packed)  # type: ignore[no-untyped-call]
    def _lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, instruction)(*args, flags=_FLAGS)


for _function, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _operator(_function, _instruction)


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any, vector: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def _indices(numbers: list[int]) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)


@_intrinsic
def load(typing, array, index):  # type: ignore[no-untyped-def]
    """Numbers ``index`` and following of a flat array."""
    kind = Packed(array.dtype)

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], context.get_value_type(kind))
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return kind(array, types.intp), code


@_intrinsic
def store(typing, array, index, value):  # type: ignore[no-untyped-def]
    """Write a packed number to ``index`` and following of a flat array."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], args[2].type)
        builder.store(args[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), code


@_intrinsic
def load_first(typing, array, index, count):  # type: ignore[no-untyped-def]
    """The ``count`` numbers from ``index`` on, at most a register, and zeros after them; nothing else is read."""
    kind = Packed(array.dtype)

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        vector, word = context.get_value_type(kind), ir.IntType(32)
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], vector)
        wanted = _first(builder, vector, args[2])
        made = ir.FunctionType(vector, [pointer.type, word, wanted.type, vector])
        function = _masked(builder, "load", vector, array.dtype.bitwidth, made)
        return builder.call(function, [pointer, word(array.dtype.bitwidth // 8), wanted, ir.Constant(vector, None)])

    return kind(array, types.intp, types.intp), code


@_intrinsic
def store_first(typing, array, index, value, count):  # type: ignore[no-untyped-def]
    """Write the ``count`` first of a packed number, at most all, to ``index`` and following of a flat array."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        vector, word = args[2].type, ir.IntType(32)
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], vector)
        wanted = _first(builder, vector, args[3])
        made = ir.FunctionType(ir.VoidType(), [vector, pointer.type, word, wanted.type])
        function = _masked(builder, "store", vector, array.dtype.bitwidth, made)
        builder.call(function, [args[2], pointer, word(array.dtype.bitwidth // 8), wanted])
        return context.get_dummy_value()

    return types.void(array, types.intp, value, types.intp), code


@_intrinsic
def lane_count(typing, array):  # type: ignore[no-untyped-def]
    """How many of an array's numbers are packed; known when a kernel is compiled."""
    lanes = Packed(array.dtype).lanes

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return context.get_constant(types.intp, lanes)

    return types.intp(array), code


def _first(builder: Any, vector: Any, count: Any) -> Any:
    """Which places of a ``vector`` are among the first ``count``."""
    places = _indices(list(range(vector.count)))
    return builder.icmp_signed("<", places, _spread(builder, builder.trunc(count, ir.IntType(32)), places.type))


def _masked(builder: Any, instruction: str, vector: Any, bits: int, made: Any) -> Any:
    """LLVM's masked ``instruction`` for a ``vector`` of numbers of some ``bits``, of the type ``made``."""
    name = f"llvm.masked.{instruction}.v{vector.count}f{bits}.p0v{vector.count}f{bits}"
    return cgutils.get_or_insert_function(builder.module, made, name)  # type: ignore[no-untyped-call]


def _triples(builder: Any, rows: Any) -> list[Any]:
    """x, y, z of one vertex after the other, of packed x, y and z."""
    lanes = rows[0].type.count
    mixed = []
    for part in range(3):
        # What comes to each place, by vertex and axis; x and y first, then z among them.
        wanted = [divmod(part * lanes + place, 3) for place in range(lanes)]
        plane = _indices([vertex + lanes * (axis == 1) for vertex, axis in wanted])
        whole = _indices([lanes + vertex if axis == 2 else place for place, (vertex, axis) in enumerate(wanted)])
        mixed.append(builder.shuffle_vector(builder.shuffle_vector(rows[0], rows[1], plane), rows[2], whole))
    return mixed


@_intrinsic
def store_triples(typing, array, index, x, y, z):  # type: ignore[no-untyped-def]
    """Write x, y, z of one vertex after the other to ``index`` and following of a flat array."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        target, start, *rows = args
        for part, mixed in enumerate(_triples(builder, rows)):
            at = builder.add(start, ir.Constant(start.type, part * x.lanes))
            pointer = _pointer(context, builder, sig.args[0], target, at, mixed.type)
            builder.store(mixed, pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, x, y, z), code


@_intrinsic
def store_first_triples(typing, array, index, x, y, z, count):  # type: ignore[no-untyped-def]
    """:func:`store_triples` of the first ``count`` vertices alone."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        target, start, *rows, count = args
        lanes, bits, word = x.lanes, array.dtype.bitwidth, ir.IntType(32)
        numbers = builder.trunc(builder.mul(count, ir.Constant(count.type, 3)), word)
        for part, mixed in enumerate(_triples(builder, rows)):
            at = builder.add(start, ir.Constant(start.type, part * lanes))
            pointer = _pointer(context, builder, sig.args[0], target, at, mixed.type)
            places = _indices([part * lanes + place for place in range(lanes)])
            wanted = builder.icmp_signed("<", places, _spread(builder, numbers, places.type))
            kind = ir.FunctionType(ir.VoidType(), [mixed.type, pointer.type, word, wanted.type])
            function = _masked(builder, "store", mixed.type, bits, kind)
            builder.call(function, [mixed, pointer, word(bits // 8), wanted])
        return context.get_dummy_value()

    return types.void(array, types.intp, x, y, z, types.intp), code


@_intrinsic
def prefetch(typing, array, index):  # type: ignore[no-untyped-def]
    """Fetch a cache line that will be written to: that of number ``index`` of a flat array."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        byte = ir.IntType(8).as_pointer()
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], ir.IntType(8))
        word = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
        name = "llvm.prefetch.p0i8"
        function = cgutils.get_or_insert_function(builder.module, kind, name)  # type: ignore[no-untyped-call]
        builder.call(function, [pointer, word(1), word(3), word(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), code


@_intrinsic
def spread(typing, scalar):  # type: ignore[no-untyped-def]
    """The same number everywhere."""
    kind = Packed(scalar)

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return _spread(builder, args[0], context.get_value_type(kind))

    return kind(scalar), code


@_intrinsic
def spread_from(typing, array, index):  # type: ignore[no-untyped-def]
    """Number ``index``, at least 0, of a flat array everywhere."""
    kind = Packed(array.dtype)

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        vector = context.get_value_type(kind)
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], vector.element)
        return _spread(builder, builder.load(pointer), vector)

    return kind(array, types.intp), code


def _spread(builder: Any, scalar: Any, vector: Any) -> Any:
    nothing = ir.Constant(vector, ir.Undefined)
    one = builder.insert_element(nothing, scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, nothing, _indices([0] * vector.count))


@_intrinsic
def larger(typing, first, second):  # type: ignore[no-untyped-def]
    """Place by place, ``first`` where it is larger, else ``second``; the latter too where one is not a number."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.select(builder.fcmp_ordered(">", *args), *args)

    return first(first, second), code


@_intrinsic
def any_above(typing, value, limit):  # type: ignore[no-untyped-def]
    """Whether any of the numbers is above ``limit``."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        kind = args[0].type
        above = builder.fcmp_ordered(">", args[0], _spread(builder, args[1], kind))
        bits = builder.bitcast(above, ir.IntType(kind.count))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(value, value.scalar), code


@_intrinsic
def total(typing, value):  # type: ignore[no-untyped-def]
    """Sum of the numbers, halves upon halves."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        rest, lanes = args[0], value.lanes
        while lanes > 1:
            lanes //= 2
            low, high = (_indices(list(range(start, start + lanes))) for start in (0, lanes))
            rest = builder.fadd(
                builder.shuffle_vector(rest, rest, low), builder.shuffle_vector(rest, rest, high), flags=_FLAGS
            )
        return builder.extract_element(rest, ir.Constant(ir.IntType(32), 0))

    return value.scalar(value), code


@_intrinsic
def transpose(typing, source, at, pitch, target, to, stride):  # type: ignore[no-untyped-def]
    """Write the columns of a square tile of packed rows to ``to`` and every ``stride`` numbers on.

    The rows begin at ``at`` and every ``pitch`` numbers on. All are read before one is written.
    """
    kind = Packed(source.dtype)

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        vector, lanes, align = context.get_value_type(kind), kind.lanes, source.dtype.bitwidth // 8
        place, rows = args[1], []
        for _ in range(lanes):
            rows.append(builder.load(_pointer(context, builder, source, args[0], place, vector), align=align))
            place = builder.add(place, args[2])
        apart = lanes // 2
        while apart:  # blocks off the diagonal change places, halves of halves
            upper = _indices([n if not n & apart else lanes + n - apart for n in range(lanes)])
            lower = _indices([n + apart if not n & apart else lanes + n for n in range(lanes)])
            for row in (row for row in range(lanes) if not row & apart):
                one, two = rows[row], rows[row + apart]
                rows[row] = builder.shuffle_vector(one, two, upper)
                rows[row + apart] = builder.shuffle_vector(one, two, lower)
            apart //= 2
        place = args[4]
        for row in rows:
            builder.store(row, _pointer(context, builder, target, args[3], place, vector), align=align)
            place = builder.add(place, args[5])
        return context.get_dummy_value()

    return types.void(source, types.intp, types.intp, target, types.intp, types.intp), code


@_intrinsic
def fused(typing, first, second, third):  # type: ignore[no-untyped-def]
    """``first second + third`` of float64, rounded once, where nothing else may be fused."""

    def code(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), code


@njit(error_model="numpy", fastmath={"contract", "nsz"}, nogil=True)
def dot(a, i, b, j, count):  # type: ignore[no-untyped-def]
    """Sum of the products of ``count`` numbers of two flat arrays of float64, from ``i`` and from ``j`` on.

    LLVM would pack a plain loop with "reassoc" too; but a kernel that others call exists in several copies, each
    optimised again, and which of them runs, and so how it rounds, depends on what was loaded first.
    """
    products, whole = spread(0.0), count // LANES * LANES
    for k in range(0, whole, LANES):
        products = products + load(a, i + k) * load(b, j + k)
    if whole < count:
        products = products + load_first(a, i + whole, count - whole) * load_first(b, j + whole, count - whole)
    return total(products)
