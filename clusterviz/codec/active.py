"""Active-pixel encoding: runs of pixels that are not blank, with a table of their positions.

What: runs of pixels with any component other than 0, eight bytes each in the table. A run includes a short gap of blank
pixels if another entry would take more bytes, or about as many and one more step of the blend.
When: sparse images, on any link: it runs at memory speed, and runs are blended without unpacking.
When not: images whose pixels are all opaque: one pass finds that out, and the message stays raw.
Cost: one pass over the pixels, 1/32 of it over the bit mask, one copy of the active pixels; the receiver checks runs.
Limits: fewer than 2³¹ pixels a message; larger ones stay raw.
Reference: J. Ahrens, J. Painter, "Efficient sort-last rendering using compression-based image compositing",
Eurographics Workshop on Parallel Graphics and Visualization 1998; K. Moreland et al., "An image compositing solution at
scale", SC 2011, 3.2 (active-pixel encoding).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import kernels
from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows, Runs

MAX_PIXELS = 2**31 - 1
ENTRY_BYTES = 8

# Longest gap of blank pixels inside a run.
GAP_BYTES = 16


def select(pixels: Pixels, rows: Rows) -> tuple[Bytes, Runs, int] | None:
    """Find the runs, which are also the table; None if they save no bytes."""
    pixel_bytes = 4 * pixels.itemsize
    if len(pixels) > MAX_PIXELS:
        return None
    # A run has at least one pixel, so a longer table cannot save bytes.
    table = np.empty((pixels.nbytes // (pixel_bytes + ENTRY_BYTES), 2), np.int32)
    count, kept = kernels.find_runs(active_mask(pixels), GAP_BYTES // pixel_bytes, table)
    if count < 0 or count * ENTRY_BYTES + kept * pixel_bytes >= pixels.nbytes:
        return None
    runs = table[:count]
    return runs.reshape(-1).view(np.uint8), runs, kept


def restore(table: Bytes, count: int, rows: Rows) -> tuple[Runs, int]:
    """Return the runs of a table.

    Raises CodecError if the runs are not ascending, disjoint, and within the message's pixels.
    """
    if table.size % ENTRY_BYTES:
        raise CodecError(f"a table of runs of {table.size} bytes, which is no multiple of {ENTRY_BYTES}")
    runs = table.view(np.int32).reshape(-1, 2)
    runs.flags.writeable = False
    kept = kernels.check_runs(runs, count)
    if kept < 0:
        raise CodecError(f"runs that are not ascending, disjoint, and within {count} pixels")
    return runs, kept


def active_mask(pixels: Pixels) -> NDArray[np.uint64]:
    """Return one bit a pixel, set if the pixel is not blank: uint64 (pixels / 64, rounded up)."""
    mask = np.empty(-(-len(pixels) // 64), np.uint64)
    flat = pixels.reshape(-1).view(np.uint8)
    kernels.make_mask(flat, 4 * pixels.itemsize, mask)
    return mask
