"""SLIC: spans that several images cover are dealt to the ranks that cover them; all other pixels stay where they are.

What: the rows of the picture are cut into spans where the set of ranks that have pixels there changes. A span that one
rank covers alone stays with it and is never sent. A span with an overlap count of two or more is dealt to one of its
own contributors, so that one of the images need not travel: cells of equal spans are taken by decreasing work, cut
into blocks of rows (one for each contributor), and the contributor with the least work so far gets the first.
When: sparse images of compact bricks on up to some tens of ranks: no pixel moves that is not merged, and the merging is
balanced by what really overlaps.
When not: dense images, where it is direct send; many ranks, where spans become short: each span of a row is a transfer
of its own, which costs planning time here.
Cost: 1 round; a message for each pair of ranks that share a span, n(n − 1) at most; Σ (k_s − 1)·len_s pixels over spans
of k_s contributors, which is (n − 1)·P for dense images.
Limits: any number of ranks and pixels. Several partial images a rank: by theory yes, since spans know nothing of
neighbours in depth; the exchange carries one for each rank as yet.
Reference: A. Stompel, K.-L. Ma, E. B. Lum, J. Ahrens, J. Patchett, "SLIC: scheduled linear image compositing for
parallel volume rendering", IEEE symposium on parallel and large-data visualization and graphics, 2003.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.patch import Patch
from clusterviz.composite.schedule import Indices, Schedule, Stage, borders
from clusterviz.image.region import Rect


@dataclass(frozen=True, eq=False)
class Cell:
    """Spans one below the other that the same ranks cover: `rect`, on a canvas `width` wide."""

    width: int
    rect: Rect
    members: Indices

    @property
    def work(self) -> int:
        """Merges that its pixels need."""
        return (len(self.members) - 1) * self.rect.pixels

    def block(self, index: int, blocks: int) -> tuple[Indices, Indices]:
        """Begin and end of each span of one of so many blocks; spans as wide as the canvas are one."""
        rect = self.rect
        if rect.width == self.width:
            cuts = borders(blocks, rect.pixels)[index : index + 2] + rect.y_begin * self.width
            return cuts[:1], cuts[1:]
        first, last = borders(blocks, rect.height)[index : index + 2] + rect.y_begin
        rows = np.arange(first, last, dtype=np.int64) * self.width
        return rows + rect.x_begin, rows + rect.x_end


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = ()) -> Schedule:
    """Deal the blocks of all cells, those with the most work first."""
    cells = sorted(_cells(ranks, pixels, footprints), key=lambda cell: -cell.work)
    load = np.zeros(ranks, np.int64)
    stages = [stage for cell in cells for stage in _deal(cell, load)]
    return Schedule(ranks, pixels, (Stage.join(stages),) if stages else ())


def _deal(cell: Cell, load: Indices) -> Iterator[Stage]:
    """Give each block to another contributor, the one with the least work first; `load` grows by the merges."""
    blocks = len(cell.members)
    for index, owner in enumerate(cell.members[np.argsort(load[cell.members], kind="stable")]):
        begin, end = cell.block(index, blocks)
        load[owner] += (blocks - 1) * int((end - begin).sum())
        yield Stage.of_columns(cell.members[:, None], owner, begin, end)


def _cells(ranks: int, pixels: int, footprints: Sequence[Patch]) -> Iterator[Cell]:
    """The cells that two ranks or more cover."""
    if not footprints:
        yield from [Cell(pixels, Rect(0, 0, pixels, 1), np.arange(ranks, dtype=np.int64))] if ranks > 1 else []
        return
    width = footprints[0].width
    rects = np.array(
        [(p.rect.x_begin, p.rect.x_end, p.rect.y_begin, p.rect.y_end) if p.count else (0, 0, 0, 0) for p in footprints]
    )
    rows = np.unique(rects[:, 2:])
    for top, bottom in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        active = np.flatnonzero((rects[:, 2] <= top) & (rects[:, 3] >= bottom))
        for left, right, covering in _runs(rects[active]):
            if covering.sum() > 1:
                yield Cell(width, Rect(left, top, right, bottom), active[covering])


def _runs(rects: Indices) -> Iterator[tuple[int, int, NDArray[np.bool_]]]:
    """Columns [left, right) of a band of rows, and which of its rectangles cover them."""
    columns = np.unique(rects[:, :2])
    for left, right in zip(columns[:-1].tolist(), columns[1:].tolist(), strict=True):
        yield left, right, (rects[:, 0] <= left) & (rects[:, 1] >= right)
