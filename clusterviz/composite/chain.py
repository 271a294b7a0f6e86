"""The order of merging: two chains that grow outwards from this rank's own pixels.

Over is associative but not commutative, and rounding makes it not even quite associative. So that the picture does
not depend on who is early, each chain merges in a fixed order, nearest neighbour first: one chain starts with our own
pixels and takes what lies behind, the other takes what lies in front; at the end the one goes over the other. Within
that order, whatever has arrived is merged at once.
"""

from __future__ import annotations

from collections.abc import Iterable

from clusterviz.composite.fragment import Fragment, grow, merge
from clusterviz.composite.patch import Patch


class Chain:
    """The merging of one patch on one rank in one stage.

    Parameters
    ----------
    position : this rank's place in visibility order
    own : what it holds
    result : the patch that holds everything in the end
    sources : positions that will deliver, each once
    """

    def __init__(self, position: int, own: Fragment, result: Patch, sources: Iterable[int]) -> None:
        ordered = sorted(sources)
        self._behind = [source for source in ordered if source > position][::-1]
        self._before = [source for source in ordered if source < position]
        self._arrived: dict[int, list[Fragment]] = {}
        self.result = result
        self._back = own
        self._front: Fragment | None = None

    def add(self, source: int, fragments: list[Fragment]) -> None:
        """Take in what a source delivered (disjoint fragments), and merge all that is next in line."""
        self._arrived[source] = fragments
        while self._behind and self._behind[-1] in self._arrived:
            for fragment in self._arrived.pop(self._behind.pop()):
                self._back = merge(self._back, fragment, self.result)
        while self._before and self._before[-1] in self._arrived:
            for fragment in self._arrived.pop(self._before.pop()):
                self._front = fragment if self._front is None else merge(fragment, self._front, self.result)

    def finish(self) -> Fragment:
        """The merged patch, after all sources have delivered."""
        merged = self._back if self._front is None else merge(self._front, self._back, self.result)
        return grow(merged, self.result)
