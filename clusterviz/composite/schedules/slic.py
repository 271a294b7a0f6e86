"""SLIC: spans that several images cover are assigned to ranks that cover them; all other pixels stay where they are.

What: the rows of the picture are cut into spans where the set of images that cover them changes. A span that one rank
covers alone is never sent. Others are assigned to one of their contributors. Blocks of rows with equal spans are
assigned by decreasing work, each to the contributor with the least work.
When: sparse images of compact bricks on up to some tens of ranks: only pixels that are merged move.
When not: dense images, where it is direct send; many ranks: each short span of a row is a transfer of its own, 10⁵ on
64 ranks with cubes at 2048×2048.
Cost: 1 round; a message for each pair of ranks that share a span, n(n − 1) at most; Σ (k_s − 1)·len_s pixels over spans
of k_s contributors.
Limits: any number of partial images a rank, in any order of depth. A rank with several images in a span is one
contributor.
Reference: A. Stompel et al., "SLIC: scheduled linear image compositing for parallel volume rendering", PVG 2003.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import Indices, Patches, Schedule, Stage

SEVERAL_IMAGES = True


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of vertically adjacent spans that the same ranks (two or more) cover."""

    # int64 (cells,), rectangle of each cell
    left: Indices
    right: Indices
    top: Indices
    bottom: Indices
    layers: Indices  # int64 (cells,), number of images that cover it
    first: Indices  # int64 (cells + 1,), index of its first rank in `members`
    members: Indices  # ranks that have images in each cell, ascending


def schedule(ranks: int, pixels: int, footprints: Patches = (), *, owners_of: Sequence[int] | None = None) -> Schedule:
    """Return the schedule: blocks of cells, assigned by decreasing work.

    `footprints`: patch of each image; without them the canvas is one row that all of them cover. `owners_of`: rank of
    each image, if ranks have several; by default, rank k has image k.
    """
    known = Rectangles.of_patches(footprints) if footprints else _lines(ranks, pixels)
    table, rows = assign_blocks(ranks, known, owners_of)
    if len(table) == 0:
        return Schedule(ranks, pixels, ())
    # Each block is its first row, and the same again a canvas width further on for each of the others.
    step = np.arange(rows.sum()) - np.repeat(rows.cumsum() - rows, rows)
    step *= known.width
    table = table.repeat(rows, axis=0)
    table[:, 2] += step
    table[:, 3] += step
    return Schedule(ranks, pixels, (Stage.of_table(table),))


def assign_blocks(
    ranks: int, footprints: Rectangles, owners_of: Sequence[int] | None = None
) -> tuple[Indices, Indices]:
    """Assign the blocks of all cells to ranks.

    Returns `table`, int64 (transfers, 4), source, target, and begin and end of the first row of a block; `rows`, int64
    (transfers,), number of rows of the block, at least one.
    """
    owner = np.arange(ranks, dtype=np.int64) if owners_of is None else np.asarray(owners_of, np.int64)
    cells, width = find_cells(footprints, owner), footprints.width
    # Spans as wide as the canvas are one, and can be cut anywhere; others between rows.
    wide, rows = cells.right - cells.left == width, cells.bottom - cells.top
    unit, length = np.where(wide, 1, cells.right - cells.left), np.where(wide, rows * width, rows)
    share, merges = np.diff(cells.first), unit * (cells.layers - 1)
    blocks = np.minimum(share, length)
    cell, block = _ranges(np.zeros_like(blocks), blocks)
    begin, end = (number * length[cell] // blocks[cell] for number in (block, block + 1))
    target = _assign(ranks, cells, blocks, np.argsort(-merges * length, kind="stable"), (end - begin) * merges[cell])
    # Each block comes from every member of its cell but the one that gets it.
    pair, member = _ranges(cells.first[cell], cells.first[cell + 1])
    kept = cells.members[member] != target[pair]
    pair, source = pair[kept], cells.members[member[kept]]
    start = cells.top[cell] * width + np.where(wide[cell], begin, begin * width + cells.left[cell])
    stop = start + np.where(wide[cell], end - begin, unit[cell])
    table = np.stack([source, target[pair], start[pair], stop[pair]], axis=1)
    return table, np.where(wide[cell], 1, end - begin)[pair]


def _assign(ranks: int, cells: Cells, blocks: Indices, order: Indices, merges: Indices) -> Indices:
    """Return the rank of each block: the contributor with the least work so far; `merges` is the work of each block."""
    load, target = [0] * ranks, [0] * len(merges)
    first, members, work = cells.first.tolist(), cells.members.tolist(), merges.tolist()
    ends = blocks.cumsum().tolist()
    for cell in order.tolist():
        ready = sorted(members[first[cell] : first[cell + 1]], key=load.__getitem__)
        begin = ends[cell - 1] if cell else 0
        # There are fewer blocks than members where there are fewer rows.
        for index, rank in zip(range(begin, ends[cell]), ready, strict=False):
            target[index] = rank
            load[rank] += work[index]
    return np.array(target, np.int64)


def find_cells(footprints: Rectangles, owner: Indices) -> Cells:
    """Cut the canvas into bands where a rectangle begins or ends, and each band into cells where one of its own does.

    Positions are numbered band · (width + 1) + column, so that one sort and one bisection serve all bands.
    """
    full = np.flatnonzero(footprints.x_end > footprints.x_begin)
    known, owner = footprints.take(full), owner[full]
    edges = np.unique(np.concatenate([known.y_begin, known.y_end]))
    first = edges.searchsorted(known.y_begin)
    image, band = _ranges(first, edges.searchsorted(known.y_end))
    left, right = (side[image] + band * (known.width + 1) for side in (known.x_begin, known.x_end))
    places = np.unique(np.concatenate([left, right]))
    part, cell = _ranges(places.searchsorted(left), places.searchsorted(right))
    layers = np.bincount(cell, minlength=len(places))
    ranks = int(owner.max(initial=0)) + 1
    covered = np.unique(cell * ranks + owner[image[part]])
    cell, member = np.divmod(covered, ranks)
    share = np.bincount(cell, minlength=len(places))
    shared = share > 1
    chosen = np.flatnonzero(shared)
    band, column = np.divmod(places[chosen], known.width + 1)
    return Cells(
        column,
        places[chosen + 1] - band * (known.width + 1),
        edges[band],
        edges[band + 1],
        layers[chosen],
        np.concatenate([[0], np.cumsum(share[chosen])]),
        member[shared[cell]],
    )


def _ranges(begin: Indices, end: Indices) -> tuple[Indices, Indices]:
    count = end - begin
    row = np.repeat(np.arange(len(count)), count)
    return row, np.arange(len(row)) - np.repeat(count.cumsum() - end, count)


def _lines(ranks: int, pixels: int) -> Rectangles:
    zero, whole = np.zeros(ranks, np.int64), np.full(ranks, pixels, np.int64)
    return Rectangles(pixels, 1, zero, whole, zero, zero, whole, np.full(ranks, min(pixels, 1), np.int64))
