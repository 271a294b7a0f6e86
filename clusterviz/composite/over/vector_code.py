"""LLVM code for vectors of pixels: loading any type as floats, the over operator, storing.

numba does not vectorize these loops for floats, and for bytes takes twice as long as the memory transfer. Each function
emits code for several pixels of four floats; LLVM splits the vectors for CPUs with narrower registers. Addresses need
not be aligned. Products and sums are rounded separately, never fused, as in NumPy and the same on every CPU.

float16 is converted by the CPU if it can, else by integer arithmetic [1]_; both round to nearest, ties to even.

References
----------
.. [1] F. Giesen, "Half to float done quick" and float_to_half_fast3_rtne, https://gist.github.com/rygorous/2156668.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils

from clusterviz.composite.over.job import BYTE, FLOAT, HALF
from clusterviz.kernels.objects import has_features

PIXEL_BYTES = {FLOAT: 16, BYTE: 4, HALF: 8}

# numba's functions have no type annotations.
_function: Callable[..., Any] = cgutils.get_or_insert_function

# Without f16c LLVM calls a function of the compiler's runtime library, which is not linked.
HALVES_IN_HARDWARE = has_features("f16c")

_HALF = ir.HalfType()
_FLOAT, _I8, _I16, _I32, _I64 = ir.FloatType(), ir.IntType(8), ir.IntType(16), ir.IntType(32), ir.IntType(64)


def splat(element: Any, value: float, lanes: int) -> Any:
    """Return a constant vector of equal lanes."""
    return ir.Constant(ir.VectorType(element, lanes), [value] * lanes)


def pointer_to(builder: Any, address: Any, element: Any, lanes: int) -> Any:
    """Return the pointer to a vector at an address."""
    return builder.inttoptr(address, ir.VectorType(element, lanes).as_pointer())


def offset(builder: Any, kind: int, address: Any, pixels: int) -> Any:
    """Return the address `pixels` pixels further on."""
    return builder.add(address, ir.Constant(_I64, PIXEL_BYTES[kind] * pixels)) if pixels else address


def load(builder: Any, kind: int, address: Any, pixels: int) -> Any:
    """Load pixels at an address as floats with full scale 1: float (4·pixels)."""
    lanes = 4 * pixels
    floats = ir.VectorType(_FLOAT, lanes)
    if kind == FLOAT:
        return builder.load(pointer_to(builder, address, _FLOAT, lanes), align=1)
    if kind == BYTE:
        levels = builder.load(pointer_to(builder, address, _I8, lanes), align=1)
        levels = builder.zext(levels, ir.VectorType(_I32, lanes))
        # The product with 1/255 is at most one unit in the last place off, and exact for 0 and 255.
        return builder.fmul(builder.sitofp(levels, floats), splat(_FLOAT, 1 / 255, lanes))
    if HALVES_IN_HARDWARE:
        return builder.fpext(builder.load(pointer_to(builder, address, _HALF, lanes), align=1), floats)
    words = builder.load(pointer_to(builder, address, _I16, lanes), align=1)
    return _float_of_half(builder, builder.zext(words, ir.VectorType(_I32, lanes)), lanes)


def store(builder: Any, kind: int, address: Any, floats: Any) -> None:
    """Store floats as pixels at an address, rounded to nearest; bytes are clamped to 0…255."""
    lanes = floats.type.count
    if kind == FLOAT:
        builder.store(floats, pointer_to(builder, address, _FLOAT, lanes), align=1)
    elif kind == BYTE:
        zero, top, half = (splat(_FLOAT, value, lanes) for value in (0.0, 255.5, 0.5))
        levels = builder.fadd(builder.fmul(floats, splat(_FLOAT, 255.0, lanes)), half)
        levels = builder.select(builder.fcmp_ordered(">", levels, zero), levels, zero)
        levels = builder.select(builder.fcmp_ordered("<", levels, top), levels, top)
        levels = builder.fptosi(levels, ir.VectorType(_I32, lanes))
        levels = builder.trunc(levels, ir.VectorType(_I8, lanes))
        builder.store(levels, pointer_to(builder, address, _I8, lanes), align=1)
    elif HALVES_IN_HARDWARE:
        halves = builder.fptrunc(floats, ir.VectorType(_HALF, lanes))
        builder.store(halves, pointer_to(builder, address, _HALF, lanes), align=1)
    else:
        words = builder.trunc(_half_of_float(builder, floats), ir.VectorType(_I16, lanes))
        builder.store(words, pointer_to(builder, address, _I16, lanes), align=1)


def over(builder: Any, front: Any, back: Any) -> Any:
    """Return front + (1 − its alpha) · back, in floats."""
    lanes = front.type.count
    alphas = ir.Constant(ir.VectorType(_I32, lanes), [lane // 4 * 4 + 3 for lane in range(lanes)])
    alpha = builder.shuffle_vector(front, front, alphas)
    rest = builder.fsub(splat(_FLOAT, 1.0, lanes), alpha)
    return builder.fadd(front, builder.fmul(rest, back))


def over_bytes(builder: Any, front: Any, back: Any) -> Any:
    """Return front over back for bytes, (4·pixels) uint8, rounded to nearest.

    A product of two bytes is at most 65,025. Its division by 255 rounded to nearest, (x + 128 + ((x + 128) >> 8)) >> 8,
    needs 16 bits, so even and odd bytes are computed in 16-bit lanes. The sum saturates at 255: a colour that was
    rounded up past its alpha may exceed it by one.
    """
    bytes_ = front.type.count
    words = ir.VectorType(_I16, bytes_ // 2)
    # 255 − alpha of the pixel, in each 16-bit lane: byte 3 of four below, and a zero (from the second vector) above.
    lanes = [lane // 4 * 4 + 3 if lane % 2 == 0 else bytes_ for lane in range(bytes_)]
    zero = splat(_I8, 0, bytes_)
    rest = builder.shuffle_vector(builder.not_(front), zero, ir.Constant(ir.VectorType(_I32, bytes_), lanes))
    rest = builder.bitcast(rest, words)
    half, eight, low = (splat(_I16, value, bytes_ // 2) for value in (128, 8, 255))

    def weigh(channel: Any) -> Any:
        product = builder.add(builder.mul(channel, rest), half)
        return builder.lshr(builder.add(product, builder.lshr(product, eight)), eight)

    pairs = builder.bitcast(back, words)
    even, odd = weigh(builder.and_(pairs, low)), weigh(builder.lshr(pairs, eight))
    seen = builder.bitcast(builder.or_(even, builder.shl(odd, eight)), front.type)
    kind = ir.FunctionType(front.type, [front.type, front.type])
    add = _function(builder.module, kind, f"llvm.uadd.sat.v{bytes_}i8")
    return builder.call(add, [front, seen])


def any_set(builder: Any, address: Any, bytes_: int) -> Any:
    """Return whether any bit is set in `bytes_` bytes."""
    seen = builder.load(pointer_to(builder, address, _I8, bytes_), align=1)
    differ = builder.icmp_unsigned("!=", seen, splat(_I8, 0, bytes_))
    mask = builder.bitcast(differ, ir.IntType(bytes_))
    return builder.icmp_unsigned("!=", mask, ir.Constant(ir.IntType(bytes_), 0))


def _float_of_half(builder: Any, words: Any, lanes: int) -> Any:
    """Convert half floats in the low bits of 32-bit lanes to floats."""
    wide = ir.VectorType(_FLOAT, lanes)
    size = builder.shl(builder.and_(words, splat(_I32, 0x7FFF, lanes)), splat(_I32, 13, lanes))
    sign = builder.shl(builder.and_(words, splat(_I32, 0x8000, lanes)), splat(_I32, 16, lanes))
    # A half's exponent is 112 less than a float's; the product also makes normal numbers of subnormal ones.
    scaled = builder.fmul(builder.bitcast(size, wide), splat(_FLOAT, 2.0**112, lanes))
    bits = builder.bitcast(scaled, words.type)
    special = builder.icmp_unsigned(">=", size, splat(_I32, 0x7C00 << 13, lanes))
    bits = builder.or_(bits, builder.select(special, splat(_I32, 0xFF << 23, lanes), splat(_I32, 0, lanes)))
    return builder.bitcast(builder.or_(bits, sign), wide)


def _half_of_float(builder: Any, floats: Any) -> Any:
    """Convert floats to half floats in the low bits of 32-bit lanes, rounded to nearest, ties to even."""
    lanes = floats.type.count
    words = ir.VectorType(_I32, lanes)
    bits = builder.bitcast(floats, words)
    sign = builder.and_(bits, splat(_I32, 0x80000000, lanes))
    size = builder.xor(bits, sign)
    # Normal: the exponent moved by 112, and half a unit added, less a bit where the last bit kept is even.
    odd = builder.and_(builder.lshr(size, splat(_I32, 13, lanes)), splat(_I32, 1, lanes))
    normal = builder.add(builder.add(size, splat(_I32, (0xFFF - (112 << 23)) & 0xFFFFFFFF, lanes)), odd)
    normal = builder.lshr(normal, splat(_I32, 13, lanes))
    # Subnormal: adding 1/2 leaves a half's mantissa in the lowest bits, and the addition rounds.
    shifted = builder.fadd(builder.bitcast(size, floats.type), splat(_FLOAT, 0.5, lanes))
    subnormal = builder.sub(builder.bitcast(shifted, words), splat(_I32, 126 << 23, lanes))
    is_nan = builder.icmp_unsigned(">", size, splat(_I32, 0xFF << 23, lanes))
    special = builder.select(is_nan, splat(_I32, 0x7E00, lanes), splat(_I32, 0x7C00, lanes))
    small = builder.icmp_unsigned("<", size, splat(_I32, 113 << 23, lanes))
    large = builder.icmp_unsigned(">=", size, splat(_I32, 143 << 23, lanes))
    result = builder.select(large, special, builder.select(small, subnormal, normal))
    return builder.or_(result, builder.lshr(sign, splat(_I32, 16, lanes)))
