"""Many layers in one pass, compiled.

A block's sum is kept in float32 in the nearest cache, every layer's share of the block is added behind it, front to
back, and the sum is rounded once into the target. A layer's stretches that are blank are looked at and passed by;
nothing is added behind a block that is opaque.
"""

from __future__ import annotations

from typing import Any

from clusterviz.composite import vector_code
from clusterviz.composite.instructions import alpha, any_set, clear, copy, instruction, number, scratch, set_word, word
from clusterviz.composite.instructions import compiled as _compiled
from clusterviz.composite.job_layout import (
    BYTE,
    COUNT,
    EXTRA,
    FINE,
    FLOAT,
    HALF,
    KIND,
    LAYERS,
    OUT,
    PASSED,
    PIXELS,
    RUN,
    RUN_COUNT,
    STORED,
    TARGET,
    TYPE,
    WISH,
)
from clusterviz.composite.places import block, clip, layer_at, pixel_bytes, settle_all
from clusterviz.composite.vector_code import offset

BLOCK = 512  # pixels; two sums of 8 KiB lie in the nearest cache, beside a block of a layer
_SUM_BYTES = 16  # of a pixel


def _adder(kind: int, pixels: int) -> Any:
    """total = total over source, so many pixels, four at a time."""

    def emit(builder: Any, total: Any, source: Any) -> None:
        for k in range(0, pixels, 4):
            here, there = offset(builder, FLOAT, total, k), offset(builder, kind, source, k)
            front = vector_code.load(builder, FLOAT, here, min(pixels, 4))
            back = vector_code.load(builder, kind, there, min(pixels, 4))
            vector_code.store(builder, FLOAT, here, vector_code.over(builder, front, back))

    return instruction(2, emit)


def _mover(source_kind: int, target_kind: int, pixels: int) -> Any:
    """target = source, so many pixels, four at a time."""

    def emit(builder: Any, target: Any, source: Any) -> None:
        for k in range(0, pixels, 4):
            floats = vector_code.load(builder, source_kind, offset(builder, source_kind, source, k), min(pixels, 4))
            vector_code.store(builder, target_kind, offset(builder, target_kind, target, k), floats)

    return instruction(2, emit)


_MOVES = ((BYTE, FLOAT), (HALF, FLOAT), (FLOAT, BYTE), (FLOAT, HALF))
# 64 bytes of each type, or 16 pixels, and one pixel.
_add_floats, _add_bytes, _add_halves = _adder(FLOAT, 4), _adder(BYTE, 16), _adder(HALF, 8)
_add_float, _add_byte, _add_half = _adder(FLOAT, 1), _adder(BYTE, 1), _adder(HALF, 1)
_read_bytes, _read_halves, _write_bytes, _write_halves = (_mover(*move, 16) for move in _MOVES)
_read_byte, _read_half, _write_byte, _write_half = (_mover(*move, 1) for move in _MOVES)
_scratch = scratch(2 * BLOCK * _SUM_BYTES)


@_compiled
def _blank(source, count, size):  # type: ignore[no-untyped-def]
    """How many of so many pixels can be passed by: stretches of 64 bytes that are zero."""
    i, step = 0, 64 // size
    while i + step <= count and not any_set(source + i * size):
        i += step
    return i


@_compiled
def _add(kind, total, source, count):  # type: ignore[no-untyped-def]
    """total = total over source; a stretch of 64 bytes that is zero adds nothing."""
    i = 0
    if kind == BYTE:
        while i + 16 <= count:
            if any_set(source + 4 * i):
                _add_bytes(total + 16 * i, source + 4 * i)
            i += 16
        while i < count:
            _add_byte(total + 16 * i, source + 4 * i)
            i += 1
    elif kind == HALF:
        while i + 8 <= count:
            if any_set(source + 8 * i):
                _add_halves(total + 16 * i, source + 8 * i)
            i += 8
        while i < count:
            _add_half(total + 16 * i, source + 8 * i)
            i += 1
    else:
        while i + 4 <= count:
            if any_set(source + 16 * i):
                _add_floats(total + 16 * i, source + 16 * i)
            i += 4
        while i < count:
            _add_float(total + 16 * i, source + 16 * i)
            i += 1


@_compiled
def _read(kind, total, source, count):  # type: ignore[no-untyped-def]
    """total = source, as floats."""
    i, whole = 0, count - 15
    if kind == BYTE:
        while i < whole:
            _read_bytes(total + 16 * i, source + 4 * i)
            i += 16
        while i < count:
            _read_byte(total + 16 * i, source + 4 * i)
            i += 1
    elif kind == HALF:
        while i < whole:
            _read_halves(total + 16 * i, source + 8 * i)
            i += 16
        while i < count:
            _read_half(total + 16 * i, source + 8 * i)
            i += 1
    else:
        copy(total, source, 16 * count)


@_compiled
def _write(kind, target, total, count):  # type: ignore[no-untyped-def]
    """target = total, rounded."""
    i, whole = 0, count - 15
    if kind == BYTE:
        while i < whole:
            _write_bytes(target + 4 * i, total + 16 * i)
            i += 16
        while i < count:
            _write_byte(target + 4 * i, total + 16 * i)
            i += 1
    elif kind == HALF:
        while i < whole:
            _write_halves(target + 8 * i, total + 16 * i)
            i += 16
        while i < count:
            _write_half(target + 8 * i, total + 16 * i)
            i += 1
    else:
        copy(target, total, 16 * count)


@_compiled
def _add_sums(total, behind, count):  # type: ignore[no-untyped-def]
    """total = total over behind."""
    i = 0
    while i + 4 <= count:
        _add_floats(total + 16 * i, behind + 16 * i)
        i += 4
    while i < count:
        _add_float(total + 16 * i, behind + 16 * i)
        i += 1


@_compiled
def _opaque(total, count):  # type: ignore[no-untyped-def]
    """Whether nothing behind these pixels can be seen."""
    for i in range(count):  # noqa: SIM110, compiled
        if alpha(total, i) != 1:
            return False
    return True


@_compiled
def _skip_runs(layer, low):  # type: ignore[no-untyped-def]
    """Move a layer's notes to the first run that does not end before its pixel `low`."""
    runs, run, passed = word(layer, EXTRA), word(layer, RUN), word(layer, PASSED)
    while run < word(layer, RUN_COUNT) and number(runs, 2 * run) + number(runs, 2 * run + 1) <= low:
        passed += max(number(runs, 2 * run + 1), 0)
        run += 1
    set_word(layer, RUN, run)
    set_word(layer, PASSED, passed)


@_compiled
def _stretch(layer, low, high):  # type: ignore[no-untyped-def]
    """The first stored pixels of a layer among its own [low, high): where they begin and end, and where they are."""
    if word(layer, RUN_COUNT) < 0:
        return low, high, low
    _skip_runs(layer, low)
    runs, run = word(layer, EXTRA), word(layer, RUN)
    if run >= word(layer, RUN_COUNT):
        return high, high, 0
    first = number(runs, 2 * run)
    begin, end = max(first, low), min(first + number(runs, 2 * run + 1), high)
    source = word(layer, PASSED) + begin - first
    # Runs that claim more pixels than are stored are cut, so nothing else is ever read.
    return begin, min(end, begin + word(layer, STORED) - source), source


@_compiled
def _add_layer(layer, total, x, y, count, touched):  # type: ignore[no-untyped-def]
    """What a layer has of the pixels [x, x + count) of row y; returns whether `total` holds anything now."""
    low, high, begin = clip(layer, x, y, count)
    kind, pixels = word(layer, TYPE), word(layer, PIXELS)
    size, at = pixel_bytes(kind), total + _SUM_BYTES * (begin - low)
    while low < high:
        low, end, source = _stretch(layer, low, high)
        blank = _blank(pixels + source * size, end - low, size)
        low, source = low + blank, source + blank
        if low < end:
            if not touched and end - low == count:
                _read(kind, total, pixels + source * size, count)
            else:
                if not touched:
                    clear(total, count * _SUM_BYTES)
                _add(kind, at + _SUM_BYTES * low, pixels + source * size, end - low)
            touched = True
        low = max(end, low + 1)
    return touched


@_compiled
def _add_group(job, first, last, total, x, y, count):  # type: ignore[no-untyped-def]
    """total = the layers [first, last) over each other; returns whether it holds anything."""
    touched = False
    for index in range(first, last):
        if touched and _opaque(total, count):
            break
        touched = _add_layer(layer_at(job, index), total, x, y, count, touched)
    return touched


@_compiled
def _blend(job, target, total, x, y, count):  # type: ignore[no-untyped-def]
    """One block of the target: front group over back group, rounded."""
    kind, split, behind = word(job, KIND), word(job, WISH), total + BLOCK * _SUM_BYTES
    front = _add_group(job, 0, split, total, x, y, count)
    back = False
    if not front or not _opaque(total, count):
        back = _add_group(job, split, word(job, LAYERS), behind, x, y, count)
    if front and back:
        _add_sums(total, behind, count)
    if front or back:
        _write(kind, target, total if front else behind, count)
    else:
        clear(target, count * pixel_bytes(kind))


def blend_layers(job):  # type: ignore[no-untyped-def]
    """Do a job: every pixel of the target is written; returns as `settle_all` does."""
    fault = settle_all(job)
    if fault != FINE:
        return fault
    total, done = _scratch(), 0
    while done < word(job + 8 * TARGET, COUNT):
        x, y, count = block(job, done, BLOCK)
        _blend(job, word(job, OUT) + done * pixel_bytes(word(job, KIND)), total, x, y, count)
        done += count
    return FINE
