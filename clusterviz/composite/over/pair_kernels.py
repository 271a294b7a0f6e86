"""Compiled kernels for two images: one over the other in place or out of place, and runs of active pixels."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.composite.over import vector_code
from clusterviz.composite.over.geometry import block, clip, layer_at, pixel_bytes, prepare_geometry
from clusterviz.composite.over.intrinsics import PixelLoop, choose_loop, compiled, copy, number, set_number, word
from clusterviz.composite.over.job import (
    BEFORE,
    BEHIND,
    BYTE,
    COUNT,
    EXTRA,
    INTO,
    KIND,
    MODE,
    OK,
    OPERATOR,
    OUT,
    OUT_EXTRA,
    OVER,
    PIXELS,
    RUN_COUNT,
    SIZE,
    STORED,
    TARGET,
)
from clusterviz.composite.over.merging_pixels import merge_pixels
from clusterviz.composite.over.vector_code import PIXEL_BYTES


def _blender(kind: int) -> PixelLoop:
    """Return a loop for target = front over back; the target may be either of them."""

    def emit(builder: Any, pixels: int, target: Any, front: Any, back: Any) -> None:
        if kind == BYTE:
            vector = ir.VectorType(ir.IntType(8), 4 * pixels)
            there, *seen = (builder.inttoptr(address, vector.as_pointer()) for address in (target, front, back))
            blended = vector_code.over_bytes(builder, *(builder.load(place, align=1) for place in seen))
            builder.store(blended, there, align=1)
        else:
            floats = (vector_code.load(builder, kind, address, pixels) for address in (front, back))
            vector_code.store(builder, kind, target, vector_code.over(builder, *floats))

    size = PIXEL_BYTES[kind]
    return PixelLoop((size, size, size), 64 // size, emit)


# _over(kind, target, front, back, count)
_over = choose_loop({kind: _blender(kind) for kind in PIXEL_BYTES})


def put(job):  # type: ignore[no-untyped-def]
    """Blend one layer into the target, or two of the target's own size; return the result of `prepare_geometry`."""
    fault, done = prepare_geometry(job), 0
    if fault != OK:
        return fault
    kind, mode, operator, layer = word(job, KIND), word(job, MODE), word(job, OPERATOR), layer_at(job, 0)
    size = pixel_bytes(kind)
    while done < word(job + 8 * TARGET, COUNT):
        x, y, count = block(job, done, word(job, SIZE))
        low, high, begin = clip(layer, x, y, count)
        if low < high:
            target, source = word(job, OUT) + (done + begin) * size, word(layer, PIXELS) + low * size
            front, back = target if mode == BEHIND else source, target if mode == BEFORE else source
            if mode == INTO:
                back = word(layer_at(job, 1), PIXELS) + low * size
            if operator == OVER:
                _over(kind, target, front, back, high - low)
            else:
                merge_pixels(operator, target, front, back, high - low)
        done += count
    return OK


@compiled
def _next_run(layer, run, taken):  # type: ignore[no-untyped-def]
    """Return first pixel and number of stored pixels of a layer's run; 0, 0 after the last."""
    if run >= word(layer, RUN_COUNT):
        return 0, 0
    first, length = number(word(layer, EXTRA), 2 * run), number(word(layer, EXTRA), 2 * run + 1)
    return first, max(min(length, word(layer, STORED) - taken), 0)


@compiled
def _grow(runs, count, first, length):  # type: ignore[no-untyped-def]
    """Append pixels to the last run if they follow it, else as a new run; return the number of runs."""
    if count and number(runs, 2 * count - 2) + number(runs, 2 * count - 1) == first:
        set_number(runs, 2 * count - 1, number(runs, 2 * count - 1) + length)
        return count
    set_number(runs, 2 * count, first)
    set_number(runs, 2 * count + 1, length)
    return count + 1


def merge_runs(job):  # type: ignore[no-untyped-def]
    """Blend the active pixels of two layers, the first over the second, into the target; return its number of runs."""
    front, back, target = layer_at(job, 0), layer_at(job, 1), word(job, OUT)
    kind, runs, count = word(job, KIND), word(job, OUT_EXTRA), 0
    size = pixel_bytes(kind)
    f_run, f_taken, f_left, f_at, b_run, b_taken, b_left, b_at = -1, 0, 0, 0, -1, 0, 0, 0
    while True:
        while f_left == 0 and f_run < word(front, RUN_COUNT):
            f_run += 1
            f_at, f_left = _next_run(front, f_run, f_taken)
        while b_left == 0 and b_run < word(back, RUN_COUNT):
            b_run += 1
            b_at, b_left = _next_run(back, b_run, b_taken)
        if f_left == 0 and b_left == 0:
            return count
        f_pixels, b_pixels = word(front, PIXELS) + f_taken * size, word(back, PIXELS) + b_taken * size
        if f_left and (b_left == 0 or f_at < b_at):
            f_step, b_step = min(f_left, b_at - f_at) if b_left else f_left, 0
            copy(target, f_pixels, f_step * size)
        elif b_left and (f_left == 0 or b_at < f_at):
            f_step, b_step = 0, min(b_left, f_at - b_at) if f_left else b_left
            copy(target, b_pixels, b_step * size)
        else:
            f_step = min(f_left, b_left)
            b_step = f_step
            _over(kind, target, f_pixels, b_pixels, f_step)
        count = _grow(runs, count, f_at if f_step else b_at, max(f_step, b_step))
        target += max(f_step, b_step) * size
        f_taken, f_left, f_at = f_taken + f_step, f_left - f_step, f_at + f_step
        b_taken, b_left, b_at = b_taken + b_step, b_left - b_step, b_at + b_step
