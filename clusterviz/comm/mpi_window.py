"""MPI windows: shared memory of a node's ranks (MPI-3), and counters in the memory of rank 0.

Each rank's segment is allocated separately (`alloc_shared_noncontig`) and touched first by its owner, so that its pages
lie in the owner's NUMA domain. The board lies before the part of the node's first member.

Memory order: MPI_Win_sync is a full memory barrier, on ARM too. One stands between a member's writes and its ticket,
and one between the last ticket seen and the reads. A ticket is one aligned word, written atomically.

Counters are raised by one-sided MPI_Fetch_and_op, without a call by rank 0. Within a node, and over networks whose
adapters support it, an access takes microseconds. A library that does it in software does it when rank 0 next calls
MPI, so rank 0 should take work from the queue too, in items that are not long.

Reference: MPI Forum: MPI, a message-passing interface standard, version 3.1, sections 11.3.4 (MPI_Fetch_and_op) and
11.5.3 (MPI_Win_lock_all).
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agree import check_faults
from clusterviz.comm.back_off import poll_until
from clusterviz.comm.channel import Channel
from clusterviz.comm.placement import granted_cores
from clusterviz.comm.window import BOARDS, ROW_NUMBERS, Numbers, WindowError, check_index, check_numbers, check_sizes

# A poll takes 0.1 microseconds. Spinning pays only if every member has a core of its own.
_SPIN_CALLS = 100
_CALLS_PER_PROGRESS = 32
# The default place of MPI libraries for shared memory.
_SHM_FOLDER = Path("/dev/shm")


def open_window(mpi: Any, comm: Any, channel: Channel, own_bytes: int) -> MpiWindow:
    """Make a window on each of the channel's nodes, with `own_bytes` bytes for this rank; collective, as its errors."""
    sizes = channel.allgather_numbers([own_bytes])[:, 0].tolist()
    check_sizes(sizes)
    number, members = next((i, node) for i, node in enumerate(channel.nodes()) if channel.rank in node)
    # Simulated nodes share the memory of a real one.
    largest_node = channel.placement().local_size * max(map(_segment_bytes, sizes))
    check_faults(channel, space_fault(min(largest_node, sum(map(_segment_bytes, sizes)))), WindowError)
    window: MpiWindow | None = None
    fault = ""
    try:
        window = MpiWindow(mpi, comm.Split(number, channel.rank), members, [sizes[member] for member in members])
        window.touch()
    except mpi.Exception as error:
        fault = str(error).splitlines()[0]
    except OSError as error:
        fault = f"{error.strerror} while {own_bytes} bytes were filled with zeros"
    # This is also the barrier after which all boards are zero.
    check_faults(channel, fault, WindowError)
    return cast(MpiWindow, window)


def space_fault(needed: int) -> str:
    """Return why /dev/shm is too small, or "".

    Checked first, since one rank that fails inside MPI may leave the others waiting.
    """
    if not _SHM_FOLDER.is_dir():
        return ""
    usage = os.statvfs(_SHM_FOLDER)
    left = usage.f_bavail * usage.f_frsize
    return f"{_SHM_FOLDER} has {left} bytes left of the {needed} needed" if left < needed else ""


def _segment_bytes(own_bytes: int) -> int:
    return _whole_pages(own_bytes) + _whole_pages(BOARDS * ROW_NUMBERS * 8) + mmap.PAGESIZE


class MpiWindow:
    """Shared memory of one node, as one rank sees it.

    `comm`: the ranks of the node; `members`: their ranks in the channel; `part_bytes`: size of each member's part.
    """

    def __init__(self, mpi: Any, comm: Any, members: tuple[int, ...], part_bytes: Sequence[int]) -> None:
        self._comm = comm
        self.members = members
        self.index = int(comm.rank)
        board_bytes = BOARDS * len(members) * ROW_NUMBERS * 8
        sizes = [
            _whole_pages(size) + (0 if index else _whole_pages(board_bytes)) for index, size in enumerate(part_bytes)
        ]
        # A library may begin segments within a page: one more page allows for alignment.
        info = mpi.Info.Create({"alloc_shared_noncontig": "true"})
        self._window = mpi.Win.Allocate_shared(sizes[self.index] + mmap.PAGESIZE, 1, info, comm)
        info.Free()
        # MPI_Win_sync needs an access epoch.
        self._window.Lock_all(mpi.MODE_NOCHECK)
        segments = [self._segment(index)[:size] for index, size in enumerate(sizes)]
        ends = zip(segments, part_bytes, strict=True)
        self._parts = [segment[segment.size - _whole_pages(size) :][:size] for segment, size in ends]
        self._boards = segments[0][:board_bytes].view(np.int64).reshape(BOARDS, len(members), ROW_NUMBERS)
        self._tickets = [[memoryview(row[:1]) for row in board] for board in self._boards]
        self._spin_calls = _SPIN_CALLS if len(members) <= len(granted_cores()) else 0
        self._round = 0
        self._sync = self._window.Sync
        self._mine = segments[self.index]

    def touch(self) -> None:
        """Fill the own segment with zeros, before any member's first `exchange`; OSError if memory is missing."""
        fill_with_zeros(self._mine)

    def _segment(self, index: int) -> NDArray[np.uint8]:
        """Return a member's segment from its first whole page on."""
        memory, _ = self._window.Shared_query(index)
        data = np.frombuffer(memory, np.uint8)
        return data[-data.ctypes.data % mmap.PAGESIZE :]

    def part(self, index: int) -> NDArray[np.uint8]:
        return self._parts[index]

    def exchange(self, numbers: Sequence[int] | Numbers) -> Numbers:
        """Write the own row and ticket, wait for the tickets of all members, and return a copy of all rows."""
        count = len(numbers)
        check_numbers(count)
        self._round = ticket = self._round + 1
        rows, tickets = self._boards[ticket % BOARDS], self._tickets[ticket % BOARDS]
        rows[self.index, 1 : 1 + count] = numbers
        self._sync()
        tickets[self.index][0] = ticket
        for raised in tickets:
            if raised[0] != ticket:
                self._wait(raised, ticket)
        self._sync()
        seen: Numbers = rows[:, 1 : 1 + count].copy()
        return seen

    def _wait(self, raised: memoryview, ticket: int) -> None:
        """Wait for one member's ticket, with MPI progress for messages that the member may wait for."""
        calls = 0

        def is_raised() -> bool:
            nonlocal calls
            calls += 1
            if not calls % _CALLS_PER_PROGRESS:
                self._comm.Iprobe()
            return bool(raised[0] == ticket)

        poll_until(is_raised, self._spin_calls)

    def free(self) -> None:
        """Release the memory."""
        self._parts.clear()
        self._window.Unlock_all()
        self._window.Free()
        self._comm.Free()


def _whole_pages(size: int) -> int:
    return -(-size // mmap.PAGESIZE) * mmap.PAGESIZE


def fill_with_zeros(memory: NDArray[np.uint8]) -> None:
    """Fill memory with zeros, and so touch all its pages.

    The operating system writes them, because it reports missing memory as an error; an own write would end the process.
    An MPI library may allocate more pages than /dev/shm has left.
    """
    with open("/dev/zero", "rb", buffering=0) as zeros:
        done = 0
        while done < memory.size:
            done += zeros.readinto(memory[done:].data)


class MpiCounters:
    """Counters on rank 0 of a communicator; construction is collective."""

    def __init__(self, mpi: Any, comm: Any, count: int, barrier: Callable[[], None]) -> None:
        self._comm, self._count, self._barrier, self._first = comm, count, barrier, comm.rank == 0
        self._sum = mpi.SUM
        self._window = mpi.Win.Allocate(8 * count if self._first else 0, 8, comm=comm)
        self._window.Lock_all()
        self.reset()

    def add(self, index: int, amount: int) -> int:
        """Raise a counter by MPI_Fetch_and_op and return its previous value.

        The probe serves other ranks: Open MPI changes counters in shared memory without progress of anything else, and
        a rank that waits for a counter may own the part that the rank before it accesses.
        """
        check_index(index, self._count)
        given, before = np.array([amount], np.int64), np.zeros(1, np.int64)
        self._window.Fetch_and_op(given, before, 0, index, self._sum)
        self._window.Flush(0)
        self._comm.Iprobe()
        return int(before[0])

    def reset(self) -> None:
        """Set all counters to 0, by rank 0 between two barriers."""
        self._barrier()
        if self._first:
            self._window.Put(np.zeros(self._count, np.int64), 0)
            self._window.Flush(0)
        self._barrier()

    def free(self) -> None:
        """Free the MPI window."""
        self._window.Unlock_all()
        self._window.Free()
