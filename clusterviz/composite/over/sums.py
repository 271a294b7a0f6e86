"""Compiled sums of a block of pixels: float32, four per pixel, in the L1 cache.

Layers are blended behind a sum, and a sum is rounded once to pixels of any type.
"""

from __future__ import annotations

from typing import Any

from clusterviz.composite.over import vector_code
from clusterviz.composite.over.intrinsics import alpha, any_set, compiled, copy, define_intrinsic
from clusterviz.composite.over.job import BYTE, FLOAT, HALF
from clusterviz.composite.over.vector_code import offset

SUM_BYTES = 16  # of a pixel


def _adder(kind: int, pixels: int) -> Any:
    """Return a function for total = total over source of `pixels` pixels, four at a time."""

    def emit(builder: Any, total: Any, source: Any) -> None:
        for k in range(0, pixels, 4):
            here, there = offset(builder, FLOAT, total, k), offset(builder, kind, source, k)
            front = vector_code.load(builder, FLOAT, here, min(pixels, 4))
            back = vector_code.load(builder, kind, there, min(pixels, 4))
            vector_code.store(builder, FLOAT, here, vector_code.over(builder, front, back))

    return define_intrinsic(2, emit)


def _mover(source_kind: int, target_kind: int, pixels: int) -> Any:
    """Return a function that converts `pixels` pixels from source to target, four at a time."""

    def emit(builder: Any, target: Any, source: Any) -> None:
        for k in range(0, pixels, 4):
            floats = vector_code.load(builder, source_kind, offset(builder, source_kind, source, k), min(pixels, 4))
            vector_code.store(builder, target_kind, offset(builder, target_kind, target, k), floats)

    return define_intrinsic(2, emit)


_MOVES = ((BYTE, FLOAT), (HALF, FLOAT), (FLOAT, BYTE), (FLOAT, HALF))
# Functions for 64 bytes of each type, or 16 pixels, and for one pixel.
_add_floats, _add_bytes, _add_halves = _adder(FLOAT, 4), _adder(BYTE, 16), _adder(HALF, 8)
_add_float, _add_byte, _add_half = _adder(FLOAT, 1), _adder(BYTE, 1), _adder(HALF, 1)
_read_bytes, _read_halves, _write_bytes, _write_halves = (_mover(*move, 16) for move in _MOVES)
_read_byte, _read_half, _write_byte, _write_half = (_mover(*move, 1) for move in _MOVES)


@compiled
def blank_pixels(source, count, size):  # type: ignore[no-untyped-def]
    """Return the number of leading pixels in blocks of 64 bytes that are zero."""
    i, step = 0, 64 // size
    while i + step <= count and not any_set(source + i * size):
        i += step
    return i


@compiled
def add(kind, total, source, count):  # type: ignore[no-untyped-def]
    """Blend source behind total; blocks of 64 bytes that are zero are skipped."""
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
    """Convert source to floats in total."""
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
    """Round total to pixels in target."""
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
    """Blend the sum `behind` behind total."""
    i = 0
    while i + 4 <= count:
        _add_floats(total + 16 * i, behind + 16 * i)
        i += 4
    while i < count:
        _add_float(total + 16 * i, behind + 16 * i)
        i += 1


@compiled
def is_opaque(total, count):  # type: ignore[no-untyped-def]
    """Return whether all pixels are opaque."""
    for i in range(count):  # noqa: SIM110, compiled
        if alpha(total, i) != 1:
            return False
    return True
