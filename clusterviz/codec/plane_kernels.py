"""Byte planes at memory speed: vectors whose bytes are rearranged in registers."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types

from clusterviz.codec.compiled import LONG, address, compiled, copy_bytes, intrinsic, lanes_of, vector

_BLOCK = 64  # bytes of a vector
_PIXELS = 16  # that are taken apart at once, so that each plane gets 16 bytes in one store
_TILE = 256  # pixels


def _interleave(builder: Any, parts: list[Any], lane_bytes: int) -> list[Any]:
    """LLVM that brings equal lanes of all parts together: lane 0 of each part, then lane 1 of each, and so on."""
    if len(parts) == 1:
        return parts
    count = _BLOCK // lane_bytes
    lanes = [lane // 2 + count * (lane % 2) for lane in range(2 * count)]
    wide = [builder.bitcast(part, vector(8 * lane_bytes, count)) for part in parts]
    halves = [
        [builder.shuffle_vector(wide[k], wide[k + 1], lanes_of(some)) for k in range(0, len(wide), 2)]
        for some in (lanes[:count], lanes[count:])
    ]
    return [part for half in halves for part in _interleave(builder, half, 2 * lane_bytes)]


def _split(planes: int) -> Any:
    """A function for numba: takes 16 pixels of `planes` bytes apart."""
    by_plane = lanes_of([lane * planes % _BLOCK + lane * planes // _BLOCK for lane in range(_BLOCK)])
    store_bytes = vector(8, _PIXELS)

    @intrinsic
    def split(typing_context, source, start, target, at, stride):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            parts = []
            for k in range(planes * _PIXELS // _BLOCK):
                place = address(context, builder, signature.args[0], args[0], args[1])
                place = builder.gep(place, [ir.Constant(LONG, _BLOCK * k)])
                block = builder.load(builder.bitcast(place, vector(8, _BLOCK).as_pointer()), align=1)
                parts.append(builder.shuffle_vector(block, block, by_plane))
            parts = [builder.bitcast(p, vector(8, _BLOCK)) for p in _interleave(builder, parts, _BLOCK // planes)]
            into = address(context, builder, signature.args[2], args[2], args[3])
            for plane in range(planes):
                lanes = lanes_of([plane % 4 * _PIXELS + lane for lane in range(_PIXELS)])
                some = builder.shuffle_vector(parts[plane // 4], parts[plane // 4], lanes)
                place = builder.gep(into, [builder.mul(args[4], ir.Constant(LONG, plane))])
                builder.store(some, builder.bitcast(place, store_bytes.as_pointer()), align=1)
            return context.get_dummy_value()

        return types.void(source, types.int64, target, types.int64, types.int64), generate

    return split


def _join(planes: int) -> Any:
    """A function for numba: puts 64 bytes together from `planes` planes."""
    each = _BLOCK // planes

    @intrinsic
    def join(typing_context, target, at, source, start, stride):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            first = address(context, builder, signature.args[2], args[2], args[3])
            parts = []
            for plane in range(planes):
                place = builder.gep(first, [builder.mul(args[4], ir.Constant(LONG, plane))])
                parts.append(builder.load(builder.bitcast(place, vector(8, each).as_pointer()), align=1))
            while len(parts) > 1:
                # Two neighbours become one vector twice as wide.
                both = lanes_of(list(range(2 * parts[0].type.count)))
                parts = [builder.shuffle_vector(parts[k], parts[k + 1], both) for k in range(0, len(parts), 2)]
            lanes = lanes_of([lane % planes * each + lane // planes for lane in range(_BLOCK)])
            place = address(context, builder, signature.args[0], args[0], args[1])
            into = builder.bitcast(place, vector(8, _BLOCK).as_pointer())
            builder.store(builder.shuffle_vector(parts[0], parts[0], lanes), into, align=1)
            return context.get_dummy_value()

        return types.void(target, types.int64, source, types.int64, types.int64), generate

    return join


_split_4, _split_8, _split_16 = _split(4), _split(8), _split(16)
_join_4, _join_8, _join_16 = _join(4), _join(8), _join(16)


@compiled
def split_planes(source, planes, target):  # type: ignore[no-untyped-def]
    """target[p · n + i] = source[i · planes + p], uint8, for 4, 8 or 16 planes of n bytes.

    Through a tile that stays in the first cache: planes of a power of two bytes would push each other out of it.
    """
    size = source.size // planes
    whole = size // _TILE * _TILE
    tile = np.empty(_TILE * planes, np.uint8)
    for first in range(0, whole, _TILE):
        for pixel in range(0, _TILE, _PIXELS):
            if planes == 4:
                _split_4(source, (first + pixel) * 4, tile, pixel, _TILE)
            elif planes == 8:
                _split_8(source, (first + pixel) * 8, tile, pixel, _TILE)
            else:
                _split_16(source, (first + pixel) * 16, tile, pixel, _TILE)
        for plane in range(planes):
            copy_bytes(target, plane * size + first, tile, plane * _TILE, _TILE)
    for k in range(whole * planes, source.size):
        target[k % planes * size + k // planes] = source[k]


@compiled
def join_planes(source, planes, target):  # type: ignore[no-untyped-def]
    """The inverse of `split_planes`."""
    size = source.size // planes
    whole = size // _TILE * _TILE
    tile = np.empty(_TILE * planes, np.uint8)
    for first in range(0, whole, _TILE):
        for plane in range(planes):
            copy_bytes(tile, plane * _TILE, source, plane * size + first, _TILE)
        for start in range(0, _TILE * planes, _BLOCK):
            if planes == 4:
                _join_4(target, first * 4 + start, tile, start // 4, _TILE)
            elif planes == 8:
                _join_8(target, first * 8 + start, tile, start // 8, _TILE)
            else:
                _join_16(target, first * 16 + start, tile, start // 16, _TILE)
    for k in range(whole * planes, source.size):
        target[k] = source[k % planes * size + k // planes]
