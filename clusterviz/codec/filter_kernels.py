"""Compiled loops of the filters: differences, their sums, and byte planes."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.codec.intrinsics import LONG, copy_bytes, define_intrinsic, jit, lane_indices, vector
from clusterviz.codec.kernels import TILE

_BLOCK = 64  # bytes of a vector
_PIXELS = 16  # split at once, so that each plane gets 16 bytes in one store


@jit
def subtract(source, target):  # type: ignore[no-untyped-def]
    """Subtract the number four places before, modulo the range, and fold: 0, −1, 1, −2 … become 0, 1, 2, 3 …

    After folding, small differences of either sign have zeros in their high bytes. The first four numbers stay
    unchanged.

    `source`, `target`: int8, int16 or int32.
    """
    sign = 8 * source.itemsize - 1
    for i in range(min(4, source.size)):
        target[i] = source[i]
    # Slices, because an index that may be negative prevents vectorisation.
    ahead, folded = source[4:], target[4:]
    for i in range(ahead.size):
        difference = source.dtype.type(ahead[i] - source[i])
        folded[i] = (difference << 1) ^ (difference >> sign)


def _sum(bits: int) -> Any:
    """Return a numba intrinsic: unfold a block and add it up onto the four numbers before it, in logarithmic steps."""
    count = 8 * _BLOCK // bits
    block = vector(bits, count)

    def add_block(builder: Any, source: Any, target: Any, index: Any) -> None:
        pointer, into = builder.gep(source, [index]), builder.gep(target, [index])
        folded = builder.load(builder.bitcast(pointer, block.as_pointer()), align=1)
        one = ir.Constant(block, [1] * count)
        sums = builder.xor(builder.lshr(folded, one), builder.neg(builder.and_(folded, one)))
        step = 4
        while step < count:
            # The lanes `step` lower, and zeros (lane `count`) below the first.
            lanes = lane_indices([lane - step if lane >= step else count for lane in range(count)])
            sums = builder.add(sums, builder.shuffle_vector(sums, ir.Constant(block, None), lanes))
            step *= 2
        earlier = builder.gep(into, [ir.Constant(LONG, -4 * bits // 8)])
        carry = builder.load(builder.bitcast(earlier, vector(bits, 4).as_pointer()), align=1)
        carry = builder.shuffle_vector(carry, carry, lane_indices([lane % 4 for lane in range(count)]))
        builder.store(builder.add(sums, carry), builder.bitcast(into, block.as_pointer()), align=1)

    return define_intrinsic(3, add_block)


_sum_8, _sum_16, _sum_32 = _sum(8), _sum(16), _sum(32)


@jit
def add(source, bits, target):  # type: ignore[no-untyped-def]
    """Invert `subtract`, for numbers of 8, 16 or 32 bits in arrays of uint8."""
    four = bits // 2
    for k in range(min(four, source.size)):
        target[k] = source[k]
    whole = four + (source.size - four) // _BLOCK * _BLOCK
    if bits == 8:
        for start in range(four, whole, _BLOCK):
            _sum_8(source, target, start)
    elif bits == 16:
        for start in range(four, whole, _BLOCK):
            _sum_16(source, target, start)
    else:
        for start in range(four, whole, _BLOCK):
            _sum_32(source, target, start)
    # What is left of the last block, number by number.
    size = bits // 8
    for start in range(max(whole, four), source.size, size):
        folded, earlier = 0, 0
        for k in range(size):
            folded |= int(source[start + k]) << 8 * k
            earlier |= int(target[start + k - four]) << 8 * k
        number = earlier + ((folded >> 1) ^ -(folded & 1))
        for k in range(size):
            target[start + k] = number >> 8 * k & 255


def _interleave(builder: Any, parts: list[Any], lane_bytes: int) -> list[Any]:
    """LLVM code that interleaves the lanes of all parts: lane 0 of each part, then lane 1 of each, and so on."""
    if len(parts) == 1:
        return parts
    count = _BLOCK // lane_bytes
    lanes = [lane // 2 + count * (lane % 2) for lane in range(2 * count)]
    wide = [builder.bitcast(part, vector(8 * lane_bytes, count)) for part in parts]
    halves = [
        [builder.shuffle_vector(wide[k], wide[k + 1], lane_indices(some)) for k in range(0, len(wide), 2)]
        for some in (lanes[:count], lanes[count:])
    ]
    return [part for half in halves for part in _interleave(builder, half, 2 * lane_bytes)]


def _split(planes: int) -> Any:
    """Return a numba intrinsic that splits 16 pixels of `planes` bytes into planes."""
    by_plane = lane_indices([lane * planes % _BLOCK + lane * planes // _BLOCK for lane in range(_BLOCK)])
    store_bytes = vector(8, _PIXELS)

    def split(builder: Any, source: Any, start: Any, target: Any, at: Any, stride: Any) -> None:
        parts, first = [], builder.gep(source, [start])
        for k in range(planes * _PIXELS // _BLOCK):
            pointer = builder.gep(first, [ir.Constant(LONG, _BLOCK * k)])
            block = builder.load(builder.bitcast(pointer, vector(8, _BLOCK).as_pointer()), align=1)
            parts.append(builder.shuffle_vector(block, block, by_plane))
        parts = [builder.bitcast(p, vector(8, _BLOCK)) for p in _interleave(builder, parts, _BLOCK // planes)]
        into = builder.gep(target, [at])
        for plane in range(planes):
            lanes = lane_indices([plane % 4 * _PIXELS + lane for lane in range(_PIXELS)])
            some = builder.shuffle_vector(parts[plane // 4], parts[plane // 4], lanes)
            pointer = builder.gep(into, [builder.mul(stride, ir.Constant(LONG, plane))])
            builder.store(some, builder.bitcast(pointer, store_bytes.as_pointer()), align=1)

    return define_intrinsic(5, split)


def _join(planes: int) -> Any:
    """Return a numba intrinsic that joins 64 bytes from `planes` planes."""
    each = _BLOCK // planes

    def join(builder: Any, target: Any, at: Any, source: Any, start: Any, stride: Any) -> None:
        first, parts = builder.gep(source, [start]), []
        for plane in range(planes):
            pointer = builder.gep(first, [builder.mul(stride, ir.Constant(LONG, plane))])
            parts.append(builder.load(builder.bitcast(pointer, vector(8, each).as_pointer()), align=1))
        while len(parts) > 1:
            # Two neighbours form one vector of twice the width.
            both = lane_indices(list(range(2 * parts[0].type.count)))
            parts = [builder.shuffle_vector(parts[k], parts[k + 1], both) for k in range(0, len(parts), 2)]
        lanes = lane_indices([lane % planes * each + lane // planes for lane in range(_BLOCK)])
        into = builder.bitcast(builder.gep(target, [at]), vector(8, _BLOCK).as_pointer())
        builder.store(builder.shuffle_vector(parts[0], parts[0], lanes), into, align=1)

    return define_intrinsic(5, join)


_split_4, _split_8, _split_16 = _split(4), _split(8), _split(16)
_join_4, _join_8, _join_16 = _join(4), _join(8), _join(16)


@jit
def split_planes(source, planes, target, tile):  # type: ignore[no-untyped-def]
    """target[p · n + i] = source[i · planes + p], uint8, for 4, 8 or 16 planes of n bytes.

    The tile, `TILE` bytes a plane in the first-level cache, avoids conflict misses between planes of a power of two
    bytes.
    """
    size = source.size // planes
    whole = size // TILE * TILE
    for first in range(0, whole, TILE):
        for pixel in range(0, TILE, _PIXELS):
            if planes == 4:
                _split_4(source, (first + pixel) * 4, tile, pixel, TILE)
            elif planes == 8:
                _split_8(source, (first + pixel) * 8, tile, pixel, TILE)
            else:
                _split_16(source, (first + pixel) * 16, tile, pixel, TILE)
        for plane in range(planes):
            copy_bytes(target, plane * size + first, tile, plane * TILE, TILE)
    for k in range(whole * planes, source.size):
        target[k % planes * size + k // planes] = source[k]


@jit
def join_planes(source, planes, target, tile):  # type: ignore[no-untyped-def]
    """Invert `split_planes`."""
    size = source.size // planes
    whole = size // TILE * TILE
    for first in range(0, whole, TILE):
        for plane in range(planes):
            copy_bytes(tile, plane * TILE, source, plane * size + first, TILE)
        for start in range(0, TILE * planes, _BLOCK):
            if planes == 4:
                _join_4(target, first * 4 + start, tile, start // 4, TILE)
            elif planes == 8:
                _join_8(target, first * 8 + start, tile, start // 8, TILE)
            else:
                _join_16(target, first * 16 + start, tile, start // 16, TILE)
    for k in range(whole * planes, source.size):
        target[k] = source[k % planes * size + k // planes]
