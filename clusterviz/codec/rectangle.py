"""Bounding rectangle: the smallest box that contains all active pixels.

What: the box, 16 bytes, and its pixels row by row. A message may begin and end within a row of the picture; the box
always refers to the picture's rows.
When: compact objects; as the first stage of a chain, where fewer pieces than the runs of `active` are an advantage.
When not: round or ragged objects, whose corners runs leave out; messages that are not rows of a picture (only blank
pixels at both ends are then cut off).
Cost: one pass over the pixels, one copy of the box. The receiver blends the rows of the box as runs, in place.
Limits: fewer than 2³¹ pixels a message, as runs.
Reference: K.-L. Ma, J. S. Painter, C. D. Hansen, M. F. Krogh, "Parallel volume rendering using binary-swap
compositing", IEEE Computer Graphics and Applications 14(4), 1994 (bounding rectangles of the parts).
"""

from __future__ import annotations

import numpy as np

from clusterviz.codec import kernels
from clusterviz.codec.active import MAX_PIXELS, active_mask
from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows, Runs

TABLE_BYTES = 16


def select(pixels: Pixels, rows: Rows) -> tuple[Bytes, Runs, int] | None:
    """Find the rows of the bounding box; None if it saves no bytes."""
    if len(pixels) > MAX_PIXELS:
        return None
    first, width = rows.first % rows.width, rows.width
    box = np.array(kernels.find_box(active_mask(pixels), len(pixels), first, width), np.int32)
    runs, kept = _rows_of(box, len(pixels), first, width)
    if TABLE_BYTES + kept * 4 * pixels.itemsize >= pixels.nbytes:
        return None
    return box.view(np.uint8), runs, kept


def restore(table: Bytes, count: int, rows: Rows) -> tuple[Runs, int]:
    """Return the rows of a box; raise CodecError if it does not lie in the rows of the message."""
    if table.size != TABLE_BYTES:
        raise CodecError(f"a box of {table.size} bytes instead of {TABLE_BYTES}")
    box = table.view(np.int32)
    top, bottom, left, right = box.tolist()
    first, width = rows.first % rows.width, rows.width
    height = (first + count - 1) // width + 1
    inside = 0 <= top < bottom <= height and 0 <= left < right <= width
    if not inside and (top, bottom, left, right) != (0, 0, 0, 0):
        raise CodecError(f"a box of rows {top} to {bottom}, columns {left} to {right} in {height} × {width} pixels")
    return _rows_of(box, count, first, width)


def _rows_of(box: Runs, count: int, first: int, width: int) -> tuple[Runs, int]:
    """Return the box's rows as runs of the message's pixels; full rows are one run."""
    top, bottom, left, right = box.tolist()
    if right - left == width:
        starts, ends = np.array([top * width]), np.array([bottom * width])
    else:
        starts = np.arange(top, bottom, dtype=np.int64) * width + left
        ends = starts + (right - left)
    # The message's first and last rows may lack columns of the box.
    starts, ends = np.maximum(starts - first, 0), np.minimum(ends - first, count)
    if len(starts) and (starts[0] >= ends[0] or starts[-1] >= ends[-1]):
        some = starts < ends
        starts, ends = starts[some], ends[some]
    runs = np.empty((len(starts), 2), np.int32)
    runs[:, 0], runs[:, 1] = starts, ends - starts
    return runs, int(runs[:, 1].sum(dtype=np.int64))
