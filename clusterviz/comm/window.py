"""The contract of memory that the ranks of a node share: pixels in place, and small numbers exchanged without messages.

A window has one part for each member, which the member fills and the others read, and a board of small numbers.
`exchange` is the only way to synchronise: whatever a member wrote into its part before the call, all members see after
it, and nobody returns before all have called. So two calls a frame suffice: one when the parts are filled, and one
before they are filled again.

The board. Each member has a row of numbers with a ticket. It writes the numbers, then raises the ticket to the number
of this round; whoever finds the tickets of all members raised may read all rows. There are two boards, and rounds take
turns on them. One would not do: a fast member could enter the next round and overwrite its row while a slow one still
reads. Two suffice: who writes in round t + 2 has returned from round t + 1, so has seen the tickets of all members for
t + 1; each member raised that one after it had returned from round t, with its copy of the rows of t in hand. So
nobody reads the rows of round t any longer, and their board is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agreed import mark_agreed
from clusterviz.errors import ClustervizError, InputError

Numbers = NDArray[np.int64]

MOST_NUMBERS = 16
BOARDS = 2
# A ticket and the numbers, in whole cache lines of 64 bytes, so that no line has two writers.
ROW_NUMBERS = 24


class WindowError(ClustervizError):
    """The ranks of a node cannot have shared memory."""

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
        ...

    @property
    def index(self) -> int:
        """Which of the members this rank is."""
        ...

    def part(self, index: int) -> NDArray[np.uint8]:
        """A member's part, uint8 (bytes that it asked for,), page-aligned, zero at first; writable.

        It must not be touched after `free`.
        """
        ...

    def exchange(self, numbers: Sequence[int] | Numbers) -> Numbers:
        """Give small numbers, get those of all members; all members call it, and nobody returns before all have.

        Parameters
        ----------
        numbers : int64 (k,), k at most 16 and the same for all members

        Returns
        -------
        rows : int64 (members, k), the caller's own copy

        Raises
        ------
        ValueError
            More than 16 numbers.
        """
        ...

    def free(self) -> None:
        """Give the memory back; all members call it."""
        ...


def check_numbers(count: int) -> None:
    """Refuse numbers that a row does not hold."""
    if count > MOST_NUMBERS:
        raise ValueError(f"{count} numbers do not fit into a row of {MOST_NUMBERS}")


def check_sizes(sizes: Sequence[int]) -> None:
    """Refuse sizes that cannot be, given what all ranks asked for; so every rank raises the same.

    Raises
    ------
    InputError
        A negative size.
    """
    if min(sizes) < 0:
        raise mark_agreed(InputError("wrong bytes of a shared window", found=list(sizes), allowed="0 and more"))
