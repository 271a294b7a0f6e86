"""Loads of algorithms on many ranks: closed forms of those whose schedules are too large to count.

Direct send and the parallel pipeline have n² transfers: 4·10⁹ of them for 65,536 ranks. For small numbers of ranks the
tests compare each closed form with the count of the schedule, dense or sparse.

Other algorithms are counted, for sparse images by `count_sparse`: `traffic` on arrays, for all ranks at once. Ranges of
all ranks are placed on one line, rank after rank, so that one sort and one bisection serve all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clusterviz.composite.schedules.direct_send import choose_pieces
from clusterviz.composite.schedules.pipeline import automatic_batches
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import Indices, Load, Schedule, borders, count_transfers, sum_by


def direct_send_dense(ranks: int, pixels: int, owners: int | None = None, bands: int | None = None) -> Load:
    """Return the load of direct send for dense images, which is also that of SLIC."""
    owner, cuts = choose_pieces(ranks, pixels, None, owners, bands)
    own = np.zeros(ranks, np.int64)
    np.add.at(own, owner, np.diff(cuts))
    owns = (own > 0).astype(np.int64)
    moving = ranks > 1
    return Load(
        int(moving and pixels > 0),
        moving * (owns.sum() - owns),
        (ranks - 1) * owns,
        moving * (pixels - own),
        (ranks - 1) * own,
    )


def parallel_pipeline_dense(ranks: int, pixels: int) -> Load:
    """Return the load of the parallel pipeline for dense images.

    A rank sends every piece but its own once; pieces of owners two or more ranks away pass it.
    """
    own = np.diff(borders(ranks, pixels))
    owns = (own > 0).astype(np.int64)
    position = np.arange(ranks, dtype=np.int64)
    full = position[own > 0]
    rounds = int(np.maximum(full, ranks - 1 - full).max(initial=0))
    moving = ranks > 1
    sent = moving * (owns.sum() - owns)
    return Load(rounds, sent, _passing(owns), moving * (pixels - own), _passing(own))


def _passing(own: Indices) -> Indices:
    """Return what each rank receives: its own piece (`own`) from either end of the line, and the pieces that pass."""
    ranks = len(own)
    position = np.arange(ranks)
    before = np.concatenate([[0], np.cumsum(own)])
    passing = before[-1] - before[np.minimum(position + 2, ranks)] + before[np.maximum(position - 1, 0)]
    return np.asarray(passing + own * ((position > 0).astype(np.int64) + (position < ranks - 1)), np.int64)


ROWS_AT_ONCE = 4096


def direct_send_sparse(footprints: Rectangles, owners: int | None = None, bands: int | None = None) -> Load:
    """Return the load of direct send for sparse images, from the rows of each footprint in each piece."""
    ranks, pixels = len(footprints), footprints.canvas_pixels
    owner, cuts = choose_pieces(ranks, pixels, footprints, owners, bands)
    owner, cuts = owner[np.diff(cuts) > 0], np.unique(cuts)
    sent, received = np.zeros(ranks, np.int64), np.zeros(ranks, np.int64)
    total = np.zeros(len(cuts), np.int64)
    for first in range(0, ranks, ROWS_AT_ONCE):
        rank, begin, end = footprints.rows(first, min(first + ROWS_AT_ONCE, ranks))
        pairs = np.unique(_touched(rank, begin, end, cuts, owner, ranks))
        sent += sum_by(ranks, pairs // ranks)
        received += sum_by(ranks, pairs % ranks)
        total += _before(begin, cuts) - _before(end, cuts)
    own = sum_by(ranks, owner, footprints.take(owner).cut(cuts[:-1], cuts[1:]).count())
    sent, received = sent - (own > 0), received - (own > 0)
    return Load(
        int(sent.any()), sent, received, footprints.count() - own, sum_by(ranks, owner, np.diff(total)) - own
    )  # fmt: skip


def _touched(rank: Indices, begin: Indices, end: Indices, cuts: Indices, owner: Indices, ranks: int) -> Indices:
    """Return a number for each pair of a rank and an owner such that a row of the rank's image lies in its piece."""
    first, last = cuts.searchsorted(begin, "right") - 1, cuts.searchsorted(end - 1, "right") - 1
    # A piece that continues from one row into the next was counted before.
    again = (np.diff(rank, prepend=-1) == 0) & (first == np.concatenate([[-1], last[:-1]]))
    first += again
    count = last - first + 1
    piece = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
    return np.asarray(np.repeat(rank, count) * ranks + owner[piece], np.int64)


def _before(numbers: Indices, cuts: Indices) -> Indices:
    """Return for each cut the sum of its distances from all smaller numbers."""
    numbers = np.sort(numbers)
    sums = np.concatenate([[0], np.cumsum(numbers)])
    index = np.searchsorted(numbers, cuts)
    return np.asarray(index * cuts - sums[index], np.int64)


def pipeline_sparse(footprints: Rectangles, batches: int | None = None) -> Load:
    """Return the load of the pipeline for sparse images.

    A batch grows on its way to the front: it has the bounding rectangle of all images behind that touch it.
    """
    ranks, pixels = len(footprints), footprints.canvas_pixels
    batches = automatic_batches(pixels) if batches is None else batches
    cuts, sources = borders(batches, pixels), np.arange(ranks - 1, 0, -1)
    messages, moved = np.zeros(ranks, np.int64), np.zeros(ranks, np.int64)
    busy = np.zeros(ranks + batches, bool)
    for batch in range(batches):
        size = _growing(footprints, sources, cuts[batch], cuts[batch + 1])
        messages[sources] += size > 0
        moved[sources] += size
        busy[batch : batch + len(size)] |= size > 0
    return Load(int(busy.sum()), messages, np.roll(messages, -1), moved, np.roll(moved, -1))


def parallel_pipeline_sparse(footprints: Rectangles) -> Load:
    """Return the load of the parallel pipeline for sparse images.

    A piece grows outwards from its owner on both sides, and is sent back to it from either end of the line. It grows
    only at images that touch it, so the pixels that each rank sends are a sum of steps, one for each such image.
    """
    ranks = len(footprints)
    cuts = borders(ranks, footprints.canvas_pixels)
    start = footprints.y_begin * footprints.width + footprints.x_begin
    stop = (footprints.y_end - 1) * footprints.width + footprints.x_end
    # Rows: messages, pixels. Columns: ranks.
    front, behind, own = (np.zeros((2, ranks), np.int64) for _ in range(3))
    busy = np.zeros(ranks + 1, np.int64)
    for piece in np.flatnonzero(np.diff(cuts)).tolist():
        begin, end = cuts[piece], cuts[piece + 1]
        near = np.flatnonzero((start < end) & (stop > begin))
        before, after = near.searchsorted([piece, piece + 1])
        for sources, steps, last in ((near[:before][::-1], front, 0), (near[after:], behind, ranks - 1)):
            size = _growing(footprints, sources, begin, end)
            sources, size = sources[size > 0], size[size > 0]
            if len(size):
                steps[0, sources[0]] += 1
                steps[1, sources] += np.diff(size, prepend=0)
                own[:, piece] += 1, size[-1]
                busy[abs(sources[0] - piece) - 1] += 1
                busy[abs(last - piece)] -= 1
    front, behind = front[:, ::-1].cumsum(axis=1)[:, ::-1], behind.cumsum(axis=1)
    own[:, :-1] += front[:, 1:]
    own[:, 1:] += behind[:, :-1]
    sent = front + behind
    return Load(int((busy.cumsum() > 0).sum()), sent[0], own[0], sent[1], own[1])


def _growing(footprints: Rectangles, order: Indices, begin: int, end: int) -> Indices:
    """Return the pixels of [begin, end) in the bounding rectangle of the first image, of the first two, and so on."""
    part = footprints.take(order)
    part = part.cut(np.full(len(order), begin), np.full(len(order), end))
    far, empty = np.iinfo(np.int64).max, part.x_end == 0
    x_begin, y_begin = (np.minimum.accumulate(np.where(empty, far, side)) for side in (part.x_begin, part.y_begin))
    x_end, y_end = np.maximum.accumulate(part.x_end), np.maximum.accumulate(part.y_end)
    # Rectangles that are empty so far.
    x_begin, y_begin = np.minimum(x_begin, x_end), np.minimum(y_begin, y_end)
    return Rectangles(part.width, part.height, part.begin, part.end, x_begin, y_begin, x_end, y_end).count()


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
