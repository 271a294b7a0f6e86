"""Finding, gathering and scattering the pixels that are not blank, at memory speed; imported only where it is used.

One pass over the pixels makes one bit of each: whether any of its bits is set. All searching is done on those bits, 64
pixels a word, so it costs next to nothing and is the same for all types of pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import uint64
from numba.core import types

from clusterviz.codec.compiled import (
    LONG,
    address,
    clear_bytes,
    compiled,
    copy_bytes,
    high_zeros,
    intrinsic,
    lanes_of,
    low_zeros,
    vector,
)

_ALL = uint64(0xFFFFFFFFFFFFFFFF)


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


@compiled
def find_runs(marks, gap, table):  # type: ignore[no-untyped-def]
    """The runs of pixels that are not blank; blank stretches of at most `gap` pixels stay inside a run.

    Parameters
    ----------
    table : int32 (k, 2), receives [first pixel, length]

    Returns
    -------
    runs, pixels : how many there are, and how many pixels they hold; (-1, 0) where the table is too short
    """
    runs, end, kept = 0, -gap - 1, 0
    for word in range(marks.size):
        left = marks[word]
        while left:
            low = low_zeros(left)
            length = low_zeros(~(left >> uint64(low)))
            begin = 64 * word + low
            if begin - end > gap:
                if runs == len(table):
                    return -1, 0
                table[runs, 0], table[runs, 1] = begin, 0
                end = begin
                runs += 1
            grown = begin + length - end
            table[runs - 1, 1] += grown
            kept += grown
            end = begin + length
            left = left & (_ALL << uint64(low + length)) if low + length < 64 else uint64(0)
    return runs, kept


@compiled
def check_runs(runs, count):  # type: ignore[no-untyped-def]
    """How many pixels the runs hold; -1 unless they are ascending, disjoint, not empty and within `count` pixels."""
    end, kept = 0, 0
    for k in range(len(runs)):
        begin, length = int(runs[k, 0]), int(runs[k, 1])
        if begin < end or length < 1 or begin + length > count:
            return -1
        end = begin + length
        kept += length
    return kept


@compiled
def gather(pixels, runs, pixel_bytes, target):  # type: ignore[no-untyped-def]
    """Copy the pixels of the runs, one run after the other; the runs are known to lie within the pixels."""
    taken = 0
    for k in range(len(runs)):
        size = int(runs[k, 1]) * pixel_bytes
        copy_bytes(target, taken, pixels, int(runs[k, 0]) * pixel_bytes, size)
        taken += size


@compiled
def scatter(packed, runs, pixel_bytes, target):  # type: ignore[no-untyped-def]
    """The inverse of `gather`; what lies in no run is cleared."""
    taken, end = 0, 0
    for k in range(len(runs)):
        begin, size = int(runs[k, 0]) * pixel_bytes, int(runs[k, 1]) * pixel_bytes
        clear_bytes(target, end, begin - end)
        copy_bytes(target, begin, packed, taken, size)
        taken += size
        end = begin + size
    clear_bytes(target, end, target.size - end)


@compiled
def _first(marks, begin, end):  # type: ignore[no-untyped-def]
    """The first pixel of [begin, end) that is not blank; `end` where there is none."""
    word = begin // 64
    left = marks[word] & (_ALL << uint64(begin % 64)) if begin < end else uint64(0)
    while not left and (word + 1) * 64 < end:
        word += 1
        left = marks[word]
    return min(64 * word + low_zeros(left), end) if left else end


@compiled
def _last(marks, begin, end):  # type: ignore[no-untyped-def]
    """The last pixel of [begin, end) that is not blank; `begin` - 1 where there is none."""
    word = (end - 1) // 64
    left = marks[word] & (_ALL >> uint64(63 - (end - 1) % 64)) if begin < end else uint64(0)
    while not left and word * 64 > begin:
        word -= 1
        left = marks[word]
    return max(64 * word + 63 - high_zeros(left), begin - 1) if left else begin - 1


@compiled
def find_box(marks, count, first, width):  # type: ignore[no-untyped-def]
    """The smallest box of pixels that are not blank: top, bottom, left, right; the row of the first pixel is row 0."""
    begin = _first(marks, 0, count)
    if begin == count:
        return 0, 0, 0, 0
    end = _last(marks, 0, count) + 1
    top, bottom = (first + begin) // width, (first + end - 1) // width + 1
    left, right = width, 0
    for row in range(top, bottom):
        start = row * width - first
        # Only columns outside the box so far can change it.
        low, high = max(start, 0), min(start + left, count)
        if low < high:
            left = min(left, _first(marks, low, high) - start)
        low, high = max(start + right, 0), min(start + width, count)
        if low < high:
            right = max(right, _last(marks, low, high) - start + 1)
    return top, bottom, left, right
