"""Active-pixel runs: only pixels that are not blank travel, with a table that says where they lie.

What: runs of pixels of which any component is not 0, each eight bytes in the table. A short blank stretch stays inside
a run where another entry would cost more bytes, or about as many and one more step of the blend.
When: sparse images, on any link: it runs at memory speed, and the runs are blended as they lie, without unpacking.
When not: images whose pixels are all opaque: it finds that out in one pass, and the message stays raw.
Cost: one pass over the pixels, 1/32 of it over their bits, one copy of what is kept; the receiver checks the runs.
Limits: fewer than 2³¹ pixels a message; larger ones stay raw.
Reference: J. Ahrens, J. Painter, "Efficient sort-last rendering using compression-based image compositing",
Eurographics Workshop on Parallel Graphics and Visualization 1998; K. Moreland et al., "An image compositing solution at
scale", SC 2011, 3.2 (active-pixel encoding).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows, Runs

MOST_PIXELS = 2**31 - 1
ENTRY_BYTES = 8

# A blank stretch of at most so many bytes stays inside a run.
GAP_BYTES = 16


def select(pixels: Pixels, rows: Rows) -> tuple[Bytes, Runs, int] | None:
    """The runs, themselves the table; None where table and pixels are no fewer bytes than all pixels."""
    from clusterviz.codec import run_kernels

    pixel_bytes = 4 * pixels.itemsize
    if len(pixels) > MOST_PIXELS:
        return None
    # Each run holds a pixel at least, so more entries than these cannot pay.
    table = np.empty((pixels.nbytes // (pixel_bytes + ENTRY_BYTES), 2), np.int32)
    count, kept = run_kernels.find_runs(marks_of(pixels), GAP_BYTES // pixel_bytes, table)
    if count < 0 or count * ENTRY_BYTES + kept * pixel_bytes >= pixels.nbytes:
        return None
    runs = table[:count]
    return runs.reshape(-1).view(np.uint8), runs, kept


def restore(table: Bytes, count: int, rows: Rows) -> tuple[Runs, int]:
    """The table is the runs.

    Raises
    ------
    CodecError
        The runs are not ascending, disjoint, and within the message's pixels.
    """
    from clusterviz.codec import run_kernels

    if table.size % ENTRY_BYTES:
        raise CodecError(f"a table of runs of {table.size} bytes, which is no multiple of {ENTRY_BYTES}")
    runs = table.view(np.int32).reshape(-1, 2)
    runs.flags.writeable = False
    kept = int(run_kernels.check_runs(runs, count))
    if kept < 0:
        raise CodecError(f"runs that are not ascending, disjoint, and within {count} pixels")
    return runs, kept


def marks_of(pixels: Pixels) -> NDArray[np.uint64]:
    """One bit a pixel: whether it is not blank."""
    from clusterviz.codec import mark_kernels

    marks = np.empty(-(-len(pixels) // 64), np.uint64)
    flat = pixels.reshape(-1).view(np.uint8)
    # Read-only arrays are a type of their own to numba; making all sources so halves what it compiles.
    flat.flags.writeable = False
    mark_kernels.mark(flat, 4 * pixels.itemsize, marks)
    return marks
