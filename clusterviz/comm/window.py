"""Contracts of shared memory: windows of a node's ranks, and counters of all ranks.

A window has one part for each member, which the member fills and the others read, and a board of small numbers.
`exchange` is the only synchronisation: all members see after the call what any member wrote into its part before it,
and no call returns before all members have called. A frame needs two calls: one when the parts are filled, and one
before they are filled again.

The board has a row of numbers and a ticket for each member. A member writes its numbers, then sets its ticket to the
number of the round. A member that finds the tickets of all members set may read all rows. Rounds alternate between two
boards. With one board, a fast member could enter the next round and overwrite its row while a slow one still reads. Two
suffice: a member that writes in round t + 2 has seen all tickets of round t + 1, and each member set that ticket after
it had copied the rows of round t.

Counters implement a work queue without a server: the rank that raises a counter from k to k + 1 takes item k. A server
rank would cost two messages an item and its attention; MPI's one-sided fetch-and-op costs one access.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import ClustervizError, InputError, mark_agreed

Numbers = NDArray[np.int64]

MAX_NUMBERS = 16
BOARDS = 2
# A ticket and the numbers, padded to whole cache lines of 64 bytes, so that no line has two writers.
ROW_NUMBERS = 24


class WindowError(ClustervizError):
    """The ranks of a node cannot share memory."""

    def __init__(self, cause: str) -> None:
        super().__init__(
            f"no shared memory for the ranks of this node ({cause}); give it more room (in a container, a larger "
            "/dev/shm), or set cluster.transport to messages"
        )


class SharedWindow(Protocol):
    """Memory shared by the ranks of one node; `Channel.window` makes one."""

    @property
    def members(self) -> tuple[int, ...]:
        """The channel's ranks on this node, ascending."""

    @property
    def index(self) -> int:
        """The index of this rank among the members."""

    def part(self, index: int) -> NDArray[np.uint8]:
        """Return a member's part, uint8 (its own_bytes,), page-aligned, initially zero, writable until `free`."""

    def exchange(self, numbers: Sequence[int] | Numbers) -> Numbers:
        """Exchange small numbers between all members, and synchronise them.

        `numbers`: int64 (k,), k at most 16 and the same for all members. Returns int64 (members, k), a copy. Raises
        ValueError: more than 16 numbers.
        """

    def free(self) -> None:
        """Release the memory; all members call it."""


class TicketWindow(ABC):
    """Exchange of numbers through the boards, the same for windows of processes and of threads.

    `members`, `index`: as of `SharedWindow`; `parts`: of all members; `boards`: int64 (BOARDS, members, ROW_NUMBERS).
    """

    def __init__(
        self, members: tuple[int, ...], index: int, parts: Sequence[NDArray[np.uint8]], boards: Numbers
    ) -> None:
        self.members, self.index = members, index
        self._parts, self._boards, self._round = list(parts), boards, 0

    def part(self, index: int) -> NDArray[np.uint8]:
        return self._parts[index]

    def exchange(self, numbers: Sequence[int] | Numbers) -> Numbers:
        """Write the own row and ticket, wait for the tickets of all members, and return a copy of all rows."""
        if (count := len(numbers)) > MAX_NUMBERS:
            raise ValueError(f"{count} numbers do not fit into a row of {MAX_NUMBERS}")
        self._round += 1
        rows = self._boards[self._round % BOARDS]
        rows[self.index, 1 : 1 + count] = numbers
        self._meet(rows, self._round)
        seen: Numbers = rows[:, 1 : 1 + count].copy()
        return seen

    @abstractmethod
    def _meet(self, rows: Numbers, ticket: int) -> None:
        """Set the own ticket, the first number of the own row, and wait for those of all members."""


def check_sizes(sizes: Sequence[int]) -> None:
    """Raise InputError, agreed on, if one of the sizes that all ranks requested is negative."""
    if min(sizes) < 0:
        raise mark_agreed(InputError("wrong bytes of a shared window", found=list(sizes), allowed="0 and more"))


class Counters(Protocol):
    """Integers, initially 0, that every rank reads and raises; `Channel.counters` makes them."""

    def add(self, index: int, amount: int) -> int:
        """Raise a counter atomically and return its previous value; not collective.

        An amount of 0 reads it. What one rank adds to different counters is seen in the order in which it was added.

        Raises IndexError if there is no such counter.
        """

    def reset(self) -> None:
        """Set all counters to 0; collective, and complete on return."""

    def free(self) -> None:
        """Release the counters; collective."""


def check_index(index: int, count: int) -> None:
    """Raise IndexError if there is no such counter; one-sided access to it would change other memory."""
    if not 0 <= index < count:
        raise IndexError(f"no counter {index} of {count}")
