"""Compiled geometry of a job: the patches of its target and layers, and blocks of the target.

If all rows are as wide as the canvas they are joined, and the whole target is one row.
"""

from __future__ import annotations

from clusterviz.composite.over.intrinsics import compiled, set_word, word
from clusterviz.composite.over.job import (
    BYTE,
    COLUMNS,
    COUNT,
    FIRST,
    FIRST_BAD,
    GEOMETRY,
    HALF,
    HEAD,
    LAYER,
    LAYERS,
    OK,
    ROWS,
    RUN_COUNT,
    SIZE,
    STORED,
    TARGET,
    WIDTH,
    X,
    Y,
)


@compiled
def pixel_bytes(kind):  # type: ignore[no-untyped-def]
    """Return the bytes of a pixel of a type."""
    return 4 if kind == BYTE else 8 if kind == HALF else 16


@compiled
def layer_at(job, index):  # type: ignore[no-untyped-def]
    """Return the address of a layer's entry."""
    return job + 8 * (HEAD + LAYER * index)


@compiled
def _before(geometry, width, number):  # type: ignore[no-untyped-def]
    """Return the number of pixels of a rectangle (corner, width and height) before a pixel of the canvas."""
    columns, rows = word(geometry, COLUMNS), word(geometry, ROWS)
    if width <= 0 or columns == 0:
        return 0
    row = number // width
    if row < word(geometry, Y):
        return 0
    if row >= word(geometry, Y) + rows:
        return columns * rows
    return (row - word(geometry, Y)) * columns + min(max(number - row * width - word(geometry, X), 0), columns)


@compiled
def _prepare(geometry, width):  # type: ignore[no-untyped-def]
    """Convert a range and the sides of a rectangle to first pixel, number of pixels, corner, width and height."""
    columns, rows = word(geometry, COLUMNS) - word(geometry, X), word(geometry, ROWS) - word(geometry, Y)
    set_word(geometry, COLUMNS, columns if columns > 0 and rows > 0 else 0)
    set_word(geometry, ROWS, rows if columns > 0 and rows > 0 else 0)
    first, last = _before(geometry, width, word(geometry, FIRST)), _before(geometry, width, word(geometry, COUNT))
    set_word(geometry, FIRST, first)
    set_word(geometry, COUNT, max(0, last - first))


@compiled
def _flatten(geometry):  # type: ignore[no-untyped-def]
    """Join the rows of a rectangle that is as wide as the canvas."""
    columns = word(geometry, COLUMNS)
    set_word(geometry, X, word(geometry, X) + word(geometry, Y) * columns)
    set_word(geometry, COLUMNS, columns * word(geometry, ROWS))
    set_word(geometry, Y, 0)
    set_word(geometry, ROWS, 1)


@compiled
def prepare_geometry(job):  # type: ignore[no-untyped-def]
    """Prepare the geometry of all arrays; return OK, or the array whose size does not fit (see FIRST_BAD in `job`)."""
    width, target = word(job, WIDTH), job + 8 * TARGET
    _prepare(target, width)
    if word(job, SIZE) != word(target, COUNT):
        return FIRST_BAD
    wide = word(target, COLUMNS) == width
    for index in range(word(job, LAYERS)):
        layer = layer_at(job, index)
        geometry = layer + 8 * GEOMETRY
        _prepare(geometry, width)
        if word(layer, RUN_COUNT) < 0 and word(layer, STORED) != word(geometry, COUNT):
            return FIRST_BAD - 1 - index
        wide = wide and (word(geometry, COLUMNS) == width or word(geometry, COUNT) == 0)
    if wide:
        _flatten(target)
        for index in range(word(job, LAYERS)):
            _flatten(layer_at(job, index) + 8 * GEOMETRY)
    return OK


@compiled
def block(job, done, limit):  # type: ignore[no-untyped-def]
    """Return x, y and length (in one row, at most `limit`) of the block after `done` pixels of the target."""
    geometry = job + 8 * TARGET
    columns, number = word(geometry, COLUMNS), word(geometry, FIRST) + done
    row = number // columns
    column = number - row * columns
    length = min(min(columns - column, word(geometry, COUNT) - done), limit)
    return word(geometry, X) + column, word(geometry, Y) + row, length


@compiled
def clip(layer, x, y, count):  # type: ignore[no-untyped-def]
    """Return a layer's pixels [low, high) in [x, x + count) of row y, and the offset at which they begin."""
    geometry = layer + 8 * GEOMETRY
    row, columns = y - word(geometry, Y), word(geometry, COLUMNS)
    if row < 0 or row >= word(geometry, ROWS):
        return 0, 0, 0
    left = word(geometry, X)
    start = row * columns - left - word(geometry, FIRST)
    low = max(max(x, left) + start, 0)
    high = min(min(x + count, left + columns) + start, word(geometry, COUNT))
    return low, high, low - start - x
