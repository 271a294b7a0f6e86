"""Decoded bricks of all stores that a process reads, within one limit, and the threads that decode them."""

from __future__ import annotations

import os
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from typing import Any, TypeVar

from numpy.typing import NDArray

CACHE_BYTES = 128 << 20
"""Limit without `cluster.memory_limit`."""
T = TypeVar("T")
Key = tuple[Hashable, ...]


class Owner:
    """Owner of cached bricks; these are freed with it."""

    def __init__(self) -> None:
        weakref.finalize(self, CACHE.drop, id(self))


class BrickCache:
    """Decoded bricks by key; those that were used longest ago are dropped first. Threads share it.

    Attributes
    ----------
    limit_bytes : may be changed; the next brick keeps to it
    bytes_read : of encoded bricks, by all threads so far
    """

    def __init__(self, limit_bytes: int = CACHE_BYTES) -> None:
        self.limit_bytes, self.bytes, self.bytes_read = limit_bytes, 0, 0
        # Reentrant, since the garbage collector may call `drop` at any time.
        self._lock = threading.RLock()
        self._bricks: OrderedDict[tuple[int, Key], Future[NDArray[Any]]] = OrderedDict()

    def get(self, owner: Owner, key: Key, decode: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return a brick, not to be written; one that several threads ask for is decoded once."""
        place = id(owner), key
        with self._lock:
            known = self._bricks.get(place)
            if known is not None:
                self._bricks.move_to_end(place)
            else:
                mine = self._bricks[place] = Future()
        if known is not None:
            return known.result()
        try:
            samples = decode()
        except BaseException as error:
            with self._lock:
                self._bricks.pop(place, None)
            mine.set_exception(error)
            raise
        with self._lock:
            mine.set_result(samples)
            # Meanwhile its owner may have gone.
            if self._bricks.get(place) is mine:
                self.bytes += samples.nbytes
                self._shrink()
        return samples

    def count(self, bytes_read: int) -> None:
        with self._lock:
            self.bytes_read += bytes_read

    def drop(self, owner: int) -> None:
        with self._lock:
            for place in [place for place in self._bricks if place[0] == owner]:
                self._remove(place)

    def _shrink(self) -> None:
        while self.bytes > self.limit_bytes:
            self._remove(next(place for place, brick in self._bricks.items() if brick.done()))

    def _remove(self, place: tuple[int, Key]) -> None:
        brick = self._bricks.pop(place)
        self.bytes -= brick.result().nbytes if brick.done() else 0


CACHE = BrickCache()


def for_each(work: Callable[[T], object], items: Iterable[T], threads: int | None = None) -> None:
    """Call a function for each item, in threads, by default one for each core of this rank; raise the first error."""
    items, threads = list(items), threads or _cores()
    if len(items) < 2 or threads < 2:
        for item in items:
            work(item)
        return
    calls = [_pool(os.getpid(), threads).submit(work, item) for item in items]
    try:
        for call in calls:
            call.result()
    finally:
        for call in calls:
            call.cancel()
        wait(calls)


def _cores() -> int:
    from numba import config  # slow to import

    return int(getattr(config, "NUMBA_NUM_THREADS"))  # noqa: B009


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Threads of a process; a forked one has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="decode")
