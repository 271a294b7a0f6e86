"""The window of ranks that are threads of one process: plain arrays, seen by all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Condition
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.window import BOARDS, ROW_NUMBERS, Numbers, check_numbers


class Waiting(Protocol):
    """What the window needs of the threads' world: a lock, and a wait that ends when a rank fails or takes too long."""

    changed: Condition

    def wait(self, ready: Callable[[], bool], what: str) -> None: ...


def empty_boards(members: int) -> Numbers:
    """int64 (boards, members, row): no ticket is raised."""
    return np.zeros((BOARDS, members, ROW_NUMBERS), np.int64)


class LoopbackWindow:
    """The memory of one node of threads, seen by one of them.

    Parameters
    ----------
    world : what the threads wait on
    members, index : the channel's ranks of the node, and which of them this is
    parts : of all members
    boards : of the node
    """

    def __init__(
        self, world: Waiting, members: tuple[int, ...], index: int, parts: Sequence[NDArray[np.uint8]], boards: Numbers
    ) -> None:
        self._world = world
        self._members = members
        self._index = index
        self._parts = list(parts)
        self._boards = boards
        self._round = 0

    @property
    def members(self) -> tuple[int, ...]:
        """The channel's ranks on this node."""
        return self._members

    @property
    def index(self) -> int:
        """Which of them this rank is."""
        return self._index

    def part(self, index: int) -> NDArray[np.uint8]:
        """A member's part."""
        return self._parts[index]

    def exchange(self, numbers: Sequence[int] | Numbers) -> Numbers:
        """Write my row, raise my ticket, wait for the tickets of all, copy all rows; the lock orders memory."""
        count = len(numbers)
        check_numbers(count)
        self._round = ticket = self._round + 1
        rows = self._boards[ticket % BOARDS]
        rows[self._index, 1 : 1 + count] = numbers
        with self._world.changed:
            rows[self._index, 0] = ticket
            self._world.changed.notify_all()
            self._world.wait(
                lambda: bool((rows[:, 0] == ticket).all()), f"rank {self._members[self._index]} waits in a window"
            )
        seen: Numbers = rows[:, 1 : 1 + count].copy()
        return seen

    def free(self) -> None:
        """Wait until no member reads any longer, and forget the memory."""
        self.exchange(())
        self._parts.clear()
