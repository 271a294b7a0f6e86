"""A channel over MPI: the only module that imports mpi4py.

MPI is loaded and started when a channel is first asked for. One thread at a time talks through a channel; several
threads, each through its own, only where MPI was started for that (MPI_THREAD_MULTIPLE), which it is if the first
channel is asked for with `several_threads`. The communicator is duplicated, so that no message meets those of the
caller.

A message longer than a chunk (1 GiB) travels in pieces, because an MPI before version 4 counts bytes in 31 bits. The
last piece is the first one that is shorter than a chunk (empty, if need be): the receiver needs to know no sizes.
"""

from __future__ import annotations

import functools
import os
import pickle
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from clusterviz.comm.channel import Buffer, MessageError, Pending, as_bytes, check_contiguous
from clusterviz.comm.library import check_launcher
from clusterviz.comm.mpi_counters import MpiCounters
from clusterviz.comm.mpi_window import MpiWindow, open_window
from clusterviz.comm.nodes import RANKS_PER_NODE_VARIABLE, Nodes, group_by_node, ranks_per_node
from clusterviz.comm.patience import ask_until
from clusterviz.comm.place import NodePlace, core_share, granted_cores
from clusterviz.comm.window import Numbers

if TYPE_CHECKING:
    from mpi4py import MPI

T = TypeVar("T")
CHUNK_BYTES = 1 << 30
_LAST_WORDS_SECONDS = 0.2


@dataclass(slots=True)
class _Receive:
    """A receive under way: the request of its present chunk, and what has arrived before."""

    buffer: Buffer
    source: int
    tag: int
    request: Any
    received: int = 0


def _load_mpi(several_threads: bool = False) -> Any:
    """The MPI module, started for no more threads than needed where nobody has done so before.

    Raises
    ------
    InputError
        A launcher of another MPI started this process, and MPI_Init would not return.
    """
    if "mpi4py.MPI" not in sys.modules:
        import mpi4py

        mpi4py.rc.initialize, mpi4py.rc.finalize = False, True
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of another MPI's launcher: `check_launcher` says it better
        from mpi4py import MPI

        if not MPI.Is_initialized():
            check_launcher(MPI.Get_library_version(), None)
            MPI.Init_thread(MPI.THREAD_MULTIPLE if several_threads else MPI.THREAD_SERIALIZED)
            handler = signal.getsignal(signal.SIGHUP)
            if handler is not None and threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGHUP, handler)  # UCX has taken it, and would wait for a debugger
    return MPI


def _unlink_segments() -> None:
    """Take the names from MPICH's shared memory, which all ranks have mapped by now: if killed, they leave no file."""
    with suppress(OSError):  # no /proc
        mapped = re.findall(r"(/dev/shm/mpich_shm_\w+)$", Path("/proc/self/maps").read_text(), re.MULTILINE)
        for name in set(mapped):
            Path(name).unlink(missing_ok=True)


@functools.cache
def _channel_key() -> int:
    """Under which MPI keeps the channel of a communicator; duplicates of a communicator do not inherit it."""
    mpi = _load_mpi()
    return int(mpi.Comm.Create_keyval(delete_fn=lambda comm, key, channel: channel.close()))


class MpiChannel:
    """One rank of an MPI communicator.

    Parameters
    ----------
    comm : the communicator to duplicate; all processes of the job where None is given
    chunk_bytes : the longest single MPI message
    several_threads : whether other threads may talk too; where MPI runs already, it stays as it is
    """

    def __init__(
        self, comm: MPI.Comm | None = None, *, chunk_bytes: int = CHUNK_BYTES, several_threads: bool = False
    ) -> None:
        self._mpi = _load_mpi(several_threads)
        self._comm = (comm or self._mpi.COMM_WORLD).Dup()
        if comm is None:  # all ranks are here now
            _unlink_segments()
        self._byte = self._mpi.BYTE
        self._chunk_bytes = chunk_bytes
        # Kept from call to call: a status object costs more than asking.
        self._statuses: list[Any] = []
        self._sends: list[Any] = []
        self._beside: MpiChannel | None = None
        self._place: NodePlace | None = None
        self._nodes: Nodes | None = None

    @classmethod
    def of(cls, comm: MPI.Comm) -> MpiChannel:
        """The one channel of a communicator: made by the first call (collective), freed with the communicator."""
        key = _channel_key()
        found = comm.Get_attr(key)
        if found is None:
            found = cls(comm)
            comm.Set_attr(key, found)
        return cast(MpiChannel, found)

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
        if self._beside is not None:
            self._beside.close()
        self._comm.Free()

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        """Start to receive the first chunk."""
        if buffer.nbytes > self._chunk_bytes:
            receive = _Receive(as_bytes(buffer), source, tag, None)
            self._receive_chunk(receive)
            return receive
        check_contiguous(buffer)
        return _Receive(buffer, source, tag, self._comm.Irecv((buffer, self._byte), source, tag))

    def _receive_chunk(self, receive: _Receive) -> None:
        room = as_bytes(receive.buffer)[receive.received : receive.received + self._chunk_bytes]
        receive.request = self._comm.Irecv((room, self._byte), receive.source, receive.tag)

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        """Start to send all chunks."""
        if buffer.nbytes < self._chunk_bytes:
            check_contiguous(buffer)
            self._sends.append(self._comm.Isend((buffer, self._byte), target, tag))
            return
        data = as_bytes(buffer)
        for begin in range(0, data.size + 1, self._chunk_bytes):
            chunk = data[begin : begin + self._chunk_bytes]
            self._sends.append(self._comm.Isend((chunk, self._byte), target, tag))

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Wait for a whole message; a full chunk posts the receive of the next."""
        receives = cast(Sequence[_Receive], pending)
        finished: list[tuple[int, int]] = []
        while receives and not finished:
            finished = self._finished(receives, self._arrived(receives))
        return finished

    def _finished(self, receives: Sequence[_Receive], arrived: Sequence[int]) -> list[tuple[int, int]]:
        """Of the chunks that have arrived, those that end a message; the others have their next ones received."""
        finished = []
        for index, status in zip(arrived, self._statuses, strict=False):
            receive, count = receives[index], status.Get_count(self._byte)
            receive.received += count
            if count == self._chunk_bytes:
                self._receive_chunk(receive)
            else:
                finished.append((index, receive.received))
        return finished

    def test_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Whole messages that are here; sends that are over are forgotten."""
        self._sends = [request for request in self._sends if not request.Test()]
        receives = cast(Sequence[_Receive], pending)
        return self._finished(receives, self._tested(receives)) if receives else []

    def _arrived(self, receives: Sequence[_Receive]) -> list[int]:
        """Wait for a chunk: which have arrived; as many statuses tell of them."""
        return self._tested(receives) or ask_until(lambda: self._tested(receives))

    def _tested(self, receives: Sequence[_Receive]) -> list[int]:
        """Which chunks have arrived by now."""
        requests, statuses = [receive.request for receive in receives], self._statuses
        while len(statuses) < len(requests):
            statuses.append(self._mpi.Status())
        try:
            done = self._mpi.Request.Testsome(requests, statuses)
        except self._mpi.Exception as error:
            raise self._message_error(receives, error) from None
        return cast(list[int], done or [])

    def _message_error(self, receives: Sequence[_Receive], error: Any) -> MessageError:
        """Which message went wrong, and how, in words without the library's own stack."""
        bad = next((status for status in self._statuses if status.error != self._mpi.SUCCESS), None)
        code = error if bad is None else self._mpi.Exception(bad.error)
        if bad is None or code.Get_error_class() != self._mpi.ERR_TRUNCATE:
            return MessageError(f"rank {self.rank} cannot receive ({str(code).splitlines()[0]})")
        rooms = [each.buffer.nbytes for each in receives if (each.source, each.tag) == (bad.source, bad.tag)]
        return MessageError.too_long(bad.source, bad.tag, rooms[0])

    def wait_sends(self) -> None:
        """Wait for all chunks sent so far."""
        if self._sends:
            self._finish(self._sends)
            self._sends.clear()

    def _finish(self, requests: list[Any]) -> None:
        testall = self._mpi.Request.Testall
        if not testall(requests):
            ask_until(lambda: testall(requests))

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
        # Named, to last until the end: mpi4py 4.1 keeps no reference to what Iallreduce and Iallgatherv send, and where
        # the library reads it late (Open MPI), memory that is used again gives wrong values.
        mine, largest = np.array([value], np.int64), np.empty(1, np.int64)
        self._finish([self._comm.Iallreduce(mine, largest, self._mpi.MAX)])
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

    def window(self, own_bytes: int) -> MpiWindow:
        """An MPI-3 window on each node."""
        return open_window(self._mpi, self._comm, self, own_bytes)

    def counters(self, count: int) -> MpiCounters:
        """Numbers in rank 0's memory."""
        return MpiCounters(self._mpi, self._comm, count, self.barrier)

    def for_thread(self) -> MpiChannel | None:
        """A duplicate of the communicator, whose messages never meet this one's; freed with it."""
        if self._beside is None and not self.maximum(self._mpi.Query_thread() < self._mpi.THREAD_MULTIPLE):
            self._beside = MpiChannel(self._comm, chunk_bytes=self._chunk_bytes)
        return self._beside

    def beside(self) -> MpiChannel:
        """A duplicate of the communicator."""
        return MpiChannel(self._comm, chunk_bytes=self._chunk_bytes)

    def abort(self, status: int) -> None:
        """MPI_Abort: ends every process of the job, this one at once."""
        sys.stdout.flush()
        sys.stderr.flush()
        # A launcher may throw away what it has not yet read from its ranks when it learns of the end.
        time.sleep(_LAST_WORDS_SECONDS)
        self._mpi.COMM_WORLD.Abort(status)
        # Some libraries return from it and wait to be killed; nothing more shall be said meanwhile.
        os._exit(status)
