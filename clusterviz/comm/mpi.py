"""A channel over MPI: the only module that imports mpi4py.

mpi4py initialises MPI when it is first imported, so the import waits until a channel is asked for. One thread at a
time talks (MPI_THREAD_SERIALIZED). The communicator is duplicated, so that no message meets those of the caller.

A message longer than a chunk (1 GiB) travels in pieces, because an MPI before version 4 counts bytes in 31 bits. The
last piece is the first one that is shorter than a chunk (empty, if need be): the receiver needs to know no sizes.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agreed import mark_agreed
from clusterviz.comm.channel import Buffer, Pending, as_bytes
from clusterviz.comm.mpi_window import MpiWindow
from clusterviz.comm.nodes import RANKS_PER_NODE_VARIABLE, Nodes, group_by_node, ranks_per_node
from clusterviz.comm.patience import ask_until
from clusterviz.comm.place import NodePlace, core_share, granted_cores
from clusterviz.comm.window import Numbers, WindowError, check_sizes

if TYPE_CHECKING:
    from mpi4py import MPI

T = TypeVar("T")
CHUNK_BYTES = 1 << 30
_LAST_WORDS_SECONDS = 0.2


@dataclass
class _Receive:
    """A receive under way: the request of its present chunk, and what has arrived before."""

    buffer: NDArray[np.uint8]
    source: int
    tag: int
    request: Any
    received: int = 0


def _load_mpi() -> Any:
    """The MPI module, initialised no higher than needed where nobody has done so before."""
    if "mpi4py.MPI" not in sys.modules:
        import mpi4py

        mpi4py.rc.thread_level = "serialized"
    from mpi4py import MPI

    return MPI


class MpiChannel:
    """One rank of an MPI communicator.

    Parameters
    ----------
    comm : the communicator to duplicate; all processes of the job where None is given
    chunk_bytes : the longest single MPI message
    """

    def __init__(self, comm: MPI.Comm | None = None, *, chunk_bytes: int = CHUNK_BYTES) -> None:
        self._mpi = _load_mpi()
        self._comm = (comm or self._mpi.COMM_WORLD).Dup()
        self._chunk_bytes = chunk_bytes
        self._sends: list[Any] = []
        self._place: NodePlace | None = None
        self._nodes: Nodes | None = None

    @property
    def rank(self) -> int:
        """This rank."""
        return int(self._comm.rank)

    @property
    def size(self) -> int:
        """The number of ranks."""
        return int(self._comm.size)

    def close(self) -> None:
        """Free the duplicated communicator (collective)."""
        self._comm.Free()

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        """Start to receive the first chunk."""
        receive = _Receive(as_bytes(buffer), source, tag, None)
        self._receive_chunk(receive)
        return receive

    def _receive_chunk(self, receive: _Receive) -> None:
        room = receive.buffer[receive.received : receive.received + self._chunk_bytes]
        receive.request = self._comm.Irecv([room, self._mpi.BYTE], receive.source, receive.tag)

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        """Start to send all chunks."""
        data = as_bytes(buffer)
        for begin in range(0, data.size + 1, self._chunk_bytes):
            chunk = data[begin : begin + self._chunk_bytes]
            self._sends.append(self._comm.Isend([chunk, self._mpi.BYTE], target, tag))

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Wait for a whole message; a full chunk posts the receive of the next."""
        receives = cast(Sequence[_Receive], pending)
        finished: list[tuple[int, int]] = []
        while not finished:
            statuses = [self._mpi.Status() for _ in receives]
            requests = [receive.request for receive in receives]
            done = ask_until(lambda r=requests, s=statuses: self._mpi.Request.Testsome(r, s))  # type: ignore[misc]
            for index, status in zip(done, statuses, strict=False):
                receive, count = receives[index], status.Get_count(self._mpi.BYTE)
                receive.received += count
                if count == self._chunk_bytes:
                    self._receive_chunk(receive)
                else:
                    finished.append((index, receive.received))
        return finished

    def wait_sends(self) -> None:
        """Wait for all chunks sent so far."""
        self._finish(self._sends)
        self._sends.clear()

    def _finish(self, requests: list[Any]) -> None:
        ask_until(lambda: self._mpi.Request.Testall(requests))

    def allgather(self, value: T) -> list[T]:
        """One value from each rank."""
        mine = np.frombuffer(pickle.dumps(value), np.uint8)
        sizes = np.zeros(self.size, np.int64)
        self._finish([self._comm.Iallgather(np.array([mine.size], np.int64), sizes)])
        everything = np.empty(sizes.sum(), np.uint8)
        self._finish([self._comm.Iallgatherv(mine, [everything, sizes.tolist()])])
        parts = np.split(everything, np.cumsum(sizes)[:-1])
        return [cast(T, pickle.loads(part.tobytes())) for part in parts]

    def allgather_numbers(self, values: Sequence[int] | Numbers) -> Numbers:
        """Few numbers from each rank: one call, no pickle."""
        mine = np.ascontiguousarray(values, np.int64)
        everything = np.empty((self.size, mine.size), np.int64)
        self._finish([self._comm.Iallgather(mine, everything)])
        return everything

    def gather(self, value: T, root: int = 0) -> list[T] | None:
        """One value from each rank, on the root."""
        values = self.allgather(value)
        return values if self.rank == root else None

    def broadcast(self, value: T, root: int = 0) -> T:
        """The root's value."""
        data = np.frombuffer(pickle.dumps(value if self.rank == root else None), np.uint8)
        size = np.array([data.size], np.int64)
        self._finish([self._comm.Ibcast(size, root)])
        received = data.copy() if self.rank == root else np.empty(size[0], np.uint8)
        self._finish([self._comm.Ibcast(received, root)])
        return value if self.rank == root else cast(T, pickle.loads(received.tobytes()))

    def maximum(self, value: int) -> int:
        """The largest value: one reduction of eight bytes."""
        largest = np.empty(1, np.int64)
        self._finish([self._comm.Iallreduce(np.array([value], np.int64), largest, self._mpi.MAX)])
        return int(largest[0])

    def barrier(self) -> None:
        """Wait for all ranks."""
        self._finish([self._comm.Ibarrier()])

    def place(self) -> NodePlace:
        """Found by splitting the communicator into groups that can share memory; collective on the first call."""
        if self._place is None:
            node = self._comm.Split_type(self._mpi.COMM_TYPE_SHARED)
            cores = core_share(node.rank, node.allgather(granted_cores()))
            first = node.bcast(self.rank)
            firsts = sorted(set(self.allgather(first)))
            host = self._mpi.Get_processor_name()
            self._place = NodePlace(host, node.rank, node.size, firsts.index(first), len(firsts), cores)
            node.Free()
        return self._place

    def nodes(self) -> Nodes:
        """Found by splitting the communicator; collective on the first call. Rank 0's environment counts for all."""
        if self._nodes is None:
            ranks_each = ranks_per_node(self.broadcast(os.environ.get(RANKS_PER_NODE_VARIABLE)))
            node = self._comm.Split_type(self._mpi.COMM_TYPE_SHARED, self.rank)
            first = node.bcast(self.rank)
            node.Free()
            self._nodes = group_by_node(self.allgather_numbers([first])[:, 0].tolist(), ranks_each)
        return self._nodes

    def window(self, bytes_per_rank: int) -> MpiWindow:
        """An MPI-3 window on each node."""
        check_sizes(self.allgather_numbers([bytes_per_rank])[:, 0].tolist())
        number, members = next((i, node) for i, node in enumerate(self.nodes()) if self.rank in node)
        node = self._comm.Split(number, self.rank)
        window: MpiWindow | None = None
        fault = ""
        try:
            window = MpiWindow(self._mpi, node, members, bytes_per_rank)
            window.touch()
        except (self._mpi.Exception, OSError) as error:
            fault = (str(error) or type(error).__name__).splitlines()[0]
        # Also the barrier after which all boards are zero.
        reports = self.allgather((window is not None, fault))
        faults = [f"rank {rank}: {text}" for rank, (_, text) in enumerate(reports) if text]
        if window is None or faults:
            if window is not None and all(reports[member][0] for member in members):
                window.free()
            raise mark_agreed(WindowError(faults[0]))
        return window

    def abort(self, status: int) -> None:
        """MPI_Abort: ends every process of the job, this one at once."""
        sys.stdout.flush()
        sys.stderr.flush()
        # A launcher may throw away what it has not yet read from its ranks when it learns of the end.
        time.sleep(_LAST_WORDS_SECONDS)
        self._mpi.COMM_WORLD.Abort(status)
        # Some libraries return from it and wait to be killed; nothing more shall be said meanwhile.
        os._exit(status)
