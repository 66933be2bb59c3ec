"""SIMD vectors of sixteen float32 values for compiled kernels.

LLVM unrolls short loops before it can vectorise them, and must assume that inputs and outputs
overlap. Values of the type below are vectors from the start and stay in registers. A kernel loads
neighbours from a flat array, computes with ``+ - * /`` (a scalar is broadcast to all lanes) and
stores the result::

    height = load(z, at) - column * gx - row * gy
    store(out, at, larger(height, load(out, at)))

Every comparison with NaN is false, so undefined lanes beyond the last element do no harm. Indices
are not checked.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, config, types
from numba.core.errors import TypingError
from numba.extending import intrinsic, models, overload, register_model

SIMD_WIDTH = 16

_FLOAT = ir.FloatType()
_VECTOR = ir.VectorType(_FLOAT, SIMD_WIDTH)
_MASK = ir.IntType(SIMD_WIDTH)
# Allow fused multiply-adds, and products instead of divisions by the same number.
_FLAGS = ("contract", "nsz", "arcp")


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"Lanes{SIMD_WIDTH}")


_lanes = _Lanes()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


def _vector_address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Return the address of sixteen consecutive elements of an array from an index."""
    data = cgutils.create_struct_proxy(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


def _want(argument: Any, kind: type) -> None:
    if not isinstance(argument, kind):
        raise TypingError(f"expected {kind.__name__}, got {argument}")


def _want_line(array: Any, dtype: Any = None) -> None:
    _want(array, types.Array)
    if array.ndim != 1 or array.layout != "C" or array.dtype != (dtype or array.dtype):
        raise TypingError(f"expected a contiguous 1-D array, got {array}")


@intrinsic  # type: ignore[untyped-decorator]
def load(typing: Any, array: Any, index: Any) -> Any:
    """Return sixteen elements of a contiguous float32 array (n,) as a SIMD vector.

    `index` is that of the first element.
    """
    _want_line(array, types.float32)
    _want(index, types.Integer)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_vector_address(context, builder, signature.args[0], *args), align=4)

    return _lanes(array, types.int64), code


@intrinsic  # type: ignore[untyped-decorator]
def item(typing: Any, array: Any, index: Any) -> Any:
    """Return the element of a contiguous array (n,) at a non-negative index."""
    _want_line(array)
    _want(index, types.Integer)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[0]
        data = cgutils.create_struct_proxy(kind)(context, builder, args[0]).data
        return context.unpack_value(builder, kind.dtype, builder.gep(data, [args[1]]))

    return array.dtype(array, types.int64), code


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write a SIMD vector to sixteen elements of a contiguous float32 array (n,).

    `index` is that of the first element.
    """
    _want_line(array, types.float32)
    _want(index, types.Integer)
    _want(value, _Lanes)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(
            args[2], _vector_address(context, builder, signature.args[0], args[0], args[1]), align=4
        )
        return context.get_dummy_value()

    return types.void(array, types.int64, _lanes), code


@intrinsic  # type: ignore[untyped-decorator]
def lane_fill(typing: Any, number: Any) -> Any:
    """Return a SIMD vector with the same number in all sixteen lanes."""
    _want(number, types.Number)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        undefined = ir.Constant(_VECTOR, ir.Undefined)
        one = builder.insert_element(undefined, args[0], ir.Constant(ir.IntType(32), 0))
        first = ir.Constant(ir.VectorType(ir.IntType(32), SIMD_WIDTH), [0] * SIMD_WIDTH)
        return builder.shuffle_vector(one, undefined, first)

    return _lanes(types.float32), code


def _binary_operation(generate: Callable[[Any, Any, Any], Any]) -> Any:
    """Return a compiled function of two SIMD vectors.

    ``generate(builder, a, b)`` generates its LLVM code.
    """

    def typed(typing: Any, a: Any, b: Any) -> Any:
        _want(a, _Lanes)
        _want(b, _Lanes)

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return generate(builder, *args)

        return _lanes(_lanes, _lanes), code

    return intrinsic(typed)


_add = _binary_operation(lambda builder, a, b: builder.fadd(a, b, flags=_FLAGS))
_subtract = _binary_operation(lambda builder, a, b: builder.fsub(a, b, flags=_FLAGS))
_multiply = _binary_operation(lambda builder, a, b: builder.fmul(a, b, flags=_FLAGS))
_divide = _binary_operation(lambda builder, a, b: builder.fdiv(a, b, flags=_FLAGS))
lane_max = _binary_operation(
    lambda builder, a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b)
)


def _overload_operator(operation: Any, vector_function: Any) -> None:
    """Define an operator such as `operator.add` for SIMD vectors, and with a number.

    `vector_function` computes it for two vectors; a number is copied to all lanes.
    """

    # No annotations: Numba compares this signature with those below.
    @overload(operation)
    def choose(a, b):  # type: ignore[no-untyped-def]
        if isinstance(a, _Lanes) and isinstance(b, _Lanes):
            return lambda a, b: vector_function(a, b)  # noqa: PLW0108 - of this very signature
        if isinstance(a, _Lanes) and isinstance(b, types.Number):
            return lambda a, b: vector_function(a, lane_fill(b))
        if isinstance(a, types.Number) and isinstance(b, _Lanes):
            return lambda a, b: vector_function(lane_fill(a), b)
        return None


for _symbol, _function in (
    (operator.add, _add),
    (operator.sub, _subtract),
    (operator.mul, _multiply),
    (operator.truediv, _divide),
):
    _overload_operator(_symbol, _function)


def _unary_operation(llvm_name: str) -> Any:
    """Return a compiled function of one SIMD vector from the LLVM intrinsic's name."""

    def typed(typing: Any, a: Any) -> Any:
        _want(a, _Lanes)

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = ir.FunctionType(_VECTOR, [_VECTOR])
            function = cgutils.get_or_insert_function(
                builder.module, kind, f"llvm.{llvm_name}.v{SIMD_WIDTH}f32"
            )
            return builder.call(function, args)

        return _lanes(_lanes), code

    return intrinsic(typed)


lane_sqrt = _unary_operation("sqrt")
lane_abs = _unary_operation("fabs")


@intrinsic  # type: ignore[untyped-decorator]
def select_ge(typing: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
    """Return the values of `yes` in lanes with a >= b, and of `no` in the other lanes."""
    for argument in (a, b, yes, no):
        _want(argument, _Lanes)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">=", args[0], args[1]), args[2], args[3])

    return _lanes(_lanes, _lanes, _lanes, _lanes), code


@intrinsic  # type: ignore[untyped-decorator]
def any_greater(typing: Any, a: Any, b: Any) -> Any:
    """Return whether a > b in any lane of two SIMD vectors."""
    _want(a, _Lanes)
    _want(b, _Lanes)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        above = builder.bitcast(builder.fcmp_ordered(">", *args), _MASK)
        return builder.icmp_unsigned("!=", above, ir.Constant(_MASK, 0))

    return types.boolean(_lanes, _lanes), code


if config.DISABLE_JIT:
    from lunarsim._simd_numpy import (  # noqa: F401
        any_greater,
        item,
        lane_abs,
        lane_fill,
        lane_max,
        lane_sqrt,
        load,
        select_ge,
        store,
    )
