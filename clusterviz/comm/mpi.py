"""Channel over MPI.

MPI is loaded and started when the first channel is opened. One thread at a time uses a channel. Several threads, each
with its own channel, need MPI_THREAD_MULTIPLE, which the first channel requests with `several_threads`. The
communicator is duplicated, so that messages never match those of the caller.

A message longer than a chunk (1 GiB) is sent in chunks, because MPI before version 4 counts bytes in 31 bits. The last
chunk is the first that is shorter than a full one (possibly empty), so the receiver needs no sizes.
"""

from __future__ import annotations

import functools
import os
import pickle
import re
import resource
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

from clusterviz.comm.back_off import poll_until
from clusterviz.comm.channel import Buffer, MessageError, Pending, as_bytes, check_contiguous
from clusterviz.comm.library import check_launcher
from clusterviz.comm.mpi_window import MpiCounters, MpiWindow, open_remote_memory, open_window
from clusterviz.comm.placement import (
    RANKS_PER_NODE_VARIABLE,
    Nodes,
    Placement,
    core_share,
    granted_cores,
    group_by_node,
    parse_ranks_per_node,
)
from clusterviz.comm.remote_memory import RemoteMemory
from clusterviz.comm.window import Numbers
from clusterviz.errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI

T = TypeVar("T")
CHUNK_BYTES = 1 << 30
_LAST_WORDS_SECONDS = 0.2
LEAST_FILES = 64
"""Open files that a rank needs."""


@dataclass(slots=True)
class _Receive:
    """Receive in progress: the request of its current chunk, and the bytes received before."""

    buffer: Buffer
    source: int
    tag: int
    request: Any
    received: int = 0


def _load_mpi(several_threads: bool = False) -> Any:
    """Return the MPI module, started with the thread level needed unless MPI runs already.

    Raises InputError if a launcher of another MPI started this process, and MPI_Init would not return.
    """
    if "mpi4py.MPI" not in sys.modules:
        import mpi4py

        mpi4py.rc.initialize, mpi4py.rc.finalize = False, True
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # about another MPI's launcher: `check_launcher` reports it
        from mpi4py import MPI

        if not MPI.Is_initialized():
            check_launcher(MPI.Get_library_version(), None)
            _check_files()
            remove_segments()
            # A signal interrupts what MPI_Init reads from the launcher, which MPICH takes for the launcher's end.
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
            try:
                MPI.Init_thread(MPI.THREAD_MULTIPLE if several_threads else MPI.THREAD_SERIALIZED)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            handler = signal.getsignal(signal.SIGHUP)
            if handler is not None and threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGHUP, handler)  # UCX's handler would wait for a debugger
    return MPI


def _check_files() -> None:
    """Raise the limit of open files to `LEAST_FILES`; InputError if it cannot be: MPI_Init would end the process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if not 0 <= soft < LEAST_FILES:  # below 0: no limit
        return
    if 0 <= hard < LEAST_FILES:
        raise InputError("too few open files for MPI", where="ulimit -n", found=hard, allowed=f"{LEAST_FILES} or more")
    resource.setrlimit(resource.RLIMIT_NOFILE, (LEAST_FILES, hard))


def unlink_segments() -> None:
    """Unlink MPICH's shared-memory files that this rank has mapped: killed ranks then leave no files."""
    with suppress(OSError):  # no /proc
        mapped = re.findall(r"(/dev/shm/mpich_shm_\w+)$", Path("/proc/self/maps").read_text(), re.MULTILINE)
        for name in set(mapped):
            Path(name).unlink(missing_ok=True)


def remove_segments(folder: Path = Path("/dev/shm")) -> list[Path]:
    """Remove and return MPICH's shared-memory files of this user that are unmapped and older than a minute.

    Ranks of clusterviz unlink theirs at start-up, so leftovers are of jobs killed before that, or of other programs.
    """
    removed = []
    for path in folder.glob("mpich_shm_*"):
        with suppress(OSError):
            state = path.stat()
            if state.st_uid == os.getuid() and time.time() - state.st_mtime > 60 and not _is_mapped(path):
                path.unlink()
                removed.append(path)
    return removed


def _is_mapped(file: Path) -> bool:
    for path in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):
            if str(file) in path.read_text():
                return True
    return False


@functools.cache
def _channel_key() -> int:
    """Return the MPI attribute key of a communicator's channel; duplicates do not inherit the attribute."""
    mpi = _load_mpi()
    return int(mpi.Comm.Create_keyval(delete_fn=lambda comm, key, channel: channel.close()))


class MpiChannel:
    """Channel of one rank of an MPI communicator.

    `comm`: communicator to duplicate; by default that of all processes of the job. `chunk_bytes`: size of the longest
    single MPI message. `several_threads`: whether other threads communicate too; without effect if MPI runs already.
    """

    def __init__(
        self, comm: MPI.Comm | None = None, *, chunk_bytes: int = CHUNK_BYTES, several_threads: bool = False
    ) -> None:
        self._mpi = _load_mpi(several_threads)
        self._comm = (comm or self._mpi.COMM_WORLD).Dup()
        if comm is None:  # all ranks are here now
            unlink_segments()
        self._byte = self._mpi.BYTE
        self._chunk_bytes = chunk_bytes
        # Reused in every call: creating a status object costs more than testing a request.
        self._statuses: list[Any] = []
        self._sends: list[Any] = []
        self._thread_channel: MpiChannel | None = None
        self._placement: Placement | None = None
        self._nodes: Nodes | None = None

    @classmethod
    def of(cls, comm: MPI.Comm) -> MpiChannel:
        """Return the channel of a communicator: made by the first call (collective), freed with the communicator."""
        key = _channel_key()
        found = comm.Get_attr(key)
        if found is None:
            found = cls(comm)
            comm.Set_attr(key, found)
        return cast(MpiChannel, found)

    @property
    def rank(self) -> int:
        return int(self._comm.rank)

    @property
    def size(self) -> int:
        return int(self._comm.size)

    def close(self) -> None:
        """Free the duplicated communicator (collective)."""
        if self._thread_channel is not None:
            self._thread_channel.close()
        self._comm.Free()

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
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
        """Return the messages that the arrived chunks complete; post the next receive of the others."""
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
        """Return the whole messages that have arrived, and release completed sends."""
        self._sends = [request for request in self._sends if not request.Test()]
        receives = cast(Sequence[_Receive], pending)
        return self._finished(receives, self._tested(receives)) if receives else []

    def _arrived(self, receives: Sequence[_Receive]) -> list[int]:
        """Wait for a chunk; return the indices of the chunks that have arrived, with their statuses in order."""
        return self._tested(receives) or poll_until(lambda: self._tested(receives))

    def _tested(self, receives: Sequence[_Receive]) -> list[int]:
        requests, statuses = [receive.request for receive in receives], self._statuses
        while len(statuses) < len(requests):
            statuses.append(self._mpi.Status())
        try:
            done = self._mpi.Request.Testsome(requests, statuses)
        except self._mpi.Exception as error:
            raise self._message_error(receives, error) from None
        return cast(list[int], done or [])

    def _message_error(self, receives: Sequence[_Receive], error: Any) -> MessageError:
        """Return the error of the failed message, without the MPI library's stack trace."""
        bad = next((status for status in self._statuses if status.error != self._mpi.SUCCESS), None)
        code = error if bad is None else self._mpi.Exception(bad.error)
        if bad is None or code.Get_error_class() != self._mpi.ERR_TRUNCATE:
            return MessageError(f"rank {self.rank} cannot receive ({str(code).splitlines()[0]})")
        rooms = [each.buffer.nbytes for each in receives if (each.source, each.tag) == (bad.source, bad.tag)]
        return MessageError.too_long(bad.source, bad.tag, rooms[0])

    def wait_sends(self) -> None:
        if self._sends:
            self._finish(self._sends)
            self._sends.clear()

    def _finish(self, requests: list[Any]) -> None:
        testall = self._mpi.Request.Testall
        if not testall(requests):
            poll_until(lambda: testall(requests))

    def allgather(self, value: T) -> list[T]:
        mine = np.frombuffer(pickle.dumps(value), np.uint8)
        sizes = np.zeros(self.size, np.int64)
        self._finish([self._comm.Iallgather(np.array([mine.size], np.int64), sizes)])
        everything = np.empty(sizes.sum(), np.uint8)
        self._finish([self._comm.Iallgatherv(mine, [everything, sizes.tolist()])])
        parts = np.split(everything, np.cumsum(sizes)[:-1])
        return [cast(T, pickle.loads(part.tobytes())) for part in parts]

    def allgather_numbers(self, values: Sequence[int] | Numbers) -> Numbers:
        """Return k numbers of each rank, by one call without pickling."""
        mine = np.ascontiguousarray(values, np.int64)
        everything = np.empty((self.size, mine.size), np.int64)
        self._finish([self._comm.Iallgather(mine, everything)])
        return everything

    def gather(self, value: T, root: int = 0) -> list[T] | None:
        values = self.allgather(value)
        return values if self.rank == root else None

    def broadcast(self, value: T, root: int = 0) -> T:
        data = np.frombuffer(pickle.dumps(value if self.rank == root else None), np.uint8)
        size = np.array([data.size], np.int64)
        self._finish([self._comm.Ibcast(size, root)])
        received = data.copy() if self.rank == root else np.empty(size[0], np.uint8)
        self._finish([self._comm.Ibcast(received, root)])
        return value if self.rank == root else cast(T, pickle.loads(received.tobytes()))

    def maximum(self, value: int) -> int:
        """Return the largest value, by one reduction of eight bytes."""
        # The variable keeps the send buffer alive: mpi4py 4.1 keeps no reference to it in Iallreduce and Iallgatherv,
        # and Open MPI may read it late.
        mine, largest = np.array([value], np.int64), np.empty(1, np.int64)
        self._finish([self._comm.Iallreduce(mine, largest, self._mpi.MAX)])
        return int(largest[0])

    def barrier(self) -> None:
        self._finish([self._comm.Ibarrier()])

    def placement(self) -> Placement:
        """Return the placement, found by MPI_Comm_split_type; collective on the first call."""
        if self._placement is None:
            node = self._comm.Split_type(self._mpi.COMM_TYPE_SHARED)
            cores = core_share(node.rank, node.allgather(granted_cores()))
            first = node.bcast(self.rank)
            firsts = sorted(set(self.allgather(first)))
            host = self._mpi.Get_processor_name()
            self._placement = Placement(host, node.rank, node.size, firsts.index(first), len(firsts), cores)
            node.Free()
        return self._placement

    def nodes(self) -> Nodes:
        """Return the ranks of each node; collective on the first call. Rank 0's environment counts for all."""
        if self._nodes is None:
            ranks_each = parse_ranks_per_node(self.broadcast(os.environ.get(RANKS_PER_NODE_VARIABLE)))
            node = self._comm.Split_type(self._mpi.COMM_TYPE_SHARED, self.rank)
            first = node.bcast(self.rank)
            node.Free()
            self._nodes = group_by_node(self.allgather_numbers([first])[:, 0].tolist(), ranks_each)
        return self._nodes

    def window(self, own_bytes: int) -> MpiWindow:
        return open_window(self._mpi, self._comm, self, own_bytes)

    def remote_memory(self, own_bytes: int, folder: Path | None = None) -> RemoteMemory:
        return open_remote_memory(self._mpi, self._comm, self, own_bytes, folder)

    def counters(self, count: int) -> MpiCounters:
        """Create counters in the memory of rank 0."""
        return MpiCounters(self._mpi, self._comm, count, self.barrier)

    def for_thread(self) -> MpiChannel | None:
        """Return a duplicate of the communicator as a channel; it is freed with this one."""
        if self._thread_channel is None and not self.maximum(self._mpi.Query_thread() < self._mpi.THREAD_MULTIPLE):
            self._thread_channel = MpiChannel(self._comm, chunk_bytes=self._chunk_bytes)
        return self._thread_channel

    def duplicate(self) -> MpiChannel:
        return MpiChannel(self._comm, chunk_bytes=self._chunk_bytes)

    def abort(self, status: int) -> None:
        """End every process of the job by MPI_Abort, this one included."""
        sys.stdout.flush()
        sys.stderr.flush()
        # Some launchers drop output that they have not read when the job is aborted.
        time.sleep(_LAST_WORDS_SECONDS)
        self._mpi.COMM_WORLD.Abort(status)
        # Some libraries return from Abort and wait to be killed.
        os._exit(status)
