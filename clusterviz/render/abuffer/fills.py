"""Fill schemes: how the fragments of a rectangle of pixels are stored.

fixed : as many places for each pixel as the most fragments of one. One pass; wasteful where few pixels have many.
dynamic : the fragments of each pixel side by side, without gaps. Two passes: counting, and storing; the first few of
    each pixel are kept from the first pass.
lists : linked lists, from a pool by a counter. One pass; a link for each fragment.
pages : the same with pages of fragments.

The pool of the schemes with one pass starts small. If it is full, the pass counts on, and is run again with a larger
pool. No fragment is dropped: a rectangle that takes too much memory is divided.

References
----------
S. Lindholm, M. Falk, E. Sundén, A. Bock, A. Ynnerman, T. Ropinski, Hybrid Data Visualization Based on Depth Complexity
Histogram Analysis, 2014, section 4. C. Crassin, Linked lists of fragment pages, 2010.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import ceil
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError
from clusterviz.image.partial import Rect
from clusterviz.plan.plan import Plan
from clusterviz.scene.values import Fill

Pass = Literal["count", "fill", "fixed", "pages"]
PASSES: dict[Fill, tuple[Pass, ...]] = {
    "auto": ("count", "fill"),  # of the first frame
    "fixed": ("fixed",),
    "dynamic": ("count", "fill"),
    "lists": ("pages",),
    "pages": ("pages",),
}
FRAGMENT, WORD, EARLY = 8, 4, 8
"""Bytes of a fragment (depth, and number of the primitive), and of a length, place or link; fragments of a pixel that
are kept as they are counted."""
PAGE_SHIFT: dict[Fill, int] = {"fixed": 31, "dynamic": 31, "lists": 0, "pages": 2}
"""Logarithm of the fragments of a page; 31: a list is in one piece."""
HEAD = 4
"""Words in front of the pixels' lists, as in stored.glsl."""
START = {"fixed": 4.0, "lists": 1.0, "pages": 0.5}
"""First pool: layers, fragments or pages for each pixel."""
SLACK = 1.25
"""Pool over what the frame before has needed."""
MEMORY_RATIO = 2
MOST_BYTES = 1 << 30
"""Memory for the fragments of a rectangle, beyond which it is divided."""
LEAST_SIDE = 8
"""Rows of a rectangle that are not divided."""
Lists = NDArray[np.uint32]
Run = Callable[[Pass, Lists, int, int], None]


class ManyFragmentsError(Exception):
    """A rectangle needs more memory for its fragments than is meant for them, and can be divided."""


class Pools:
    """What is known of the last rectangle's fragments.

    Attributes
    ----------
    rooms : sizes of the pools that it has needed, by scheme: layers, and fragments or pages for each pixel
    most, mean : fragments of a pixel
    """

    def __init__(self) -> None:
        self.rooms, self.most, self.mean = dict(START), np.inf, 0.0

    def note(self, counts: NDArray[np.uint32]) -> None:
        """Note the fragments of pixels."""
        self.most, self.mean = float(counts.max(initial=0)), float(counts.mean())


def with_fill(plan: Plan, pools: Pools) -> Plan:
    """Return a plan with a fill scheme in place of `auto`.

    This is the fixed scheme, which has one pass, if it would have taken at most twice the memory of the dynamic one for
    the last rectangle, else that. Both store the fragments of a pixel side by side.
    """
    if plan.content.fill != "auto":
        return plan
    fill: Fill = "fixed" if pools.most <= MEMORY_RATIO * (pools.mean + EARLY) else "dynamic"
    return replace(plan, content=replace(plan.content, fill=fill))


def bytes_of(fill: Fill, pixels: int) -> tuple[int, int]:
    """Return the bytes of a scheme without fragments, and those of each unit of `room_for`."""
    lists = WORD * (HEAD + 2 * pixels)
    page = (FRAGMENT << PAGE_SHIFT[fill]) + WORD
    early = EARLY * FRAGMENT * pixels * (fill == "dynamic")
    return lists + early, {"fixed": FRAGMENT * pixels, "dynamic": FRAGMENT, "lists": page, "pages": page}[fill]


def room_for(fill: Fill, counts: NDArray[Any], pixels: NDArray[Any] | int = 1) -> int:
    """Return the size that lists need: layers (fixed), fragments, or pages.

    Parameters
    ----------
    counts : integer (n,), fragments of pixels
    pixels : integer (n,), number of pixels of each count
    """
    if fill == "fixed":
        return int(np.max(counts * (np.asarray(pixels) > 0), initial=0))
    shift = max(0, PAGE_SHIFT[fill]) if fill == "pages" else 0
    return int(np.sum(-(-counts.astype(np.int64) >> shift) * pixels))


def store_fragments(fill: Fill, rect: Rect, pools: Pools, run: Run, most: int = 0) -> Lists:
    """Store the fragments of a rectangle by a scheme; return its lists, as in stored.glsl, without classes.

    Parameters
    ----------
    run : runs a pass, given the lists, which it writes, and the numbers of fragments and links for which memory is
        needed; raises MemoryError where there is none
    most : bytes of a buffer, at most; 0: any number

    Raises
    ------
    ManyFragmentsError
        The rectangle should be divided.
    DeviceError
        It cannot be divided any more, and there is no memory.
    """
    lists = np.zeros(HEAD + 2 * rect.pixels, np.uint32)
    counts, (fixed_bytes, each) = lists[HEAD + 1 :: 2], bytes_of(fill, rect.pixels)
    most = most or 1 << 62
    can_divide = rect.height > LEAST_SIDE
    places = {"fixed": rect.pixels, "dynamic": 1, "lists": 1, "pages": 1 << PAGE_SHIFT["pages"]}[fill]
    most_room = max(0, min((MOST_BYTES - fixed_bytes) // each, most // (FRAGMENT * places)))
    if can_divide and fixed_bytes > min(MOST_BYTES, most):
        raise ManyFragmentsError

    def run_for(one: Pass, room: int) -> None:
        size = fixed_bytes + each * room
        try:
            if room * places * FRAGMENT > most:
                raise MemoryError
            if one == "count":
                run(one, lists, 0, 0)
            else:
                run(one, lists, room * places, room if one == "pages" else 0)
        except MemoryError:
            if can_divide:
                raise ManyFragmentsError from None
            of = f"the fragments of {rect.width} x {rect.height} pixels"
            raise DeviceError(f"no memory for {of}; needed {size} bytes") from None

    lists[0] = PAGE_SHIFT[fill]
    if fill == "dynamic":
        run_for("count", 0)
        ends = np.cumsum(counts, dtype=np.int64)
        room = int(ends[-1])
        if can_divide and room > most_room:
            raise ManyFragmentsError
        lists[HEAD::2] = ends - counts
        pools.note(counts)
        if room:
            run_for("fill", room)
        return lists
    units = 1 if fill == "fixed" else rect.pixels
    room = max(1, min(most_room, ceil(pools.rooms[fill] * units)))
    while True:
        lists[1:HEAD] = room, 0, 0
        run_for(PASSES[fill][0], room)
        needed = room_for(fill, counts)
        pools.rooms[fill] = (1.0 if fill == "fixed" else SLACK) * needed / units
        if needed <= room:
            pools.note(counts)
            return lists
        if can_divide and needed > most_room:
            raise ManyFragmentsError
        room = needed
