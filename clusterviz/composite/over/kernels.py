"""Compiled kernels: many layers blended in one pass, and two images, one over the other in place.

Of many layers, the sum of a block of the target is kept in float32 in the L1 cache. All layers are blended behind it,
front to back, and the sum is rounded once into the target. Blank pixels of a layer are skipped, and so are layers
behind an opaque block.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.codec.intrinsics import jit
from clusterviz.composite.over import job as entry
from clusterviz.composite.over import vector_code
from clusterviz.composite.over.geometry import block, clip, layer_at, pixel_bytes, prepare_geometry
from clusterviz.composite.over.intrinsics import (
    PixelLoop,
    alpha,
    any_set,
    choose_loop,
    clear,
    number,
    scratch,
    set_word,
    word,
)
from clusterviz.composite.over.merging_pixels import merge_pixels
from clusterviz.composite.over.vector_code import PIXEL_BYTES, offset

SUM_BYTES = 16  # of a pixel


def _adder(kind: int) -> PixelLoop:
    """Return a loop for total = total over source; blocks of 64 bytes that are zero are skipped."""

    def emit(builder: Any, pixels: int, total: Any, source: Any) -> None:
        if pixels == 1:
            add_some(builder, 1, total, source)
            return
        with builder.if_then(vector_code.any_set(builder, source, 64)):
            for k in range(0, pixels, 4):
                add_some(builder, 4, offset(builder, entry.FLOAT, total, k), offset(builder, kind, source, k))

    def add_some(builder: Any, pixels: int, total: Any, source: Any) -> None:
        front = vector_code.load(builder, entry.FLOAT, total, pixels)
        back = vector_code.load(builder, kind, source, pixels)
        vector_code.store(builder, entry.FLOAT, total, vector_code.over(builder, front, back))

    return PixelLoop((SUM_BYTES, PIXEL_BYTES[kind]), 64 // PIXEL_BYTES[kind], emit)


def _converter(target_kind: int, source_kind: int) -> PixelLoop:

    def emit(builder: Any, pixels: int, target: Any, source: Any) -> None:
        for k in range(0, pixels, 4):
            floats = vector_code.load(builder, source_kind, offset(builder, source_kind, source, k), min(pixels, 4))
            vector_code.store(builder, target_kind, offset(builder, target_kind, target, k), floats)

    return PixelLoop((PIXEL_BYTES[target_kind], PIXEL_BYTES[source_kind]), 16, emit)


# add(kind, total, source, count): blend source behind the sum `total`. read(kind, total, source, count): convert source
# to floats in total. write(kind, target, total, count): round total to pixels in target.
add = choose_loop({kind: _adder(kind) for kind in PIXEL_BYTES})
read = choose_loop({kind: _converter(entry.FLOAT, kind) for kind in PIXEL_BYTES})
write = choose_loop({kind: _converter(kind, entry.FLOAT) for kind in PIXEL_BYTES})


@jit
def blank_pixels(source, count, size):  # type: ignore[no-untyped-def]
    """Return the number of leading pixels in blocks of 64 bytes that are zero."""
    i, step = 0, 64 // size
    while i + step <= count and not any_set(source + i * size):
        i += step
    return i


@jit
def is_opaque(total, count):  # type: ignore[no-untyped-def]
    """Return whether all pixels are opaque."""
    for i in range(count):  # noqa: SIM110, compiled
        if alpha(total, i) != 1:
            return False
    return True


BLOCK = 512  # pixels; two sums of 8 KiB and a block of a layer fit into the L1 cache

_scratch = scratch(2 * BLOCK * SUM_BYTES)


@jit
def _skip_runs(layer, low):  # type: ignore[no-untyped-def]
    """Advance a layer to the first run that does not end before its pixel `low`."""
    runs, run, passed = word(layer, entry.EXTRA), word(layer, entry.RUN), word(layer, entry.PASSED)
    while run < word(layer, entry.RUN_COUNT) and number(runs, 2 * run) + number(runs, 2 * run + 1) <= low:
        passed += max(number(runs, 2 * run + 1), 0)
        run += 1
    set_word(layer, entry.RUN, run)
    set_word(layer, entry.PASSED, passed)


@jit
def _stored_span(layer, low, high):  # type: ignore[no-untyped-def]
    """Return begin and end of a layer's first stored pixels in [low, high), and their index among the stored ones."""
    if word(layer, entry.RUN_COUNT) < 0:
        return low, high, low
    _skip_runs(layer, low)
    runs, run = word(layer, entry.EXTRA), word(layer, entry.RUN)
    if run >= word(layer, entry.RUN_COUNT):
        return high, high, 0
    first = number(runs, 2 * run)
    begin, end = max(first, low), min(first + number(runs, 2 * run + 1), high)
    source = word(layer, entry.PASSED) + begin - first
    # Runs with more pixels than are stored are cut, so nothing else is read.
    return begin, min(end, begin + word(layer, entry.STORED) - source), source


@jit
def _add_layer(operator, layer, total, x, y, count, nonempty):  # type: ignore[no-untyped-def]
    """Blend a layer's pixels [x, x + count) of row y behind `total`; return whether `total` is not empty."""
    low, high, begin = clip(layer, x, y, count)
    kind, pixels = word(layer, entry.TYPE), word(layer, entry.PIXELS)
    size, at = pixel_bytes(kind), total + SUM_BYTES * (begin - low)
    while low < high:
        low, end, source = _stored_span(layer, low, high)
        blank = blank_pixels(pixels + source * size, end - low, size)
        low, source = low + blank, source + blank
        if low < end:
            if not nonempty and end - low == count:
                read(kind, total, pixels + source * size, count)
            else:
                if not nonempty:
                    clear(total, count * SUM_BYTES)
                if operator == entry.OVER:
                    add(kind, at + SUM_BYTES * low, pixels + source * size, end - low)
                else:
                    there = at + SUM_BYTES * low
                    merge_pixels(operator, there, there, pixels + source * size, end - low)
            nonempty = True
        low = max(end, low + 1)
    return nonempty


@jit
def _add_group(job, first, last, total, x, y, count):  # type: ignore[no-untyped-def]
    """Blend the layers [first, last) into `total`; return whether it is not empty."""
    nonempty, operator = False, word(job, entry.OPERATOR)
    for index in range(first, last):
        if nonempty and operator == entry.OVER and is_opaque(total, count):
            break
        nonempty = _add_layer(operator, layer_at(job, index), total, x, y, count, nonempty)
    return nonempty


@jit
def _blend(job, target, total, x, y, count):  # type: ignore[no-untyped-def]
    """Blend one block of the target: front group over back group, rounded."""
    kind, split, operator = word(job, entry.KIND), word(job, entry.MODE), word(job, entry.OPERATOR)
    behind = total + BLOCK * SUM_BYTES
    front = _add_group(job, 0, split, total, x, y, count)
    back = False
    if not front or operator != entry.OVER or not is_opaque(total, count):
        back = _add_group(job, split, word(job, entry.LAYERS), behind, x, y, count)
    if front and back:
        if operator == entry.OVER:
            add(entry.FLOAT, total, behind, count)
        else:
            merge_pixels(operator, total, total, behind, count)
    if front or back:
        write(kind, target, total if front else behind, count)
    else:
        clear(target, count * pixel_bytes(kind))


def blend_layers(job):  # type: ignore[no-untyped-def]
    """Blend all layers of a job into every pixel of the target; return the result of `prepare_geometry`."""
    fault = prepare_geometry(job)
    if fault != entry.OK:
        return fault
    total, done = _scratch(), 0
    while done < word(job + 8 * entry.TARGET, entry.COUNT):
        x, y, count = block(job, done, BLOCK)
        _blend(job, word(job, entry.OUT) + done * pixel_bytes(word(job, entry.KIND)), total, x, y, count)
        done += count
    return entry.OK


def _blender(kind: int) -> PixelLoop:
    """Return a loop for target = front over back; the target may be either of them."""

    def emit(builder: Any, pixels: int, target: Any, front: Any, back: Any) -> None:
        if kind == entry.BYTE:
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
    """Blend one layer into the target; return the result of `prepare_geometry`."""
    fault, done = prepare_geometry(job), 0
    if fault != entry.OK:
        return fault
    kind, mode, operator, layer = (
        word(job, entry.KIND),
        word(job, entry.MODE),
        word(job, entry.OPERATOR),
        layer_at(job, 0),
    )
    size = pixel_bytes(kind)
    while done < word(job + 8 * entry.TARGET, entry.COUNT):
        x, y, count = block(job, done, word(job, entry.SIZE))
        low, high, begin = clip(layer, x, y, count)
        if low < high:
            target, source = word(job, entry.OUT) + (done + begin) * size, word(layer, entry.PIXELS) + low * size
            front, back = target if mode == entry.BEHIND else source, target if mode == entry.BEFORE else source
            if operator == entry.OVER:
                _over(kind, target, front, back, high - low)
            else:
                merge_pixels(operator, target, front, back, high - low)
        done += count
    return entry.OK
