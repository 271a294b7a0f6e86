"""A queue of numbered work that groups of ranks take from: each item once, all members of a group the same items.

Where a group is one rank, taking is one access to a counter. Where it has several, whoever of them comes first to the
group's k-th turn takes an item and writes down which; the others read it. So the quicker members run ahead, and nobody
waits for a leader.
"""

from __future__ import annotations

from collections.abc import Iterator

from clusterviz.comm.channel import Channel
from clusterviz.comm.patience import ask_until


class WorkQueue:
    """The queue, as one rank has it; making, starting and freeing it are collective.

    Parameters
    ----------
    channel : to the other ranks
    most : items that it can hold
    group, groups : the group of this rank, and how many there are
    alone : whether every group is one rank
    """

    def __init__(self, channel: Channel, most: int, group: int, groups: int, alone: bool) -> None:
        self._most, self._alone = most, alone
        # The next item; then for each group and turn whether somebody came, and what was taken, plus one.
        turns = most + 1
        self._first = 1 + 2 * turns * group
        self._counters = channel.counters(1 if alone else 1 + 2 * turns * groups)

    def start(self) -> None:
        """Nothing is taken yet."""
        self._counters.reset()

    def take(self, items: int) -> Iterator[int]:
        """The numbers below `items` that come to this rank's group, each when it is asked for; not collective.

        Parameters
        ----------
        items : how many there are, the same on every rank, at most `most`
        """
        turn = 0
        while (item := self._next(turn)) < items:
            yield item
            turn += 1

    def free(self) -> None:
        """Give the counters back."""
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
        return ask_until(lambda: counters.add(here + 1, 0)) - 1
