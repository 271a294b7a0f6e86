"""An MPI-3 shared-memory window: the parts of a node's ranks, and the board through which they exchange small numbers.

Each rank's segment lies by itself (`alloc_shared_noncontig`) and is touched first by its owner, so that its pages lie
in the memory next to the owner's cores. The board lies in front of the part of the node's first member.

Memory order. MPI_Win_sync is a full memory barrier in the processor, on ARM too. One stands between what a member
writes and its ticket, and one between the last ticket seen and what is read. A ticket is one aligned word, which
arrives whole.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agreed import mark_agreed
from clusterviz.comm.channel import Channel
from clusterviz.comm.patience import ask_until
from clusterviz.comm.place import granted_cores
from clusterviz.comm.window import BOARDS, ROW_NUMBERS, Numbers, WindowError, check_numbers, check_sizes

# A look takes a tenth of a microsecond. It pays only where the member that is waited for has a core meanwhile.
_EAGER_LOOKS = 100
_LOOKS_PER_PROGRESS = 32
# Where MPI libraries keep what processes share, unless they are told otherwise.
_SHARED_FOLDER = Path("/dev/shm")


def open_window(mpi: Any, comm: Any, channel: Channel, own_bytes: int) -> MpiWindow:
    """Make a window on each of the channel's nodes, with a part of so many bytes for this rank; collective.

    Raises
    ------
    InputError, WindowError
        On every rank.
    """
    sizes = channel.allgather_numbers([own_bytes])[:, 0].tolist()
    check_sizes(sizes)
    number, members = next((i, node) for i, node in enumerate(channel.nodes()) if channel.rank in node)
    # Pretended nodes share the memory of a real one.
    largest_node = channel.place().local_size * max(map(_segment_bytes, sizes))
    _agree(channel, _lack_of_room(min(largest_node, sum(map(_segment_bytes, sizes)))))
    window: MpiWindow | None = None
    fault = ""
    try:
        window = MpiWindow(mpi, comm.Split(number, channel.rank), members, [sizes[member] for member in members])
        window.touch()
    except mpi.Exception as error:
        fault = str(error).splitlines()[0]
    except OSError as error:
        fault = f"{error.strerror} while {own_bytes} bytes were filled with zeros"
    # Also the barrier after which all boards are zero.
    _agree(channel, fault)
    return cast(MpiWindow, window)


def _agree(channel: Channel, fault: str) -> None:
    """Raise the first fault of any rank on every rank. What another rank got is left to the end of the program."""
    if channel.maximum(bool(fault)):
        faults = channel.allgather(fault)
        raise mark_agreed(WindowError(next(f"rank {rank}: {text}" for rank, text in enumerate(faults) if text)))


def _lack_of_room(needed: int) -> str:
    """Why a node's windows do not fit; asked first, since one rank that fails inside MPI may leave the others there."""
    if not _SHARED_FOLDER.is_dir():
        return ""
    usage = os.statvfs(_SHARED_FOLDER)
    left = usage.f_bavail * usage.f_frsize
    return f"{_SHARED_FOLDER} has {left} bytes left of the {needed} needed" if left < needed else ""


def _segment_bytes(own_bytes: int) -> int:
    return _whole_pages(own_bytes) + _whole_pages(BOARDS * ROW_NUMBERS * 8) + mmap.PAGESIZE


class MpiWindow:
    """The memory of one node, seen by one rank.

    Parameters
    ----------
    mpi : the MPI module
    comm : the ranks of the node
    members : their ranks in the channel
    part_bytes : of each member's part

    Raises
    ------
    MPI.Exception
        No memory, or none that can be shared.
    """

    def __init__(self, mpi: Any, comm: Any, members: tuple[int, ...], part_bytes: Sequence[int]) -> None:
        self._comm = comm
        self._members = members
        self._index = int(comm.rank)
        board_bytes = BOARDS * len(members) * ROW_NUMBERS * 8
        sizes = [
            _whole_pages(size) + (0 if index else _whole_pages(board_bytes)) for index, size in enumerate(part_bytes)
        ]
        # Where a library does not begin segments at a page, the first page is given up.
        info = mpi.Info.Create({"alloc_shared_noncontig": "true"})
        self._window = mpi.Win.Allocate_shared(sizes[self._index] + mmap.PAGESIZE, 1, info, comm)
        info.Free()
        # Win_sync belongs into an epoch.
        self._window.Lock_all(mpi.MODE_NOCHECK)
        segments = [self._segment(index)[:size] for index, size in enumerate(sizes)]
        ends = zip(segments, part_bytes, strict=True)
        self._parts = [segment[segment.size - _whole_pages(size) :][:size] for segment, size in ends]
        self._boards = segments[0][:board_bytes].view(np.int64).reshape(BOARDS, len(members), ROW_NUMBERS)
        self._tickets = [[memoryview(row[:1]) for row in board] for board in self._boards]
        self._eager_looks = _EAGER_LOOKS if len(members) <= len(granted_cores()) else 0
        self._round = 0
        self._sync = self._window.Sync
        self._mine = segments[self._index]

    def touch(self) -> None:
        """Fill my memory with zeros, before anybody's first `exchange`.

        Raises
        ------
        OSError
            There is no room for it.
        """
        _zero(self._mine)

    def _segment(self, index: int) -> NDArray[np.uint8]:
        """A member's segment from its first whole page on."""
        memory, _ = self._window.Shared_query(index)
        data = np.frombuffer(memory, np.uint8)
        return data[-data.ctypes.data % mmap.PAGESIZE :]

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
        """Write my row, raise my ticket, wait for the tickets of all, copy all rows."""
        count = len(numbers)
        check_numbers(count)
        self._round = ticket = self._round + 1
        rows, tickets = self._boards[ticket % BOARDS], self._tickets[ticket % BOARDS]
        rows[self._index, 1 : 1 + count] = numbers
        self._sync()
        tickets[self._index][0] = ticket
        for raised in tickets:
            if raised[0] != ticket:
                self._wait(raised, ticket)
        self._sync()
        seen: Numbers = rows[:, 1 : 1 + count].copy()
        return seen

    def _wait(self, raised: memoryview, ticket: int) -> None:
        """Wait for one member's ticket; now and then let MPI work on messages that the member may be waiting for."""
        looks = 0

        def look() -> bool:
            nonlocal looks
            looks += 1
            if not looks % _LOOKS_PER_PROGRESS:
                self._comm.Iprobe()
            return bool(raised[0] == ticket)

        ask_until(look, self._eager_looks)

    def free(self) -> None:
        """Give the memory back."""
        self._parts.clear()
        self._window.Unlock_all()
        self._window.Free()
        self._comm.Free()


def _whole_pages(size: int) -> int:
    return -(-size // mmap.PAGESIZE) * mmap.PAGESIZE


def _zero(memory: NDArray[np.uint8]) -> None:
    """Touch all pages and fill them with zeros.

    The system writes them, since it reports memory that is not there as an error, where a write of our own would end
    the process: an MPI library may well promise more pages than /dev/shm has left.
    """
    with open("/dev/zero", "rb", buffering=0) as zeros:
        done = 0
        while done < memory.size:
            done += zeros.readinto(memory[done:].data)
