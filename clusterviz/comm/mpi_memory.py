"""Remote memory over MPI: windows of all ranks, whose parts on the own node are mapped.

Parts in memory are allocated by MPI_Win_allocate, which shares them between the ranks of a node where it can;
MPI_Win_shared_query (since MPI 4.1 for these windows) gives their addresses. Parts in files are mapped by all ranks of
the node, and given to MPI_Win_create for the ranks of other nodes. Where nothing is mapped (an older MPI, another
node), boxes travel by MPI_Get and MPI_Put, with a derived type for rows that are not contiguous.

Measured with MPICH 5.0 between two ranks of one node, a box of 128³ float32 in an array of 256³: MPI_Get a row took 5
to 8 times as long as a copy by NumPy, MPI_Get by a derived type 1.5 times, and NumPy's copy of the mapped part as long
as one of own memory.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agree import check_faults
from clusterviz.comm.channel import Channel
from clusterviz.comm.mpi_window import fill_with_zeros, space_fault
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
from clusterviz.comm.window import check_sizes


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
