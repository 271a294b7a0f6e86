"""The over operator at memory speed, imported only where something is blended.

The inner step is written in vectors, because numba's compiler leaves the plain loop scalar (floats) or takes twice as
long as memory does (bytes): 64 bytes or 16 floats a step. LLVM splits the vectors for processors with narrower
registers. What is left over at the end of a run goes through the same formula one pixel at a time.

A product of two bytes is at most 65,025, and its division by 255 rounded to nearest is
(x + 128 + ((x + 128) >> 8)) >> 8, all within 16 bits, so even and odd bytes are taken apart into 16-bit lanes. The sum
is cut to 255: premultiplied pixels never exceed it, but a colour that was rounded up past its alpha may, by one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

# numba's own building blocks carry no types.
_function: Callable[..., Any] = cgutils.get_or_insert_function
_array: Callable[..., Any] = make_array

_BYTES = ir.VectorType(ir.IntType(8), 64)
_WORDS = ir.VectorType(ir.IntType(16), 32)
_FLOATS = ir.VectorType(ir.FloatType(), 16)
_INDICES = ir.VectorType(ir.IntType(32), 64)


def _compiled(function: Callable[..., Any]) -> Any:
    """Compiled once for all, or for each process where no folder for numba's cache can be written."""
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:
        return numba.njit(nogil=True)(function)


def _blend_bytes(builder: Any, front: Any, back: Any) -> Any:
    """LLVM for front over back, sixteen uint8 pixels."""
    # 255 − alpha of the pixel, in each 16-bit lane: byte 3 of four below, and a zero (byte 64) above.
    lanes = ir.Constant(_INDICES, [lane // 4 * 4 + 3 if lane % 2 == 0 else 64 for lane in range(64)])
    rest = builder.shuffle_vector(builder.not_(front), ir.Constant(_BYTES, [0] * 64), lanes)
    rest = builder.bitcast(rest, _WORDS)
    half, eight, low = (ir.Constant(_WORDS, [value] * 32) for value in (128, 8, 255))

    def weigh(channel: Any) -> Any:
        product = builder.add(builder.mul(channel, rest), half)
        return builder.lshr(builder.add(product, builder.lshr(product, eight)), eight)

    words = builder.bitcast(back, _WORDS)
    even, odd = weigh(builder.and_(words, low)), weigh(builder.lshr(words, eight))
    seen = builder.bitcast(builder.or_(even, builder.shl(odd, eight)), _BYTES)
    kind = ir.FunctionType(_BYTES, [_BYTES, _BYTES])
    add = _function(builder.module, kind, "llvm.uadd.sat.v64i8")
    return builder.call(add, [front, seen])


def _blend_floats(builder: Any, front: Any, back: Any) -> Any:
    """LLVM for front over back, four float32 pixels."""
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), 16), [lane // 4 * 4 + 3 for lane in range(16)])
    alpha = builder.shuffle_vector(front, front, lanes)
    rest = builder.fsub(ir.Constant(_FLOATS, [1.0] * 16), alpha)
    return builder.fadd(front, builder.fmul(rest, back))


def _step(vector: Any, blend: Callable[[Any, Any, Any], Any]) -> Any:
    """A function for numba: target[i : i + n] = front[i : i + n] over back[i : i + n], n numbers a vector."""

    @intrinsic
    def step(typing_context, target, front, back, index):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            def place(number: int) -> Any:
                data = _array(signature.args[number])(context, builder, args[number]).data
                return builder.bitcast(builder.gep(data, [args[3]]), vector.as_pointer())

            bytes_aligned = 1 if vector is _BYTES else 4
            loaded = [builder.load(place(number), align=bytes_aligned) for number in (1, 2)]
            builder.store(blend(builder, *loaded), place(0), align=bytes_aligned)
            return context.get_dummy_value()

        return types.void(target, front, back, index), generate

    return step


_step_bytes = _step(_BYTES, _blend_bytes)
_step_floats = _step(_FLOATS, _blend_floats)


@_compiled
def _over_bytes(target, front, back):  # type: ignore[no-untyped-def]
    """target = front over back, uint8 pixels laid end to end; the target may be either of them."""
    whole = target.size // 64 * 64
    for i in range(0, whole, 64):
        _step_bytes(target, front, back, i)
    for i in range(whole, target.size, 4):
        rest = 255 - front[i + 3]
        for j in range(i, i + 4):
            product = back[j] * rest + 128
            target[j] = min(front[j] + ((product + (product >> 8)) >> 8), 255)


@_compiled
def _over_floats(target, front, back):  # type: ignore[no-untyped-def]
    """target = front over back, float32 pixels laid end to end; the target may be either of them."""
    whole = target.size // 16 * 16
    for i in range(0, whole, 16):
        _step_floats(target, front, back, i)
    for i in range(whole, target.size, 4):
        rest = numba.float32(1) - front[i + 3]
        for j in range(i, i + 4):
            target[j] = front[j] + rest * back[j]


@_compiled
def put_bytes(target, source, before, start, skip, length, stride):  # type: ignore[no-untyped-def]
    """Blend a patch into a larger one, in place, uint8; see `put_floats`."""
    taken = 0
    while taken < source.size:
        count = min(length - skip, source.size - taken)
        here, there = target[start + skip : start + skip + count], source[taken : taken + count]
        if before:
            _over_bytes(here, there, here)
        else:
            _over_bytes(here, here, there)
        taken, start, skip = taken + count, start + stride, 0


@_compiled
def put_floats(target, source, before, start, skip, length, stride):  # type: ignore[no-untyped-def]
    """Blend a patch into a larger one, in place, float32.

    Parameters
    ----------
    target, source : flat, C order
    before : whether the source lies in front
    start, skip, length, stride : where the source goes, counted in numbers, four a pixel: run k of `length` begins at
        start + k·stride in the target, the first run leaves out its first `skip`, the last ends where the source ends
    """
    taken = 0
    while taken < source.size:
        count = min(length - skip, source.size - taken)
        here, there = target[start + skip : start + skip + count], source[taken : taken + count]
        if before:
            _over_floats(here, there, here)
        else:
            _over_floats(here, here, there)
        taken, start, skip = taken + count, start + stride, 0
