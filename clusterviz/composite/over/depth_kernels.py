"""Compiled kernel that keeps the nearest of several layers in each pixel."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.composite.over import vector_code
from clusterviz.composite.over.geometry import block, clip, layer_at, pixel_bytes, prepare_geometry
from clusterviz.composite.over.intrinsics import clear, compiled, define_intrinsic, set_number, word
from clusterviz.composite.over.job import (
    BEFORE,
    BYTE,
    COUNT,
    EXTRA,
    FRESH,
    HALF,
    KIND,
    LAYERS,
    MODE,
    OK,
    OUT,
    OUT_EXTRA,
    PIXELS,
    TARGET,
)

BLOCK = 512  # pixels of the target that stay in the L1 cache, with their depths, for all layers
_INFINITY = 0x7F800000  # as float32


def _depths(builder: Any, address: Any, pixels: int) -> Any:
    return builder.load(vector_code.pointer_to(builder, address, ir.FloatType(), pixels), align=1)


def _stepper(words: int, pixels: int) -> Any:
    """Return a function that writes the nearer of target and source, for `pixels` pixels of `words` 32-bit words."""

    def emit(builder: Any, colour: Any, depth: Any, new_colour: Any, new_depth: Any, or_equal: Any) -> None:
        colours = ir.VectorType(ir.IntType(32), words * pixels)
        depths = tuple(_depths(builder, address, pixels) for address in (depth, new_depth))
        there, here = (builder.inttoptr(address, colours.as_pointer()) for address in (colour, new_colour))
        wins = vector_code.nearer(builder, depths, or_equal, words)
        chosen = builder.select(wins, builder.load(here, align=1), builder.load(there, align=1))
        builder.store(chosen, there, align=1)
        least = builder.select(vector_code.nearer(builder, depths, or_equal, 1), *depths[::-1])
        builder.store(least, vector_code.pointer_to(builder, depth, ir.FloatType(), pixels), align=1)

    return define_intrinsic(5, emit)


_nearest_bytes, _nearest_halves, _nearest_floats = (_stepper(words, 16) for words in (1, 2, 4))
_nearest_byte, _nearest_half, _nearest_float = (_stepper(words, 1) for words in (1, 2, 4))


@compiled
def _nearest(kind, colour, depth, new_colour, new_depth, or_equal, count):  # type: ignore[no-untyped-def]
    """Write colours and depths of the nearer pixels, in place."""
    i = 0
    if kind == BYTE:
        while i < count - 15:
            _nearest_bytes(colour + 4 * i, depth + 4 * i, new_colour + 4 * i, new_depth + 4 * i, or_equal)
            i += 16
        while i < count:
            _nearest_byte(colour + 4 * i, depth + 4 * i, new_colour + 4 * i, new_depth + 4 * i, or_equal)
            i += 1
    elif kind == HALF:
        while i < count - 15:
            _nearest_halves(colour + 8 * i, depth + 4 * i, new_colour + 8 * i, new_depth + 4 * i, or_equal)
            i += 16
        while i < count:
            _nearest_half(colour + 8 * i, depth + 4 * i, new_colour + 8 * i, new_depth + 4 * i, or_equal)
            i += 1
    else:
        while i < count - 15:
            _nearest_floats(colour + 16 * i, depth + 4 * i, new_colour + 16 * i, new_depth + 4 * i, or_equal)
            i += 16
        while i < count:
            _nearest_float(colour + 16 * i, depth + 4 * i, new_colour + 16 * i, new_depth + 4 * i, or_equal)
            i += 1


def put_nearest(job):  # type: ignore[no-untyped-def]
    """Write layers into the target where they are nearer; return the result of `prepare_geometry`."""
    fault, done = prepare_geometry(job), 0
    if fault != OK:
        return fault
    kind, mode = word(job, KIND), word(job, MODE)
    size, or_equal = pixel_bytes(kind), 1 if mode == BEFORE else 0
    while done < word(job + 8 * TARGET, COUNT):
        x, y, count = block(job, done, BLOCK)
        colour, depth = word(job, OUT) + done * size, word(job, OUT_EXTRA) + done * 4
        if mode == FRESH:
            clear(colour, count * size)
            for i in range(count):
                set_number(depth, i, _INFINITY)
        for index in range(word(job, LAYERS)):
            layer = layer_at(job, index)
            low, high, begin = clip(layer, x, y, count)
            if low < high:
                source, far = word(layer, PIXELS) + low * size, word(layer, EXTRA) + low * 4
                _nearest(kind, colour + begin * size, depth + begin * 4, source, far, or_equal, high - low)
        done += count
    return OK
