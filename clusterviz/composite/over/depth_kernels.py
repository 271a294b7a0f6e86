"""Compiled kernel that keeps the nearer of two images in each pixel."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.composite.over import vector_code
from clusterviz.composite.over.geometry import block, clip, layer_at, pixel_bytes, prepare_geometry
from clusterviz.composite.over.intrinsics import PixelLoop, choose_loop, word
from clusterviz.composite.over.job import (
    BEFORE,
    COUNT,
    EXTRA,
    KIND,
    MODE,
    OK,
    OUT,
    OUT_EXTRA,
    PIXELS,
    TARGET,
)

BLOCK = 512  # pixels of a row, at most, at a time


def _depths(builder: Any, address: Any, pixels: int) -> Any:
    return builder.load(vector_code.pointer_to(builder, address, ir.FloatType(), pixels), align=1)


def _chooser(size: int) -> PixelLoop:
    """Return a loop that writes colours of `size` bytes, and depths, where they are nearer than those of the target."""

    def emit(builder: Any, pixels: int, colour: Any, depth: Any, *given: Any) -> None:
        new_colour, new_depth, or_equal = given
        words = size // 4
        colours = ir.VectorType(ir.IntType(32), words * pixels)
        depths = tuple(_depths(builder, address, pixels) for address in (depth, new_depth))
        there, here = (builder.inttoptr(address, colours.as_pointer()) for address in (colour, new_colour))
        wins = vector_code.nearer(builder, depths, or_equal, words)
        chosen = builder.select(wins, builder.load(here, align=1), builder.load(there, align=1))
        builder.store(chosen, there, align=1)
        least = builder.select(vector_code.nearer(builder, depths, or_equal, 1), *depths[::-1])
        builder.store(least, vector_code.pointer_to(builder, depth, ir.FloatType(), pixels), align=1)

    return PixelLoop((size, 4, size, 4, 0), 16, emit)


# _nearest(kind, colour, depth, new_colour, new_depth, or_equal, count)
_nearest = choose_loop({kind: _chooser(size) for kind, size in vector_code.PIXEL_BYTES.items()})


def put_nearest(job):  # type: ignore[no-untyped-def]
    """Write a layer into the target where it is nearer; return the result of `prepare_geometry`."""
    fault, done = prepare_geometry(job), 0
    if fault != OK:
        return fault
    kind, layer = word(job, KIND), layer_at(job, 0)
    size, or_equal = pixel_bytes(kind), 1 if word(job, MODE) == BEFORE else 0
    while done < word(job + 8 * TARGET, COUNT):
        x, y, count = block(job, done, BLOCK)
        colour, depth = word(job, OUT) + done * size, word(job, OUT_EXTRA) + done * 4
        low, high, begin = clip(layer, x, y, count)
        if low < high:
            source, far = word(layer, PIXELS) + low * size, word(layer, EXTRA) + low * 4
            _nearest(kind, colour + begin * size, depth + begin * 4, source, far, or_equal, high - low)
        done += count
    return OK
