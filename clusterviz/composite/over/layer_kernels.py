"""Many layers in one pass, compiled.

A block's sum is kept in float32 in the nearest cache, every layer's share of the block is added behind it, front to
back, and the sum is rounded once into the target. A layer's stretches that are blank are looked at and passed by;
nothing is added behind a block that is opaque.
"""

from __future__ import annotations

from clusterviz.composite.over.instructions import clear, compiled, number, scratch, set_word, word
from clusterviz.composite.over.job_layout import (
    COUNT,
    EXTRA,
    FINE,
    KIND,
    LAYERS,
    OPERATOR,
    OUT,
    OVER,
    PASSED,
    PIXELS,
    RUN,
    RUN_COUNT,
    STORED,
    TARGET,
    TYPE,
    WISH,
)
from clusterviz.composite.over.merging_pixels import merge_pixels
from clusterviz.composite.over.places import block, clip, layer_at, pixel_bytes, settle_all
from clusterviz.composite.over.sums import SUM_BYTES, add, add_sums, blank_pixels, is_opaque, read, write

BLOCK = 512  # pixels; two sums of 8 KiB lie in the nearest cache, beside a block of a layer

_scratch = scratch(2 * BLOCK * SUM_BYTES)


@compiled
def _skip_runs(layer, low):  # type: ignore[no-untyped-def]
    """Move a layer's notes to the first run that does not end before its pixel `low`."""
    runs, run, passed = word(layer, EXTRA), word(layer, RUN), word(layer, PASSED)
    while run < word(layer, RUN_COUNT) and number(runs, 2 * run) + number(runs, 2 * run + 1) <= low:
        passed += max(number(runs, 2 * run + 1), 0)
        run += 1
    set_word(layer, RUN, run)
    set_word(layer, PASSED, passed)


@compiled
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


@compiled
def _add_layer(operator, layer, total, x, y, count, touched):  # type: ignore[no-untyped-def]
    """What a layer has of the pixels [x, x + count) of row y; returns whether `total` holds anything now."""
    low, high, begin = clip(layer, x, y, count)
    kind, pixels = word(layer, TYPE), word(layer, PIXELS)
    size, at = pixel_bytes(kind), total + SUM_BYTES * (begin - low)
    while low < high:
        low, end, source = _stretch(layer, low, high)
        blank = blank_pixels(pixels + source * size, end - low, size)
        low, source = low + blank, source + blank
        if low < end:
            if not touched and end - low == count:
                read(kind, total, pixels + source * size, count)
            else:
                if not touched:
                    clear(total, count * SUM_BYTES)
                if operator == OVER:
                    add(kind, at + SUM_BYTES * low, pixels + source * size, end - low)
                else:
                    there = at + SUM_BYTES * low
                    merge_pixels(operator, there, there, pixels + source * size, end - low)
            touched = True
        low = max(end, low + 1)
    return touched


@compiled
def _add_group(job, first, last, total, x, y, count):  # type: ignore[no-untyped-def]
    """total = the layers [first, last) over each other; returns whether it holds anything."""
    touched, operator = False, word(job, OPERATOR)
    for index in range(first, last):
        if touched and operator == OVER and is_opaque(total, count):
            break
        touched = _add_layer(operator, layer_at(job, index), total, x, y, count, touched)
    return touched


@compiled
def _blend(job, target, total, x, y, count):  # type: ignore[no-untyped-def]
    """One block of the target: front group over back group, rounded."""
    kind, split, operator = word(job, KIND), word(job, WISH), word(job, OPERATOR)
    behind = total + BLOCK * SUM_BYTES
    front = _add_group(job, 0, split, total, x, y, count)
    back = False
    if not front or operator != OVER or not is_opaque(total, count):
        back = _add_group(job, split, word(job, LAYERS), behind, x, y, count)
    if front and back:
        if operator == OVER:
            add_sums(total, behind, count)
        else:
            merge_pixels(operator, total, total, behind, count)
    if front or back:
        write(kind, target, total if front else behind, count)
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
