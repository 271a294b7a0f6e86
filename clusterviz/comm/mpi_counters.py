"""Counters in the memory of rank 0, raised by MPI-3's one-sided fetch-and-op: rank 0 calls nothing for it.

Within a node, and over networks whose adapters add by themselves, an access takes microseconds whatever rank 0 does.
Where a library adds in software, it does so when rank 0 next calls MPI, so rank 0 should take work from the queue too,
in pieces that are not long.

References
----------
MPI Forum: MPI, a message-passing interface standard, version 3.1, sections 11.3.4 (MPI_Fetch_and_op) and 11.5.3
(MPI_Win_lock_all).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clusterviz.comm.counters import check_index


class MpiCounters:
    """Counters on rank 0 of a communicator; making them is collective.

    Parameters
    ----------
    mpi : the MPI module
    comm : of all ranks
    count : of counters
    barrier : waits for all ranks
    """

    def __init__(self, mpi: Any, comm: Any, count: int, barrier: Callable[[], None]) -> None:
        self._count, self._barrier, self._first = count, barrier, comm.rank == 0
        self._sum = mpi.SUM
        self._window = mpi.Win.Allocate(8 * count if self._first else 0, 8, comm=comm)
        self._window.Lock_all()
        self.reset()

    def add(self, index: int, amount: int) -> int:
        """One fetch-and-op, done when this returns."""
        check_index(index, self._count)
        given, before = np.array([amount], np.int64), np.zeros(1, np.int64)
        self._window.Fetch_and_op(given, before, 0, index, self._sum)
        self._window.Flush(0)
        return int(before[0])

    def reset(self) -> None:
        """Rank 0 overwrites its numbers between two barriers."""
        self._barrier()
        if self._first:
            self._window.Put(np.zeros(self._count, np.int64), 0)
            self._window.Flush(0)
        self._barrier()

    def free(self) -> None:
        """Give the window back."""
        self._window.Unlock_all()
        self._window.Free()
