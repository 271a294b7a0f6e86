"""Compiled geometry of a job: the patches of its target and layers, and blocks of the target.

If all rows are as wide as the canvas they are joined, and the whole target is one row.
"""

from __future__ import annotations

from clusterviz.codec.intrinsics import jit
from clusterviz.composite.over import job as entry
from clusterviz.composite.over.intrinsics import set_word, word


@jit
def pixel_bytes(kind):  # type: ignore[no-untyped-def]
    """Return the bytes of a pixel of a type."""
    return 4 if kind == entry.BYTE else 8 if kind == entry.HALF else 16


@jit
def layer_at(job, index):  # type: ignore[no-untyped-def]
    """Return the address of a layer's entry."""
    return job + 8 * (entry.HEAD + entry.LAYER * index)


@jit
def _before(geometry, width, number):  # type: ignore[no-untyped-def]
    """Return the number of pixels of a rectangle (corner, width and height) before a pixel of the canvas."""
    columns, rows = word(geometry, entry.COLUMNS), word(geometry, entry.ROWS)
    if width <= 0 or columns == 0:
        return 0
    row = number // width
    if row < word(geometry, entry.Y):
        return 0
    if row >= word(geometry, entry.Y) + rows:
        return columns * rows
    return (row - word(geometry, entry.Y)) * columns + min(
        max(number - row * width - word(geometry, entry.X), 0), columns
    )


@jit
def _prepare(geometry, width):  # type: ignore[no-untyped-def]
    """Convert a range and the sides of a rectangle to first pixel, number of pixels, corner, width and height."""
    columns, rows = (
        word(geometry, entry.COLUMNS) - word(geometry, entry.X),
        word(geometry, entry.ROWS) - word(geometry, entry.Y),
    )
    set_word(geometry, entry.COLUMNS, columns if columns > 0 and rows > 0 else 0)
    set_word(geometry, entry.ROWS, rows if columns > 0 and rows > 0 else 0)
    first, last = (
        _before(geometry, width, word(geometry, entry.FIRST)),
        _before(geometry, width, word(geometry, entry.COUNT)),
    )
    set_word(geometry, entry.FIRST, first)
    set_word(geometry, entry.COUNT, max(0, last - first))


@jit
def _flatten(geometry):  # type: ignore[no-untyped-def]
    """Join the rows of a rectangle that is as wide as the canvas."""
    columns = word(geometry, entry.COLUMNS)
    set_word(geometry, entry.X, word(geometry, entry.X) + word(geometry, entry.Y) * columns)
    set_word(geometry, entry.COLUMNS, columns * word(geometry, entry.ROWS))
    set_word(geometry, entry.Y, 0)
    set_word(geometry, entry.ROWS, 1)


@jit
def prepare_geometry(job):  # type: ignore[no-untyped-def]
    """Prepare the geometry of all arrays; return OK, or the array whose size does not fit (see FIRST_BAD in `job`)."""
    width, target = word(job, entry.WIDTH), job + 8 * entry.TARGET
    _prepare(target, width)
    if word(job, entry.SIZE) != word(target, entry.COUNT):
        return entry.FIRST_BAD
    wide = word(target, entry.COLUMNS) == width
    for index in range(word(job, entry.LAYERS)):
        layer = layer_at(job, index)
        geometry = layer + 8 * entry.GEOMETRY
        _prepare(geometry, width)
        if word(layer, entry.RUN_COUNT) < 0 and word(layer, entry.STORED) != word(geometry, entry.COUNT):
            return entry.FIRST_BAD - 1 - index
        wide = wide and (word(geometry, entry.COLUMNS) == width or word(geometry, entry.COUNT) == 0)
    if wide:
        _flatten(target)
        for index in range(word(job, entry.LAYERS)):
            _flatten(layer_at(job, index) + 8 * entry.GEOMETRY)
    return entry.OK


@jit
def block(job, done, limit):  # type: ignore[no-untyped-def]
    """Return x, y and length (in one row, at most `limit`) of the block after `done` pixels of the target."""
    geometry = job + 8 * entry.TARGET
    columns, number = word(geometry, entry.COLUMNS), word(geometry, entry.FIRST) + done
    row = number // columns
    column = number - row * columns
    length = min(min(columns - column, word(geometry, entry.COUNT) - done), limit)
    return word(geometry, entry.X) + column, word(geometry, entry.Y) + row, length


@jit
def clip(layer, x, y, count):  # type: ignore[no-untyped-def]
    """Return a layer's pixels [low, high) in [x, x + count) of row y, and the offset at which they begin."""
    geometry = layer + 8 * entry.GEOMETRY
    row, columns = y - word(geometry, entry.Y), word(geometry, entry.COLUMNS)
    if row < 0 or row >= word(geometry, entry.ROWS):
        return 0, 0, 0
    left = word(geometry, entry.X)
    start = row * columns - left - word(geometry, entry.FIRST)
    low = max(max(x, left) + start, 0)
    high = min(min(x + count, left + columns) + start, word(geometry, entry.COUNT))
    return low, high, low - start - x
