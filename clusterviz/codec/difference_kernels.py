"""Differences and their sums at memory speed."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types

from clusterviz.codec.compiled import LONG, address, compiled, intrinsic, lanes_of, vector

_BLOCK = 64  # bytes that are added up at once


@compiled
def subtract(source, target):  # type: ignore[no-untyped-def]
    """Differences to the number four places before, modulo their range, folded: 0, −1, 1, −2 … become 0, 1, 2, 3 …

    Folded, small differences of either sign have zeros in their high bytes. The first four stay as they are.

    Parameters
    ----------
    source, target : int8, int16 or int32
    """
    sign = 8 * source.itemsize - 1
    for i in range(min(4, source.size)):
        target[i] = source[i]
    # As slices, since an index that might be negative keeps the loop from becoming vectors.
    ahead, folded = source[4:], target[4:]
    for i in range(ahead.size):
        difference = source.dtype.type(ahead[i] - source[i])
        folded[i] = (difference << 1) ^ (difference >> sign)


def _sum(bits: int) -> Any:
    """A function for numba: unfolds a block and adds it up onto the four numbers before it, in logarithmic steps."""
    count = 8 * _BLOCK // bits
    block = vector(bits, count)

    @intrinsic
    def add_block(typing_context, source, target, index):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            place = address(context, builder, signature.args[0], args[0], args[2])
            into = address(context, builder, signature.args[1], args[1], args[2])
            folded = builder.load(builder.bitcast(place, block.as_pointer()), align=1)
            one = ir.Constant(block, [1] * count)
            sums = builder.xor(builder.lshr(folded, one), builder.neg(builder.and_(folded, one)))
            step = 4
            while step < count:
                # What lies `step` lanes lower, and zeros (lane `count`) below the first.
                lanes = lanes_of([lane - step if lane >= step else count for lane in range(count)])
                sums = builder.add(sums, builder.shuffle_vector(sums, ir.Constant(block, None), lanes))
                step *= 2
            earlier = builder.gep(into, [ir.Constant(LONG, -4 * bits // 8)])
            carry = builder.load(builder.bitcast(earlier, vector(bits, 4).as_pointer()), align=1)
            carry = builder.shuffle_vector(carry, carry, lanes_of([lane % 4 for lane in range(count)]))
            builder.store(builder.add(sums, carry), builder.bitcast(into, block.as_pointer()), align=1)
            return context.get_dummy_value()

        return types.void(source, target, types.int64), generate

    return add_block


_sum_8, _sum_16, _sum_32 = _sum(8), _sum(16), _sum(32)


@compiled
def add(source, bits, target):  # type: ignore[no-untyped-def]
    """The inverse of `subtract`, for numbers of 8, 16 or 32 bits in arrays of uint8."""
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
    size = bits // 8
    for start in range(max(whole, four), source.size, size):
        folded, earlier = 0, 0
        for k in range(size):
            folded |= int(source[start + k]) << 8 * k
            earlier |= int(target[start + k - four]) << 8 * k
        number = earlier + ((folded >> 1) ^ -(folded & 1))
        for k in range(size):
            target[start + k] = number >> 8 * k & 255
