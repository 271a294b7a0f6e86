"""Memory for what lives only while a message is packed or opened, kept from one message to the next.

Fresh memory costs its first touch: for messages of megabytes that is more than what the filters do there. Each thread
keeps its own, since the ranks of an in-process channel are threads.
"""

from __future__ import annotations

import threading

import numpy as np

from clusterviz.codec.contract import Bytes

# More than this is not kept: a thread holds on to two such arrays at most.
KEEP_BYTES = 64 << 20


class _Kept(threading.local):
    def __init__(self) -> None:
        self.arrays: dict[int, Bytes] = {}


_kept = _Kept()


def scratch(size: int, slot: int) -> Bytes:
    """uint8 (size,) of any content, the same memory for the same slot (0 or 1) each time."""
    if size > KEEP_BYTES:
        return np.empty(size, np.uint8)
    array = _kept.arrays.get(slot)
    if array is None or array.size < size:
        array = _kept.arrays[slot] = np.empty(size, np.uint8)
    return array[:size]
