"""The picture cut into strips of rows that cost the same to blend, from the footprints alone.

Every rank computes the same cut, in integers. A row costs one unit for each pixel that is written, and one for each
pixel of an image that is read; so strips are narrow where images overlap, and no rows need to be interlaced.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from clusterviz.image.region import Rect


def cut_strips(canvas: Rect, rects: Iterable[Rect], strips: int) -> list[int]:
    """Rows of the canvas at which strips begin, and its last: strips + 1 numbers, ascending from 0 to its height."""
    steps = np.zeros(canvas.height + 1, np.int64)
    for rect in rects:
        if rect.pixels:
            steps[rect.y_begin - canvas.y_begin] += rect.width
            steps[rect.y_end - canvas.y_begin] -= rect.width
    cost = np.cumsum(canvas.width + np.cumsum(steps[:-1]))
    if not cost.size:
        return [0] * (strips + 1)
    goals = int(cost[-1]) * np.arange(1, strips, dtype=np.int64) // strips
    return [0, *(np.searchsorted(cost, goals, "left") + 1).clip(0, canvas.height).tolist(), canvas.height]
