"""Queue of numbered work items that groups of ranks take, each item once.

All members of a group take the same items. In a group of one rank, taking is one access to a counter. In a larger group
the first member that reaches the group's k-th turn takes an item and stores its number; the others read it. Fast
members run ahead, and no member waits for a leader.
"""

from __future__ import annotations

from collections.abc import Iterator

from clusterviz.comm.back_off import poll_until
from clusterviz.comm.channel import Channel


class WorkQueue:
    """Work queue of one rank; construction, `start` and `free` are collective.

    `channel`: to the other ranks; `most`: largest number of items; `group`, `groups`: index of this rank's group, and
    number of groups; `alone`: whether every group is one rank.
    """

    def __init__(self, channel: Channel, most: int, group: int, groups: int, alone: bool) -> None:
        self._most, self._alone = most, alone
        # Counter 0: the next item. Then two a group and turn: members that have come, and the item taken plus one.
        turns = most + 1
        self._first = 1 + 2 * turns * group
        self._counters = channel.counters(1 if alone else 1 + 2 * turns * groups)

    def start(self) -> None:
        """Reset the queue."""
        self._counters.reset()

    def take(self, items: int) -> Iterator[int]:
        """Yield the numbers below `items` that this rank's group takes, each on request; not collective.

        `items`: number of items, the same on every rank, at most `most`.
        """
        turn = 0
        while (item := self._next(turn)) < items:
            yield item
            turn += 1

    def free(self) -> None:
        """Release the counters."""
        self._counters.free()

    def _next(self, turn: int) -> int:
        counters = self._counters
        if self._alone:
            return counters.add(0, 1)
        here = self._first + 2 * turn
        if counters.add(here, 1) == 0:
            item = counters.add(0, 1)
            counters.add(here + 1, item + 1)
            return item
        return poll_until(lambda: counters.add(here + 1, 0)) - 1
