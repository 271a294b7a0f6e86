"""numba decorator and LLVM intrinsics for the compiled loops."""

from __future__ import annotations

from collections.abc import Callable
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


@intrinsic
def copy_bytes(typing_context, target, at, source, start, count):  # type: ignore[no-untyped-def]
    """target[at : at + count] = source[start : start + count], uint8, without bounds checks."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        into = address(context, builder, signature.args[0], args[0], args[1])
        origin = address(context, builder, signature.args[2], args[2], args[3])
        _memcpy(builder, into, origin, args[4], 1)
        return context.get_dummy_value()

    return types.void(target, types.int64, source, types.int64, types.int64), generate


@intrinsic
def clear_bytes(typing_context, target, at, count):  # type: ignore[no-untyped-def]
    """target[at : at + count] = 0, uint8, without bounds checks."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        _memset(builder, address(context, builder, signature.args[0], args[0], args[1]), args[2], 0)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.int64), generate


@intrinsic
def low_zeros(typing_context, word):  # type: ignore[no-untyped-def]
    """Number of trailing zero bits of a uint64; 64 for 0."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), generate


@intrinsic
def high_zeros(typing_context, word):  # type: ignore[no-untyped-def]
    """Number of leading zero bits of a uint64; 64 for 0."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.ctlz(args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), generate
