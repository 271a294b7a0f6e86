"""Resolve schemes: how the fragments of a pixel come in order.

static : a private array with room for all fragments of any pixel. Where the stored fragments of a pixel are side by
    side (fixed, dynamic), they are sorted there instead.
optimised : per-pixel array optimisation. Tiles of pixels are sorted into classes by their most fragments: at most 8,
    16, 32, …; a program for each class has an array of that size.
peeling : per-pixel depth peeling. An array of 8 fragments; when it is used up, the next ones are sorted.
both : classes up to 32; beyond, 32 fragments are peeled at a time.

References
----------
S. Lindholm, M. Falk, E. Sundén, A. Bock, A. Ynnerman, T. Ropinski, Hybrid Data Visualization Based on Depth Complexity
Histogram Analysis, 2014, section 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.plan.content import Content
from clusterviz.render.abuffer.fills import HEAD, Lists

SMALLEST, LARGEST, MOST_SIZE = 8, 32, 1024
"""Fragments of the smallest array, of the largest where classes and peeling are combined, and of any array: what is
left of a longer list is peeled."""
DRAWN_CLASS = 3
"""Word of the lists' head with the class of tiles that a program draws."""


def is_sorted(content: Content) -> bool:
    """Return whether the stored fragments of a pixel are in order."""
    return content.resolve == "static" and content.fill not in ("lists", "pages")


def class_of(counts: NDArray[Any]) -> NDArray[np.int64]:
    """Return the class of numbers of fragments: the least of 8, 16, 32, … that is not below."""
    doublings = np.ceil(np.log2(np.maximum(counts, SMALLEST) / SMALLEST))
    found: NDArray[np.int64] = SMALLEST << doublings.astype(np.int64)
    return found


def counts_of(lists: Lists, rect: Rect) -> NDArray[np.int32]:
    """Return the fragments of pixels (h, w)."""
    return lists[HEAD + 1 :: 2].astype(np.int32).reshape(rect.height, rect.width)


def sizes_of(content: Content, most: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Return the sizes of the arrays by which tiles are drawn.

    Parameters
    ----------
    most : of any shape, most fragments of a pixel of each tile

    Returns
    -------
    sizes : of this shape; 0 where the stored fragments are in order
    """
    if is_sorted(content):
        return np.zeros(most.shape, np.int64)
    own = np.minimum(class_of(most), {"peeling": SMALLEST, "both": LARGEST}.get(content.resolve, MOST_SIZE))
    if content.resolve == "static" or not most.any():
        return np.full_like(own, own.max(initial=SMALLEST))
    # Empty tiles need no program of their own.
    return np.where(most > 0, own, own[most > 0].min())


def classified(content: Content, lists: Lists, counts: NDArray[np.int32], tile: int) -> tuple[Lists, list[int]]:
    """Return lists with the classes of tiles, and the sizes that occur.

    Parameters
    ----------
    counts : (h, w), fragments
    tile : pixels along the side of a tile
    """
    assert content, "there is geometry"
    most = np.maximum.reduceat(counts, np.arange(0, counts.shape[0], tile), axis=0)
    most = np.maximum.reduceat(most, np.arange(0, counts.shape[1], tile), axis=1)
    sizes = sizes_of(content, most)
    return np.concatenate([lists, sizes.ravel().astype(np.uint32)]), np.unique(sizes).tolist()
