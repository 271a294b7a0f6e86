"""numba decorator and LLVM intrinsics for the compiled loops."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, Signature
from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba import extending
from numba.core import cgutils, types
from numba.np.arrayobj import make_array

# numba's internal functions have no usable type annotations.
intrinsic: Callable[..., Any] = extending.intrinsic
_array: Callable[..., Any] = make_array
_memcpy: Callable[..., Any] = cgutils.raw_memcpy
_memset: Callable[..., Any] = cgutils.memset

LONG = ir.IntType(64)


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}  # no errors, no counts of references
jit: Callable[..., Any] = numba.njit(**_OPTIONS)


def vector(bits: int, lanes: int) -> Any:
    """Return LLVM's type of a vector of `lanes` integers of `bits` each."""
    return ir.VectorType(ir.IntType(bits), lanes)


def lane_indices(numbers: list[int]) -> Any:
    """Return the constant that lists the lanes of a shuffle."""
    return ir.Constant(vector(32, len(numbers)), numbers)


def address(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    """Return the address of byte `index` of a uint8 array."""
    return builder.gep(_array(kind)(context, builder, array).data, [index])


def define_intrinsic(count: int, emit: Callable[..., Any], result: Any = types.void) -> Any:
    """Return a numba function of `count` arguments whose LLVM code `emit(builder, *arguments)` writes.

    Arguments are int64, and uint8 arrays, of which the code gets the address of the first byte.
    """

    def define(context: Any, *given: Any) -> Any:
        kinds = [kind if isinstance(kind, types.Array) else types.int64 for kind in given]

        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            values = [
                _array(kind)(context, builder, value).data if isinstance(kind, types.Array) else value
                for kind, value in zip(signature.args, args, strict=True)
            ]
            made = emit(builder, *values)
            return context.get_dummy_value() if result is types.void else made

        return result(*kinds), generate

    # numba takes the number of arguments from the function's signature.
    names = ["context", *(f"argument_{n}" for n in range(count))]
    define.__signature__ = Signature([Parameter(name, Parameter.POSITIONAL_OR_KEYWORD) for name in names])  # type: ignore[attr-defined]
    return intrinsic(define)


def _copy(builder: Any, target: Any, at: Any, source: Any, start: Any, count: Any) -> None:
    _memcpy(builder, builder.gep(target, [at]), builder.gep(source, [start]), count, 1)


def _clear(builder: Any, target: Any, at: Any, count: Any) -> None:
    _memset(builder, builder.gep(target, [at]), count, 0)


_NO = ir.Constant(ir.IntType(1), 0)
# copy_bytes(target, at, source, start, count): target[at : at + count] = source[start : start + count], uint8, without
# bounds checks. clear_bytes(target, at, count): target[at : at + count] = 0.
copy_bytes = define_intrinsic(5, _copy)
clear_bytes = define_intrinsic(3, _clear)
# low_zeros(word), high_zeros(word): the number of trailing and of leading zero bits of a uint64; 64 for 0.
low_zeros = define_intrinsic(1, lambda builder, word: builder.cttz(word, _NO), types.int64)
high_zeros = define_intrinsic(1, lambda builder, word: builder.ctlz(word, _NO), types.int64)
