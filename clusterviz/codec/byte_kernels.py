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
    for i in range(4, source.size):
        target[i] = source[i] - source[i - 4]


@compiled
def add(source, target):  # type: ignore[no-untyped-def]
    """The inverse of `subtract`, for a multiple of four numbers."""
    zero = source.dtype.type(0)
    a = b = c = d = zero
    for i in range(0, source.size, 4):
        a += source[i]
        b += source[i + 1]
        c += source[i + 2]
        d += source[i + 3]
        target[i], target[i + 1], target[i + 2], target[i + 3] = a, b, c, d
