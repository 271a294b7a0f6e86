"""Load of a schedule for sparse images, computed for all ranks at once: `traffic` on arrays.

Ranges of all ranks are placed on one line, rank after rank, so that one sort and one bisection serve all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import Indices, Load, Schedule, count_transfers


@dataclass(frozen=True, eq=False)
class _Held:
    """Patches of all ranks; `line` is the position on the line at which each begins, ascending."""

    line: Indices
    patches: Rectangles

    def find(self, line: Indices) -> Indices:
        """Return the index of the patch at each position on the line."""
        return np.searchsorted(self.line, line, "right") - 1


def count_sparse(schedule: Schedule, footprints: Rectangles) -> Load:
    """Return the load for images with these footprints, by position; bounding rectangles travel, as in the exchange."""
    stride = schedule.pixels + 1
    held = _Held(np.arange(schedule.ranks, dtype=np.int64) * stride, footprints)
    stages, moved = [], []
    for number, stage in enumerate(schedule.stages):
        source, target, begin, end = stage.table.T
        sent = held.patches.take(held.find(source * stride + begin)).cut(begin, end)
        stages.append(np.full(len(stage), number, np.int64))
        moved.append((source, target, sent.count()))
        held = _advance(held, stride, source, target, sent)
    columns = [np.concatenate([np.empty(0, np.int64), *column]) for column in zip(*moved, strict=True)] or [
        np.empty(0, np.int64)
    ] * 3
    return count_transfers(schedule.ranks, np.concatenate([np.empty(0, np.int64), *stages]), *columns)


def _advance(held: _Held, stride: int, source: Indices, target: Indices, sent: Rectangles) -> _Held:
    """Return the patches after a stage: cut at ranges sent and runs of ranges received, and grown by those received."""
    gone, length = np.sort(source * stride + sent.begin), held.patches.end - held.patches.begin
    gone_end = np.sort(source * stride + sent.end)
    coming = target * stride + sent.begin
    cuts = np.unique(np.concatenate([held.line, held.line + length, gone, gone_end, *_runs(coming, sent)]))
    begin, end = cuts[:-1], cuts[1:]
    row = held.find(begin)
    left = np.searchsorted(gone, begin, "right") - 1
    outside = (left < 0) | (begin >= gone_end[np.maximum(left, 0)]) if len(gone) else np.ones(len(begin), bool)
    kept = (begin < (held.line + length)[row]) & outside
    begin, end, row = begin[kept], end[kept], row[kept]
    shift = begin // stride * stride
    grown = _Held(begin, held.patches.take(row).cut(begin - shift, end - shift))
    return _grow(grown, coming, sent)


def _runs(coming: Indices, sent: Rectangles) -> tuple[Indices, Indices]:
    """Return where runs of overlapping or touching received ranges begin and end on the line."""
    order = np.argsort(coming, kind="stable")
    begin, end = coming[order], np.maximum.accumulate((coming + sent.end - sent.begin)[order])
    new = np.ones(len(begin), bool)
    new[1:] = begin[1:] > end[:-1]
    return begin[new], end[np.append(new[1:], True)] if len(end) else end


def _grow(held: _Held, coming: Indices, sent: Rectangles) -> _Held:
    """Return each patch with the union of its rectangle and those received in its range."""
    old, far = held.patches, np.iinfo(np.int64).max
    empty = old.count() == 0
    x_begin, y_begin = np.where(empty, far, old.x_begin), np.where(empty, far, old.y_begin)
    x_end, y_end = old.x_end.copy(), old.y_end.copy()
    full = np.flatnonzero(sent.count() > 0)
    row = held.find(coming[full])
    np.minimum.at(x_begin, row, sent.x_begin[full])
    np.minimum.at(y_begin, row, sent.y_begin[full])
    np.maximum.at(x_end, row, sent.x_end[full])
    np.maximum.at(y_end, row, sent.y_end[full])
    x_begin, y_begin = np.where(x_begin == far, 0, x_begin), np.where(y_begin == far, 0, y_begin)
    united = Rectangles(old.width, old.height, old.begin, old.end, x_begin, y_begin, x_end, y_end)
    return _Held(held.line, united.cut(old.begin, old.end))
