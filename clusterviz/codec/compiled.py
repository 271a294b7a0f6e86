"""Compiling with numba, and the few things that its compiler must be told in LLVM's words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba import extending
from numba.core import cgutils, types
from numba.np.arrayobj import make_array

# numba's own building blocks carry no types, or those of their inner side.
intrinsic: Callable[..., Any] = extending.intrinsic
_array: Callable[..., Any] = make_array
_memcpy: Callable[..., Any] = cgutils.raw_memcpy
_memset: Callable[..., Any] = cgutils.memset

LONG = ir.IntType(64)


def compiled(function: Callable[..., Any]) -> Any:
    """Compiled once for all, or for each process where no folder for numba's cache can be written."""
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:
        return numba.njit(nogil=True)(function)


def vector(bits: int, lanes: int) -> Any:
    """LLVM's type for `lanes` integers of `bits` each."""
    return ir.VectorType(ir.IntType(bits), lanes)


def lanes_of(numbers: list[int]) -> Any:
    """Which lanes a shuffle takes."""
    return ir.Constant(vector(32, len(numbers)), numbers)


def address(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    """Where byte `index` of a uint8 array lies."""
    return builder.gep(_array(kind)(context, builder, array).data, [index])


@intrinsic
def copy_bytes(typing_context, target, at, source, start, count):  # type: ignore[no-untyped-def]
    """target[at : at + count] = source[start : start + count], uint8, without a check of any bound."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        into = address(context, builder, signature.args[0], args[0], args[1])
        origin = address(context, builder, signature.args[2], args[2], args[3])
        _memcpy(builder, into, origin, args[4], 1)
        return context.get_dummy_value()

    return types.void(target, types.int64, source, types.int64, types.int64), generate


@intrinsic
def clear_bytes(typing_context, target, at, count):  # type: ignore[no-untyped-def]
    """target[at : at + count] = 0, uint8, without a check of any bound."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        _memset(builder, address(context, builder, signature.args[0], args[0], args[1]), args[2], 0)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.int64), generate


@intrinsic
def low_zeros(typing_context, word):  # type: ignore[no-untyped-def]
    """How many of the lowest bits of a uint64 are 0; 64 for 0."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), generate


@intrinsic
def high_zeros(typing_context, word):  # type: ignore[no-untyped-def]
    """How many of the highest bits of a uint64 are 0; 64 for 0."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.ctlz(args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), generate
