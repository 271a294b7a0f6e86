"""Compiled loops of the selections: mask of active pixels, runs and bounding box.

The mask has one bit a pixel. Runs and boxes are found on its words of 64 pixels, at little cost beside the pass that
makes it, and in the same way for all pixel types.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import uint64
from numba.core import types

from clusterviz.codec import intrinsics
from clusterviz.codec.intrinsics import LONG, define_intrinsic, jit, lane_indices, vector

_ALL = uint64(0xFFFFFFFFFFFFFFFF)


def _bits_of_small(builder: Any, pointer: Any, pixel_bytes: int) -> Any:
    """LLVM code for the bits of 64 pixels of four or eight bytes: one comparison of 64 integers."""
    kind = vector(8 * pixel_bytes, 64)
    words = builder.load(builder.bitcast(pointer, kind.as_pointer()), align=1)
    return builder.bitcast(builder.icmp_unsigned("!=", words, ir.Constant(kind, None)), LONG)


def _bits_of_large(builder: Any, pointer: Any) -> Any:
    """LLVM code for the bits of 64 pixels of sixteen bytes, eight at a time, as no CPU compares 128-bit integers."""
    result = ir.Constant(LONG, 0)
    pairs, single = vector(64, 16), vector(64, 8)
    for group in range(8):
        here = builder.gep(pointer, [ir.Constant(LONG, 128 * group)])
        words = builder.load(builder.bitcast(here, pairs.as_pointer()), align=1)
        halves = (builder.shuffle_vector(words, words, lane_indices(list(range(k, 16, 2)))) for k in (0, 1))
        bits = builder.icmp_unsigned("!=", builder.or_(*halves), ir.Constant(single, None))
        byte = builder.zext(builder.bitcast(bits, ir.IntType(8)), LONG)
        result = builder.or_(result, builder.shl(byte, ir.Constant(LONG, 8 * group)))
    return result


# bits(pixels, index): one bit for each of the 64 pixels from byte `index` of an array.
_bits_of_4 = define_intrinsic(2, lambda b, pixels, index: _bits_of_small(b, b.gep(pixels, [index]), 4), types.uint64)
_bits_of_8 = define_intrinsic(2, lambda b, pixels, index: _bits_of_small(b, b.gep(pixels, [index]), 8), types.uint64)
_bits_of_16 = define_intrinsic(2, lambda b, pixels, index: _bits_of_large(b, b.gep(pixels, [index])), types.uint64)


@jit
def make_mask(pixels, pixel_bytes, mask):  # type: ignore[no-untyped-def]
    """Set bit k % 64 of mask[k // 64] if pixel k is not blank.

    Parameters
    ----------
    pixel_bytes : 4, 8 or 16
    mask : uint64 (pixels / 64, rounded up)
    """
    count = pixels.size // pixel_bytes
    whole = count // 64
    if pixel_bytes == 4:
        for word in range(whole):
            mask[word] = _bits_of_4(pixels, word * 256)
    elif pixel_bytes == 8:
        for word in range(whole):
            mask[word] = _bits_of_8(pixels, word * 512)
    else:
        for word in range(whole):
            mask[word] = _bits_of_16(pixels, word * 1024)
    if count > whole * 64:
        last = uint64(0)
        for pixel in range(whole * 64, count):
            for byte in range(pixel * pixel_bytes, (pixel + 1) * pixel_bytes):
                if pixels[byte]:
                    last |= uint64(1) << uint64(pixel % 64)
        mask[whole] = last


@jit
def find_runs(mask, gap, table):  # type: ignore[no-untyped-def]
    """Find the runs of active pixels; a run includes gaps of at most `gap` blank pixels.

    Returns number of runs, and of their pixels; (-1, 0) if the table is too short.

    `table`: int32 (k, 2), receives [first pixel, length].
    """
    runs, end, kept = 0, -gap - 1, 0
    for word in range(mask.size):
        left = mask[word]
        while left:
            low = intrinsics.low_zeros(left)
            length = intrinsics.low_zeros(~(left >> uint64(low)))
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


@jit
def check_runs(runs, count):  # type: ignore[no-untyped-def]
    """Count the pixels of runs; -1 unless they are ascending, disjoint, not empty and within `count` pixels."""
    end, kept = 0, 0
    for k in range(len(runs)):
        begin, length = int(runs[k, 0]), int(runs[k, 1])
        if begin < end or length < 1 or begin + length > count:
            return -1
        end = begin + length
        kept += length
    return kept


@jit
def gather(pixels, runs, pixel_bytes, target):  # type: ignore[no-untyped-def]
    """Copy the pixels of runs, one run after the other; the runs must lie within the pixels."""
    taken = 0
    for k in range(len(runs)):
        size = int(runs[k, 1]) * pixel_bytes
        intrinsics.copy_bytes(target, taken, pixels, int(runs[k, 0]) * pixel_bytes, size)
        taken += size


@jit
def scatter(packed, runs, pixel_bytes, target):  # type: ignore[no-untyped-def]
    """Invert `gather`, and clear the pixels outside of the runs."""
    taken, end = 0, 0
    for k in range(len(runs)):
        begin, size = int(runs[k, 0]) * pixel_bytes, int(runs[k, 1]) * pixel_bytes
        intrinsics.clear_bytes(target, end, begin - end)
        intrinsics.copy_bytes(target, begin, packed, taken, size)
        taken += size
        end = begin + size
    intrinsics.clear_bytes(target, end, target.size - end)


@jit
def _first(mask, begin, end):  # type: ignore[no-untyped-def]
    """Return the first active pixel of [begin, end); `end` if there is none."""
    word = begin // 64
    left = mask[word] & (_ALL << uint64(begin % 64)) if begin < end else uint64(0)
    while not left and (word + 1) * 64 < end:
        word += 1
        left = mask[word]
    return min(64 * word + intrinsics.low_zeros(left), end) if left else end


@jit
def _last(mask, begin, end):  # type: ignore[no-untyped-def]
    """Return the last active pixel of [begin, end); `begin` - 1 if there is none."""
    word = (end - 1) // 64
    left = mask[word] & (_ALL >> uint64(63 - (end - 1) % 64)) if begin < end else uint64(0)
    while not left and word * 64 > begin:
        word -= 1
        left = mask[word]
    return max(64 * word + 63 - intrinsics.high_zeros(left), begin - 1) if left else begin - 1


@jit
def find_box(mask, count, first, width):  # type: ignore[no-untyped-def]
    """Return the bounding box of the active pixels: top, bottom, left, right; the first pixel is in row 0."""
    begin = _first(mask, 0, count)
    if begin == count:
        return 0, 0, 0, 0
    end = _last(mask, 0, count) + 1
    top, bottom = (first + begin) // width, (first + end - 1) // width + 1
    left, right = width, 0
    for row in range(top, bottom):
        start = row * width - first
        # Only columns outside of the current box can extend it.
        low, high = max(start, 0), min(start + left, count)
        if low < high:
            left = min(left, _first(mask, low, high) - start)
        low, high = max(start + right, 0), min(start + width, count)
        if low < high:
            right = max(right, _last(mask, low, high) - start + 1)
    return top, bottom, left, right
