"""Sixteen values that kernels process together, in vector registers of any width.

numba leaves it to the compiler whether a loop over 16 columns becomes vector instructions. If it
does, sums over rows still go through memory, and each row is tested for overlapping arrays. Lanes
are always in registers, and results do not depend on the width of these: an operation is that of
16 single values, and `total` adds in a fixed order.

Lanes are of float32 or float64. They support ``+ - * /``, ``< <= > >=``, which give a mask, and
``&`` of masks; a single value on one side is repeated.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, overload, register_model

#: Number of lanes.
LANES = 16

_INT = ir.IntType(32)
_ORDER = ir.VectorType(_INT, LANES)
_BITS = ir.IntType(LANES)
_NO = ir.IntType(1)(0)
_BYTES = ir.IntType(8).as_pointer()


class _Lanes(types.Type):
    """numba's type of 16 floats; `element` is the type of one."""

    def __init__(self, element: types.Float) -> None:
        super().__init__(f"Lanes({element})")
        self.element = element

    @property
    def vector(self) -> ir.VectorType:
        """The type in machine code."""
        return _vector(self.element)


class _Mask(types.Type):
    """numba's type of 16 booleans."""

    vector = ir.VectorType(ir.IntType(1), LANES)


@register_model(_Lanes)
@register_model(_Mask)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


_FLOAT32, _FLOAT64, _MASK = _Lanes(types.float32), _Lanes(types.float64), _Mask("Mask")


def _vector(element: Any) -> ir.VectorType:
    known = {types.float32: ir.FloatType(), types.float64: ir.DoubleType()}
    return ir.VectorType(known.get(element) or ir.IntType(element.bitwidth), LANES)


def _lanes_of(element: Any) -> _Lanes:
    return _FLOAT64 if element == types.float64 else _FLOAT32


def _operation(function: Callable) -> Any:
    """An intrinsic whose source counts when the cache decides whether kernels are up to date."""
    made = intrinsic(function)
    made.py_func = function
    return made


@_operation
def load(typing: Any, array: Any, at: Any) -> Any:
    """The 16 values of a C-contiguous array from its value number `at`; integers become float32."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kind = signature.args[0].dtype
        loaded = builder.load(_place(context, builder, signature, given), align=kind.bitwidth // 8)
        return loaded if isinstance(kind, types.Float) else builder.uitofp(loaded, _FLOAT32.vector)

    return _lanes_of(array.dtype)(array, types.intp), generate


@_operation
def store(typing: Any, array: Any, at: Any, lanes: Any) -> Any:
    """Store lanes in a C-contiguous array from its value number `at`; integers are cut off."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kind, values = signature.args[0].dtype, given[2]
        if not isinstance(kind, types.Float):
            values = builder.fptoui(values, _vector(kind))
        place = _place(context, builder, signature, given)
        builder.store(values, place, align=kind.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, _lanes_of(array.dtype)), generate


@_operation
def prefetch(typing: Any, array: Any, at: Any) -> Any:
    """Bring the cache line of value number `at` of a C-contiguous array nearer."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, given[0])
        place = builder.bitcast(builder.gep(array.data, [given[1]]), _BYTES)
        kind = ir.FunctionType(ir.VoidType(), [_BYTES, _INT, _INT, _INT])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(function, [place, _INT(0), _INT(3), _INT(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


def _place(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    """Pointer to the first of 16 values of an array."""
    kind, at = signature.args[0], given[1]
    array = context.make_array(kind)(context, builder, given[0])
    if context.enable_boundscheck:
        length = array.nitems
        for index in (at, builder.add(at, at.type(LANES - 1))):
            cgutils.do_boundscheck(context, builder, index, length, 0)
    return builder.bitcast(builder.gep(array.data, [at]), _vector(kind.dtype).as_pointer())


def _repeated(builder: Any, value: Any) -> Any:
    vector = ir.VectorType(value.type, LANES)
    nothing = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(nothing, value, _INT(0))
    return builder.shuffle_vector(first, nothing, ir.Constant(_ORDER, [0] * LANES))


@_operation
def repeated(typing: Any, value: Any) -> Any:
    """Lanes that all have one value."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return _repeated(builder, given[0])

    return _lanes_of(value)(value), generate


@_operation
def columns(typing: Any) -> Any:
    """The lanes 0, 1, ..., 15."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return ir.Constant(_FLOAT32.vector, [float(k) for k in range(LANES)])

    return _FLOAT32(), generate


@_operation
def wide(typing: Any, lanes: Any) -> Any:
    """The same lanes as float64."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.fpext(given[0], _FLOAT64.vector)

    return _FLOAT64(_FLOAT32), generate


@_operation
def where(typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Lanes of `yes` where a mask is true, of `no` elsewhere."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.select(*given)

    return yes(mask, yes, no), generate


@_operation
def between(typing: Any, first: Any, last: Any) -> Any:
    """The mask of lanes `first` to `last`."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        order = ir.Constant(_ORDER, list(range(LANES)))
        low, high = (_repeated(builder, builder.trunc(end, _INT)) for end in given)
        return builder.and_(
            builder.icmp_signed(">=", order, low), builder.icmp_signed("<=", order, high)
        )

    return _MASK(types.int64, types.int64), generate


@_operation
def bits_of(typing: Any, mask: Any) -> Any:
    """A mask as the bits of an integer, lane 0 the lowest."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.zext(builder.bitcast(given[0], _BITS), ir.IntType(64))

    return types.int64(_MASK), generate


@_operation
def mask_of(typing: Any, bits: Any) -> Any:
    """The mask of `bits_of`."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.bitcast(builder.trunc(given[0], _BITS), _MASK.vector)

    return _MASK(types.int64), generate


@_operation
def first_of(typing: Any, mask: Any) -> Any:
    """The first true lane of a mask; 16 if there is none."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        bits = builder.bitcast(given[0], _BITS)
        return builder.zext(builder.cttz(bits, _NO), ir.IntType(64))

    return types.int64(_MASK), generate


@_operation
def last_of(typing: Any, mask: Any) -> Any:
    """The last true lane of a mask; -1 if there is none."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        bits = builder.bitcast(given[0], _BITS)
        after = builder.zext(builder.ctlz(bits, _NO), ir.IntType(64))
        return builder.sub(after.type(LANES - 1), after)

    return types.int64(_MASK), generate


@_operation
def cut_off(typing: Any, lanes: Any) -> Any:
    """The lanes without their fractions; they must be in the range of int32."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.sitofp(builder.fptosi(given[0], _ORDER), _FLOAT32.vector)

    return _FLOAT32(_FLOAT32), generate


@_operation
def largest(typing: Any, lanes: Any) -> Any:
    """The largest lane."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        found = given[0]
        for apart in (8, 4, 2, 1):
            order = [(k + apart) % LANES for k in range(LANES)]
            other = builder.shuffle_vector(found, found, ir.Constant(_ORDER, order))
            found = builder.select(builder.fcmp_ordered(">", other, found), other, found)
        return builder.extract_element(found, _INT(0))

    return lanes.element(lanes), generate


@_operation
def total(typing: Any, lanes: Any) -> Any:
    """Sum of the lanes: of each fourth lane first, then of these four sums in pairs."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        quarter = ir.VectorType(_INT, 4)
        parts = [
            builder.shuffle_vector(
                given[0], given[0], ir.Constant(quarter, list(range(first, first + 4)))
            )
            for first in range(0, LANES, 4)
        ]
        added = parts[0]
        for part in parts[1:]:
            added = builder.fadd(added, part)
        a, b, c, d = (builder.extract_element(added, _INT(k)) for k in range(4))
        return builder.fadd(builder.fadd(a, b), builder.fadd(c, d))

    return lanes.element(lanes), generate


def _between_lanes(result: Callable[[Any], Any], build: Callable) -> Any:
    """An intrinsic of two lanes, or masks, of one type."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return build(builder, *given)

    return intrinsic(lambda typing, a, b: (result(a)(a, b), generate))


@intrinsic
def _like(typing: Any, lanes: Any, value: Any) -> Any:
    """Lanes of the same kind that all have one value."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return _repeated(builder, given[1])

    return lanes(lanes, lanes.element), generate


def _support(symbol: Callable, applied: Any) -> None:
    """Let an operator take lanes, or lanes and a single value."""

    def both(a: Any, b: Any) -> Any:
        return applied(a, b)

    def first(a: Any, b: Any) -> Any:
        return applied(a, _like(a, b))

    def second(a: Any, b: Any) -> Any:
        return applied(_like(b, a), b)

    @overload(symbol, strict=False)
    def of_lanes(a: Any, b: Any) -> Any:
        if isinstance(a, _Lanes) and isinstance(b, _Lanes):
            return both
        return first if isinstance(a, _Lanes) else second if isinstance(b, _Lanes) else None


_ARITHMETIC = {"add": "fadd", "iadd": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}
for _symbol, _name in _ARITHMETIC.items():
    _support(getattr(operator, _symbol), _between_lanes(lambda a: a, getattr(ir.IRBuilder, _name)))

for _symbol, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">="}.items():

    def _compare(builder: Any, a: Any, b: Any, sign: str = _sign) -> Any:
        return builder.fcmp_ordered(sign, a, b)

    _support(getattr(operator, _symbol), _between_lanes(lambda a: _MASK, _compare))

_both = _between_lanes(lambda a: _MASK, ir.IRBuilder.and_)


@overload(operator.and_, strict=False)
def _and(a: Any, b: Any) -> Any:
    def both(a: Any, b: Any) -> Any:
        return _both(a, b)

    return both if isinstance(a, _Mask) and isinstance(b, _Mask) else None
