"""Bricks of a rank in main memory, and reading of those that are missing."""

from __future__ import annotations

from collections.abc import Callable, Set

from clusterviz.data.source import Index, levels_of
from clusterviz.data.store.cache import CACHE
from clusterviz.frame.opening import Opened
from clusterviz.frame.run import Run
from clusterviz.plan.content import Bricks
from clusterviz.plan.plan import Plan


class BrickReader:
    """Bricks of this rank in main memory, and reading of those that are missing.

    Attributes
    ----------
    bricks_read, bytes_read : bricks that were read so far, and bytes: encoded ones of stores, else those of samples
    """

    def __init__(self, opened: Opened, bricks: Bricks) -> None:
        self._opened, self._held = opened, bricks
        self.bricks_read = self.bytes_read = 0

    def load(self, run: Run, plan: Plan, wanted: Set[Index], holds: Set[Index] = frozenset()) -> Bricks:
        """Return bricks of this rank; those that are not in memory are read.

        `Options.keep_bricks` keeps those in memory that this rank `holds`, which may be needed again.
        """
        with run.local("load", "load"):
            held = plan.content.suiting(self._held)
            bricks = {index: held[index] for index in wanted & held.keys()}
            kept = {index: held[index] for index in holds & held.keys()} if run.options.keep_bricks else {}
            held = self._held = {}  # others are freed before further ones are read
            bricks.update(self.read(plan, wanted - bricks.keys()))
            if run.options.keep_bricks:
                self._held = kept | bricks
            return bricks

    @property
    def held(self) -> set[Index]:
        """Indices of the bricks in memory."""
        return set(self._held)

    def replace(self, opened: Opened, changed: Set[Index], bricks: Bricks) -> None:
        """Read from other time steps, of which some bricks have been read; those in memory that may differ go."""
        self._opened = opened
        self._held = {index: brick for index, brick in self._held.items() if index not in changed} | bricks

    def read(self, plan: Plan, wanted: Set[Index], stops: Callable[[], bool] = lambda: False) -> Bricks:
        """Read bricks, in any thread; what was read of them if `stops` says so."""
        found, encoded = Bricks(), CACHE.bytes_read
        for index, brick in self._opened.read(plan, wanted):
            found[index] = brick
            if stops():
                break
        self.bricks_read += len(found)
        self.bytes_read += (CACHE.bytes_read - encoded) or sum(brick.nbytes for brick in found.values())
        return found

    @property
    def decodes(self) -> bool:
        """Whether bricks of stores are decoded."""
        return any(levels_of(volume.source) is not None for volume in self._opened.volumes)

    @property
    def itemsize(self) -> int:
        """Bytes of a sample as it is read, at most."""
        return max((volume.source.dtype.itemsize for volume in self._opened.volumes), default=1)

    def taken(self) -> Bricks:
        """Return the bricks in memory, which are no longer kept here."""
        bricks, self._held = self._held, {}
        return bricks

    def clear(self) -> None:
        """Free the bricks in memory."""
        self._held = {}
