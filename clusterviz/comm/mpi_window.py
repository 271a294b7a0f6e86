"""MPI windows: shared memory of a node's ranks (MPI-3), counters in the memory of rank 0, and remote memory.

Each rank's segment is allocated separately (`alloc_shared_noncontig`) and touched first by its owner, so that its pages
lie in the owner's NUMA domain. The board lies before the part of the node's first member.

Memory order: MPI_Win_sync is a full memory barrier, on ARM too. One stands between a member's writes and its ticket,
and one between the last ticket seen and the reads. A ticket is one aligned word, written atomically.

Counters are raised by one-sided MPI_Fetch_and_op, without a call by rank 0. Within a node, and over networks whose
adapters support it, an access takes microseconds. A library that does it in software does it when rank 0 next calls
MPI, so rank 0 should take work from the queue too, in items that are not long.

Remote memory is windows of all ranks, whose parts on the own node are mapped. Parts in memory are allocated by
MPI_Win_allocate, which shares them between the ranks of a node where it can; MPI_Win_shared_query (since MPI 4.1 for
these windows) gives their addresses. Parts in files are mapped by all ranks of the node, and given to MPI_Win_create
for the ranks of other nodes. Where nothing is mapped (an older MPI, another node), boxes travel by MPI_Get and MPI_Put,
with a derived type for rows that are not contiguous.

Measured with MPICH 5.0 between two ranks of one node, a box of 128³ float32 in an array of 256³: MPI_Get a row took 5
to 8 times as long as a copy by NumPy, MPI_Get by a derived type 1.5 times, and NumPy's copy of the mapped part as long
as one of own memory.

Reference: MPI Forum: MPI, a message-passing interface standard, version 3.1, sections 11.3.4 (MPI_Fetch_and_op) and
11.5.3 (MPI_Win_lock_all).
"""

from __future__ import annotations

import mmap
import os
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agree import check_faults
from clusterviz.comm.back_off import poll_until
from clusterviz.comm.channel import Channel
from clusterviz.comm.placement import granted_cores
from clusterviz.comm.remote_memory import (
    LOCKS,
    RemoteMemory,
    RemoteMemoryError,
    ThreadError,
    Transfer,
    make_part_file,
    map_part_file,
    part_fault,
)
from clusterviz.comm.window import BOARDS, ROW_NUMBERS, Numbers, TicketWindow, WindowError, check_index, check_sizes

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


class MpiWindow(TicketWindow):
    """Shared memory of one node, as one rank sees it.

    `comm`: the ranks of the node; `members`: their ranks in the channel; `part_bytes`: size of each member's part.
    """

    def __init__(self, mpi: Any, comm: Any, members: tuple[int, ...], part_bytes: Sequence[int]) -> None:
        self._comm, index = comm, int(comm.rank)
        board_bytes = BOARDS * len(members) * ROW_NUMBERS * 8
        sizes = [
            _whole_pages(size) + (0 if index else _whole_pages(board_bytes)) for index, size in enumerate(part_bytes)
        ]
        # A library may begin segments within a page: one more page allows for alignment.
        info = mpi.Info.Create({"alloc_shared_noncontig": "true"})
        self._window = mpi.Win.Allocate_shared(sizes[index] + mmap.PAGESIZE, 1, info, comm)
        info.Free()
        # MPI_Win_sync needs an access epoch.
        self._window.Lock_all(mpi.MODE_NOCHECK)
        segments = [self._segment(index)[:size] for index, size in enumerate(sizes)]
        ends = zip(segments, part_bytes, strict=True)
        parts = [segment[segment.size - _whole_pages(size) :][:size] for segment, size in ends]
        boards = segments[0][:board_bytes].view(np.int64).reshape(BOARDS, len(members), ROW_NUMBERS)
        super().__init__(members, index, parts, boards)
        self._tickets = [[memoryview(row[:1]) for row in board] for board in self._boards]
        self._spin_calls = _SPIN_CALLS if len(members) <= len(granted_cores()) else 0
        self._sync = self._window.Sync
        self._mine = segments[index]

    def touch(self) -> None:
        """Fill the own segment with zeros, before any member's first `exchange`; OSError if memory is missing."""
        fill_with_zeros(self._mine)

    def _segment(self, index: int) -> NDArray[np.uint8]:
        """Return a member's segment from its first whole page on."""
        memory, _ = self._window.Shared_query(index)
        data = np.frombuffer(memory, np.uint8)
        return data[-data.ctypes.data % mmap.PAGESIZE :]

    def _meet(self, rows: Numbers, ticket: int) -> None:
        tickets = self._tickets[ticket % BOARDS]
        self._sync()
        tickets[self.index][0] = ticket
        for raised in tickets:
            if raised[0] != ticket:
                self._wait(raised, ticket)
        self._sync()

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
        self._window.Unlock_all()
        self._window.Free()


def open_remote_memory(mpi: Any, comm: Any, channel: Channel, own_bytes: int, folder: Path | None) -> RemoteMemory:
    """Make remote memory of the channel's ranks, with `own_bytes` bytes of this rank; collective, as its errors."""
    place = channel.placement()
    told = channel.allgather_numbers([own_bytes, place.node])
    check_sizes(told[:, 0].tolist())
    members = next(node for node in channel.nodes() if channel.rank in node)
    sizes = told[:, 0].tolist()
    if folder is None:
        needed = int(told[told[:, 1] == place.node, 0].sum())
        check_faults(channel, space_fault(needed) if place.local_size > 1 else "", RemoteMemoryError)
        mapped: dict[int, NDArray[np.uint8]] = {}
    else:
        mapped = _file_views(channel, folder, members, sizes)
    window, fault = None, ""
    try:
        if folder is None:
            window = mpi.Win.Allocate(own_bytes, 1, comm=comm)
            mapped = _shared_views(mpi, window, comm.rank, members, sizes)
            fill_with_zeros(mapped[comm.rank])
        else:
            window = mpi.Win.Create(mapped[comm.rank], 1, comm=comm)
    except mpi.Exception as error:
        fault = str(error).splitlines()[0]
    except OSError as error:
        fault = part_fault(error, own_bytes, folder)
    check_faults(channel, fault, RemoteMemoryError)
    assert window is not None
    return RemoteMemory(channel.rank, MpiParts(mpi, window, mapped, channel.barrier), channel.counters(2 * LOCKS))


def _shared_views(
    mpi: Any, window: Any, rank: int, members: Sequence[int], sizes: Sequence[int]
) -> dict[int, NDArray[np.uint8]]:
    views = {rank: np.frombuffer(window.tomemory(), np.uint8)[: sizes[rank]]}
    for member in members:
        if member != rank:
            try:
                data = np.frombuffer(window.Shared_query(member)[0], np.uint8)
            except mpi.Exception:  # a library before MPI 4.1
                continue
            if data.size >= sizes[member]:
                views[member] = data[: sizes[member]]
    return views


def _file_views(
    channel: Channel, folder: Path, members: Sequence[int], sizes: Sequence[int]
) -> dict[int, NDArray[np.uint8]]:
    """Make a file for the own part and map those of all members; collective. The files have no names on return."""
    path, fault = None, ""
    try:
        path = make_part_file(folder, sizes[channel.rank])
    except OSError as error:
        fault = part_fault(error, sizes[channel.rank], folder)
    try:
        check_faults(channel, fault, RemoteMemoryError)
        paths = channel.allgather(path)
        views = {member: map_part_file(Path(str(paths[member])), sizes[member]) for member in members}
        channel.barrier()
    finally:
        if path is not None:
            path.unlink()
    return views


class MpiParts:
    """Parts of all ranks in an MPI window with displacements in bytes; `views` are those that are mapped, by rank."""

    def __init__(self, mpi: Any, window: Any, views: dict[int, NDArray[np.uint8]], barrier: Callable[[], None]) -> None:
        self._mpi, self._window, self._views, self._barrier = mpi, window, views, barrier
        self._thread = None if mpi.Query_thread() >= mpi.THREAD_MULTIPLE else threading.get_ident()
        window.Lock_all()
        # Zeros of all ranks are there before the first access.
        self.sync()

    def view(self, rank: int) -> NDArray[np.uint8] | None:
        return self._views.get(rank)

    def check_thread(self) -> None:
        """Check that MPI serves several threads, or that this is the thread that made the window."""
        if self._thread not in (None, threading.get_ident()):
            raise ThreadError

    def fetch(self, transfers: Sequence[Transfer]) -> None:
        """Read by MPI_Get, all boxes at once."""
        received = [np.empty(values.shape, values.dtype) for _, values in transfers]
        self._move(self._window.Get, transfers, received)
        for (_, values), data in zip(transfers, received, strict=True):
            np.copyto(values, data)

    def store(self, transfers: Sequence[Transfer]) -> None:
        """Write by MPI_Put, all boxes at once."""
        self._move(self._window.Put, transfers, [np.ascontiguousarray(values) for _, values in transfers])

    def _move(self, call: Callable[..., None], transfers: Sequence[Transfer], data: Sequence[NDArray[Any]]) -> None:
        """Start a call for each box that is not empty, and wait until all are complete at their owners."""
        byte, types = self._mpi.BYTE, []
        for (box, _), values in zip(transfers, data, strict=True):
            if not values.size:
                continue
            # A box of bytes: those of an element are its last axis.
            size = values.itemsize
            shape, begin, inside = (*box.shape, size), (*box.begin, 0), (*values.shape, size)
            kind = byte.Create_subarray(shape, inside, begin).Commit()
            types.append(kind)
            call([values, values.nbytes, byte], box.rank, [box.offset, 1, kind])
        for rank in sorted({box.rank for box, _ in transfers}):
            self._window.Flush(rank)
        for kind in types:
            kind.Free()

    def fence(self) -> None:
        """Order accesses to memory by MPI_Win_sync."""
        self._window.Sync()

    def sync(self) -> None:
        """Complete what this rank wrote, and wait for all ranks."""
        self._window.Flush_all()
        self._window.Sync()
        self._barrier()
        self._window.Sync()

    def free(self) -> None:
        self._views.clear()
        self._window.Unlock_all()
        self._window.Free()
