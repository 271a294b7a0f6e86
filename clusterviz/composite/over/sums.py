"""The sums of a block of pixels, compiled: float32, four numbers a pixel, in the nearest cache.

Layers are added behind a sum, and a sum is written as pixels of any type, rounded once.
"""

from __future__ import annotations

from typing import Any

from clusterviz.composite.over import vector_code
from clusterviz.composite.over.instructions import alpha, any_set, compiled, copy, instruction
from clusterviz.composite.over.job_layout import BYTE, FLOAT, HALF
from clusterviz.composite.over.vector_code import offset

SUM_BYTES = 16  # of a pixel


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


@compiled
def blank_pixels(source, count, size):  # type: ignore[no-untyped-def]
    """How many of so many pixels can be passed by: stretches of 64 bytes that are zero."""
    i, step = 0, 64 // size
    while i + step <= count and not any_set(source + i * size):
        i += step
    return i


@compiled
def add(kind, total, source, count):  # type: ignore[no-untyped-def]
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


@compiled
def read(kind, total, source, count):  # type: ignore[no-untyped-def]
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


@compiled
def write(kind, target, total, count):  # type: ignore[no-untyped-def]
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


@compiled
def add_sums(total, behind, count):  # type: ignore[no-untyped-def]
    """total = total over behind."""
    i = 0
    while i + 4 <= count:
        _add_floats(total + 16 * i, behind + 16 * i)
        i += 4
    while i < count:
        _add_float(total + 16 * i, behind + 16 * i)
        i += 1


@compiled
def is_opaque(total, count):  # type: ignore[no-untyped-def]
    """Whether nothing behind these pixels can be seen."""
    for i in range(count):  # noqa: SIM110, compiled
        if alpha(total, i) != 1:
            return False
    return True
