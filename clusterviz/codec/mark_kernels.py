"""One bit for each pixel: whether it is not blank; at memory speed.

All searching for runs and boxes is done on those bits, 64 pixels a word, so it costs next to nothing beside this pass
over the pixels, and is the same for all types of pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import uint64
from numba.core import types

from clusterviz.codec.compiled import LONG, address, compiled, intrinsic, lanes_of, vector


def _bits_of_small(builder: Any, place: Any, pixel_bytes: int) -> Any:
    """LLVM for the bits of 64 pixels of four or eight bytes: one comparison of as many integers."""
    kind = vector(8 * pixel_bytes, 64)
    words = builder.load(builder.bitcast(place, kind.as_pointer()), align=1)
    return builder.bitcast(builder.icmp_unsigned("!=", words, ir.Constant(kind, None)), LONG)


def _bits_of_large(builder: Any, place: Any) -> Any:
    """LLVM for the bits of 64 pixels of sixteen bytes, eight at a time: no processor compares 128-bit integers."""
    result = ir.Constant(LONG, 0)
    pairs, single = vector(64, 16), vector(64, 8)
    for group in range(8):
        here = builder.gep(place, [ir.Constant(LONG, 128 * group)])
        words = builder.load(builder.bitcast(here, pairs.as_pointer()), align=1)
        halves = (builder.shuffle_vector(words, words, lanes_of(list(range(k, 16, 2)))) for k in (0, 1))
        bits = builder.icmp_unsigned("!=", builder.or_(*halves), ir.Constant(single, None))
        byte = builder.zext(builder.bitcast(bits, ir.IntType(8)), LONG)
        result = builder.or_(result, builder.shl(byte, ir.Constant(LONG, 8 * group)))
    return result


def _bits(make: Callable[[Any, Any], Any]) -> Any:
    """A function for numba: one bit for each of the 64 pixels from byte `index` of an array on."""

    @intrinsic
    def bits(typing_context, pixels, index):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            return make(builder, address(context, builder, signature.args[0], args[0], args[1]))

        return types.uint64(pixels, types.int64), generate

    return bits


_bits_of_4 = _bits(lambda builder, place: _bits_of_small(builder, place, 4))
_bits_of_8 = _bits(lambda builder, place: _bits_of_small(builder, place, 8))
_bits_of_16 = _bits(_bits_of_large)


@compiled
def mark(pixels, pixel_bytes, marks):  # type: ignore[no-untyped-def]
    """Bit k % 64 of marks[k // 64] = whether pixel k is not blank.

    Parameters
    ----------
    pixels : uint8, laid end to end
    pixel_bytes : 4, 8 or 16
    marks : uint64 (pixels / 64, rounded up)
    """
    count = pixels.size // pixel_bytes
    whole = count // 64
    if pixel_bytes == 4:
        for word in range(whole):
            marks[word] = _bits_of_4(pixels, word * 256)
    elif pixel_bytes == 8:
        for word in range(whole):
            marks[word] = _bits_of_8(pixels, word * 512)
    else:
        for word in range(whole):
            marks[word] = _bits_of_16(pixels, word * 1024)
    if count > whole * 64:
        last = uint64(0)
        for pixel in range(whole * 64, count):
            for byte in range(pixel * pixel_bytes, (pixel + 1) * pixel_bytes):
                if pixels[byte]:
                    last |= uint64(1) << uint64(pixel % 64)
        marks[whole] = last
