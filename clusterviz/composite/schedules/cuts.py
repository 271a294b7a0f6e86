"""Where to cut the picture for direct send, and who takes which piece, so that sparse images cost all owners the same.

The rectangles of the images cover some rows of the canvas often and others hardly. Cut into equal pieces, the middle of
the picture is where most images meet, and its owners work while those of the borders wait.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.schedules.load import sum_by
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import Indices, borders


def weighted_borders(pieces: int, footprints: Rectangles) -> Indices:
    """Where pieces begin of which each holds the same number of covered pixels, and the end of the last.

    A pixel counts once for each rectangle that covers it. Between two rows in which a rectangle begins or ends, the
    count grows in proportion to the rows, so a few sums over those rows find every border; whole numbers throughout, so
    that every rank finds the same ones. Inside the row of a border, the count is taken to be spread evenly.

    Returns
    -------
    borders : int64 (pieces + 1,), ascending; those of `schedule.borders` where every rectangle is the whole canvas
    """
    wide = footprints.x_end - footprints.x_begin
    rows = np.concatenate([footprints.y_begin, footprints.y_end])
    order = rows.argsort()
    rows, cover = rows[order], np.concatenate([wide, -wide])[order].cumsum()
    before = np.zeros_like(rows)
    np.cumsum(cover[:-1] * (rows[1:] - rows[:-1]), out=before[1:])
    total = int(before[-1])
    if total == 0:
        return borders(pieces, footprints.canvas_pixels)
    wanted = borders(pieces, total)
    # Of several rows with one sum, the last: what is covered begins there.
    at = before.searchsorted(wanted[1:-1], "right") - 1
    row, rest = np.divmod(wanted[1:-1] - before[at], cover[at])
    result = np.empty_like(wanted)
    result[0], result[-1] = 0, footprints.canvas_pixels
    result[1:-1] = (rows[at] + row) * footprints.width + rest * footprints.width // cover[at]
    return result


def row_borders(pieces: int, footprints: Rectangles) -> Indices:
    """Borders of equal pieces of whole rows, or of any pixels where there are fewer rows than pieces."""
    if pieces > footprints.height:
        return borders(pieces, footprints.canvas_pixels)
    return borders(pieces, footprints.height) * footprints.width


def top_to_bottom(footprints: Rectangles, ranks: int, owners_of: Sequence[int] | None = None) -> Indices:
    """The ranks by the middle of what their images cover, uppermost first; `owners_of` tells the rank of each image."""
    middle = footprints.y_begin + footprints.y_end
    if owners_of is not None:
        owner, area = np.asarray(owners_of, np.int64), footprints.count()
        middle = sum_by(ranks, owner, area * middle) // np.maximum(sum_by(ranks, owner, area), 1)
    return middle.argsort(kind="stable")
