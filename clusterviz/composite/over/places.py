"""Where pixels meet, in compiled code: a job's places and the blocks in which its target is walked.

Where all rows are as wide as the canvas they are laid end to end, and the whole target is one row.
"""

from __future__ import annotations

from clusterviz.composite.over.instructions import compiled, set_word, word
from clusterviz.composite.over.job_layout import (
    ACROSS,
    BYTE,
    COUNT,
    DOWN,
    FINE,
    FIRST,
    FIRST_WRONG,
    HALF,
    HEAD,
    LAYER,
    LAYERS,
    PLACE,
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
    """Bytes of a pixel of a type."""
    return 4 if kind == BYTE else 8 if kind == HALF else 16


@compiled
def layer_at(job, index):  # type: ignore[no-untyped-def]
    """The address of a layer's entry."""
    return job + 8 * (HEAD + LAYER * index)


@compiled
def _before(place, width, number):  # type: ignore[no-untyped-def]
    """How many pixels of a rectangle (corner, width and height) come before a pixel of the canvas."""
    across, down = word(place, ACROSS), word(place, DOWN)
    if width <= 0 or across == 0:
        return 0
    row = number // width
    if row < word(place, Y):
        return 0
    if row >= word(place, Y) + down:
        return across * down
    return (row - word(place, Y)) * across + min(max(number - row * width - word(place, X), 0), across)


@compiled
def _settle(place, width):  # type: ignore[no-untyped-def]
    """Make of a range and the sides of a rectangle what the loops need."""
    across, down = word(place, ACROSS) - word(place, X), word(place, DOWN) - word(place, Y)
    set_word(place, ACROSS, across if across > 0 and down > 0 else 0)
    set_word(place, DOWN, down if across > 0 and down > 0 else 0)
    first, last = _before(place, width, word(place, FIRST)), _before(place, width, word(place, COUNT))
    set_word(place, FIRST, first)
    set_word(place, COUNT, max(0, last - first))


@compiled
def _straighten(place):  # type: ignore[no-untyped-def]
    """Lay the rows of a rectangle as wide as the canvas end to end."""
    across = word(place, ACROSS)
    set_word(place, X, word(place, X) + word(place, Y) * across)
    set_word(place, ACROSS, across * word(place, DOWN))
    set_word(place, Y, 0)
    set_word(place, DOWN, 1)


@compiled
def settle_all(job):  # type: ignore[no-untyped-def]
    """Prepare all places; returns FINE, or which array is not as large as its place, as `job_layout` says."""
    width, target = word(job, WIDTH), job + 8 * TARGET
    _settle(target, width)
    if word(job, SIZE) != word(target, COUNT):
        return FIRST_WRONG
    wide = word(target, ACROSS) == width
    for index in range(word(job, LAYERS)):
        layer = layer_at(job, index)
        place = layer + 8 * PLACE
        _settle(place, width)
        if word(layer, RUN_COUNT) < 0 and word(layer, STORED) != word(place, COUNT):
            return FIRST_WRONG - 1 - index
        wide = wide and (word(place, ACROSS) == width or word(place, COUNT) == 0)
    if wide:
        _straighten(target)
        for index in range(word(job, LAYERS)):
            _straighten(layer_at(job, index) + 8 * PLACE)
    return FINE


@compiled
def block(job, done, limit):  # type: ignore[no-untyped-def]
    """What comes after `done` pixels of the target: x, y, and how many of that row, at most `limit`."""
    place = job + 8 * TARGET
    across, number = word(place, ACROSS), word(place, FIRST) + done
    row = number // across
    column = number - row * across
    length = min(min(across - column, word(place, COUNT) - done), limit)
    return word(place, X) + column, word(place, Y) + row, length


@compiled
def clip(layer, x, y, count):  # type: ignore[no-untyped-def]
    """What a layer has of the pixels [x, x + count) of row y: its own pixels [low, high), and where they begin."""
    place = layer + 8 * PLACE
    row, across = y - word(place, Y), word(place, ACROSS)
    if row < 0 or row >= word(place, DOWN):
        return 0, 0, 0
    left = word(place, X)
    start = row * across - left - word(place, FIRST)
    low = max(max(x, left) + start, 0)
    high = min(min(x + count, left + across) + start, word(place, COUNT))
    return low, high, low - start - x
