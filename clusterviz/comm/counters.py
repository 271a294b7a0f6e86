"""The contract of counters that all ranks raise: how work is taken from one queue without anybody who hands it out.

A counter that is read and raised in one step numbers the takers: whoever gets k takes the k-th piece of work. With a
rank as a server each piece would cost two messages and the server's attention; with a counter in memory that all reach
(MPI's one-sided fetch-and-op) it costs one access, which the network does by itself where it can.
"""

from __future__ import annotations

from typing import Protocol


class Counters(Protocol):
    """Whole numbers, all 0 at first, that every rank reads and raises; `Channel.counters` makes them."""

    def add(self, index: int, amount: int) -> int:
        """Raise a counter, and get what it was before; no other rank comes in between. Not collective.

        An amount of 0 reads it. What is added to different counters is seen in the order in which one rank added it.

        Raises
        ------
        IndexError
            There is no such counter.
        """
        ...

    def reset(self) -> None:
        """All of them to 0; collective, and nobody returns before it is done."""
        ...

    def free(self) -> None:
        """Give them back; collective."""
        ...


def check_index(index: int, count: int) -> None:
    """Refuse a counter that there is not: one-sided access would change somebody's memory.

    Raises
    ------
    IndexError
        There is no such counter.
    """
    if not 0 <= index < count:
        raise IndexError(f"no counter {index} of {count}")
