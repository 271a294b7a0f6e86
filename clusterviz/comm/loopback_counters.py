"""The counters of ranks that are threads of one process: a list, under the lock of their world."""

from __future__ import annotations

from collections.abc import Callable
from threading import Condition

from clusterviz.comm.counters import check_index


class LoopbackCounters:
    """Counters of threads, as one of them has them.

    Parameters
    ----------
    changed : guards the numbers
    numbers : the same list for all ranks
    barrier : waits for all ranks
    """

    def __init__(self, changed: Condition, numbers: list[int], barrier: Callable[[], None]) -> None:
        self._changed, self._numbers, self._barrier = changed, numbers, barrier

    def add(self, index: int, amount: int) -> int:
        """Raise a counter under the lock."""
        check_index(index, len(self._numbers))
        with self._changed:
            before = self._numbers[index]
            self._numbers[index] += amount
        return before

    def reset(self) -> None:
        """Between two barriers everybody writes the same zeros."""
        self._barrier()
        with self._changed:
            self._numbers[:] = [0] * len(self._numbers)
        self._barrier()

    def free(self) -> None:
        """Nothing is held but a list."""
        self._barrier()
