"""Byte planes and differences at memory speed; imported only where they are used."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types

from clusterviz.codec.compiled import LONG, address, compiled, intrinsic, lanes_of, vector

_BLOCK = 64  # bytes that are taken apart at once


def _planes_of(context: Any, builder: Any, signature: Any, args: Any, array: int, at: int, planes: int) -> list[Any]:
    """Where a block's bytes lie in each plane: pointers to vectors of 64 / planes bytes."""
    kind = vector(8, _BLOCK // planes).as_pointer()
    first = address(context, builder, signature.args[array], args[array], args[at])
    steps = [builder.mul(args[at + 1], ir.Constant(LONG, plane)) for plane in range(planes)]
    return [builder.bitcast(builder.gep(first, [step]), kind) for step in steps]


def _split(planes: int) -> Any:
    """A function for numba: takes 64 bytes apart into `planes` planes."""

    @intrinsic
    def split(typing_context, source, start, target, at, stride):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            place = address(context, builder, signature.args[0], args[0], args[1])
            block = builder.load(builder.bitcast(place, vector(8, _BLOCK).as_pointer()), align=1)
            for plane, into in enumerate(_planes_of(context, builder, signature, args, 2, 3, planes)):
                lanes = lanes_of(list(range(plane, _BLOCK, planes)))
                builder.store(builder.shuffle_vector(block, block, lanes), into, align=1)
            return context.get_dummy_value()

        return types.void(source, types.int64, target, types.int64, types.int64), generate

    return split


def _join(planes: int) -> Any:
    """A function for numba: the inverse of `_split`."""

    @intrinsic
    def join(typing_context, target, at, source, start, stride):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            places = _planes_of(context, builder, signature, args, 2, 3, planes)
            parts = [builder.load(place, align=1) for place in places]
            while len(parts) > 1:
                # Two neighbours become one vector twice as wide.
                both = lanes_of(list(range(2 * parts[0].type.count)))
                parts = [builder.shuffle_vector(parts[k], parts[k + 1], both) for k in range(0, len(parts), 2)]
            each = _BLOCK // planes
            lanes = lanes_of([lane % planes * each + lane // planes for lane in range(_BLOCK)])
            place = address(context, builder, signature.args[0], args[0], args[1])
            into = builder.bitcast(place, vector(8, _BLOCK).as_pointer())
            builder.store(builder.shuffle_vector(parts[0], parts[0], lanes), into, align=1)
            return context.get_dummy_value()

        return types.void(target, types.int64, source, types.int64, types.int64), generate

    return join


_split_2, _split_4 = _split(2), _split(4)
_join_2, _join_4 = _join(2), _join(4)


@compiled
def split_planes(source, planes, target):  # type: ignore[no-untyped-def]
    """target[p · n + i] = source[i · planes + p], uint8, for two or four planes of n bytes."""
    size = source.size // planes
    whole = source.size // _BLOCK * _BLOCK
    if planes == 2:
        for start in range(0, whole, _BLOCK):
            _split_2(source, start, target, start // 2, size)
    else:
        for start in range(0, whole, _BLOCK):
            _split_4(source, start, target, start // 4, size)
    for k in range(whole, source.size):
        target[k % planes * size + k // planes] = source[k]


@compiled
def join_planes(source, planes, target):  # type: ignore[no-untyped-def]
    """The inverse of `split_planes`."""
    size = source.size // planes
    whole = source.size // _BLOCK * _BLOCK
    if planes == 2:
        for start in range(0, whole, _BLOCK):
            _join_2(target, start, source, start // 2, size)
    else:
        for start in range(0, whole, _BLOCK):
            _join_4(target, start, source, start // 4, size)
    for k in range(whole, source.size):
        target[k] = source[k % planes * size + k // planes]


@compiled
def subtract(source, target):  # type: ignore[no-untyped-def]
    """Differences to the number four places before, unsigned, modulo their range; the first four as they are."""
    for i in range(min(4, source.size)):
        target[i] = source[i]
    # As slices, since an index that might be negative keeps the loop from becoming vectors.
    ahead, differences = source[4:], target[4:]
    for i in range(ahead.size):
        differences[i] = ahead[i] - source[i]


def _sum(bits: int) -> Any:
    """A function for numba: adds up a block, given the sums of the four numbers before it, in logarithmic steps."""
    count = 8 * _BLOCK // bits
    block = vector(bits, count)

    @intrinsic
    def add_block(typing_context, source, target, index):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            place = address(context, builder, signature.args[0], args[0], args[2])
            into = address(context, builder, signature.args[1], args[1], args[2])
            sums = builder.load(builder.bitcast(place, block.as_pointer()), align=1)
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
        carry = 0
        for k in range(start, start + size):
            carry += int(source[k]) + int(target[k - four])
            target[k] = carry & 255
            carry >>= 8
