"""Channel between threads of one process: for tests, and with one rank for work without MPI.

Buffers are copied when received, not when sent, as MPI does with large messages, so tests find the same faults. A rank
that raises ends all ranks. A rank that waits longer than the time-out raises TimeoutError.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agree import check_faults
from clusterviz.comm.channel import Buffer, MessageError, Pending, as_bytes
from clusterviz.comm.placement import Nodes, Placement, group_by_node, single_placement
from clusterviz.comm.remote_memory import (
    LOCKS,
    RemoteMemory,
    RemoteMemoryError,
    Transfer,
    make_part_file,
    map_part_file,
    part_fault,
)
from clusterviz.comm.window import BOARDS, ROW_NUMBERS, Numbers, TicketWindow, check_index, check_sizes

T = TypeVar("T")


class _EndedError(Exception):
    """Another rank has failed; raised in the ranks that wait for it."""


@dataclass
class _Receive:
    buffer: NDArray[np.uint8]
    source: int
    tag: int


@dataclass
class _World:
    """State that the ranks share, guarded by `changed`."""

    size: int
    timeout_seconds: float
    ranks_per_node: int | None = None
    changed: threading.Condition = field(default_factory=threading.Condition)
    sent: dict[tuple[int, int, int], deque[NDArray[np.uint8]]] = field(default_factory=dict)
    unread: list[int] = field(default_factory=list)
    offered: dict[int, dict[int, Any]] = field(default_factory=dict)
    taken: dict[int, int] = field(default_factory=dict)
    failed: bool = False
    duplicates: list[_World] = field(default_factory=list)

    def wait(self, ready: Callable[[], bool], what: str) -> None:
        """Wait (with `changed` held) until `ready` holds, a rank has failed, or the time-out has passed."""
        if not self.changed.wait_for(lambda: self.failed or ready(), self.timeout_seconds):
            raise TimeoutError(f"no progress for {self.timeout_seconds} s: {what}")
        if self.failed and not ready():
            raise _EndedError

    def fail(self) -> None:
        """Wake every rank so that it ends."""
        with self.changed:
            self.failed = True
            self.changed.notify_all()
        for other in self.duplicates:
            other.fail()

    def duplicate(self) -> _World:
        """Return another world of the same ranks, which ends with this one."""
        other = _World(self.size, self.timeout_seconds, self.ranks_per_node, unread=[0] * self.size)
        with self.changed:
            self.duplicates.append(other)
        return other


class LoopbackWindow(TicketWindow):
    """Shared memory of a simulated node, in plain arrays, as one thread sees it."""

    def __init__(
        self, world: _World, members: tuple[int, ...], index: int, parts: Sequence[NDArray[np.uint8]], boards: Numbers
    ) -> None:
        super().__init__(members, index, parts, boards)
        self._world = world

    def _meet(self, rows: Numbers, ticket: int) -> None:
        with self._world.changed:
            rows[self.index, 0] = ticket
            self._world.changed.notify_all()
            self._world.wait(
                lambda: bool((rows[:, 0] == ticket).all()), f"rank {self.members[self.index]} waits in a window"
            )

    def free(self) -> None:
        """Wait until no member reads any longer, and release the memory."""
        self.exchange(())
        self._parts.clear()


class LoopbackParts:
    """Parts of threads: arrays of one process, which all of them see, and whose accesses the locks of Python order."""

    def __init__(self, parts: Sequence[NDArray[np.uint8]], barrier: Callable[[], None]) -> None:
        self._parts, self._barrier = list(parts), barrier

    def view(self, rank: int) -> NDArray[np.uint8]:
        return self._parts[rank]

    def check_thread(self) -> None:
        """Do nothing: every thread may communicate."""

    def fetch(self, transfers: Sequence[Transfer]) -> None:
        """Do nothing: every part has a view."""

    def store(self, transfers: Sequence[Transfer]) -> None:
        """Do nothing: every part has a view."""

    def fence(self) -> None:
        """Do nothing: the locks order accesses."""

    def sync(self) -> None:
        self._barrier()

    def free(self) -> None:
        """Wait until no rank reads any longer, and release the memory."""
        self._barrier()
        self._parts.clear()


class LoopbackCounters:
    """Counters of threads: a list that all ranks share, guarded by `changed`."""

    def __init__(self, changed: threading.Condition, numbers: list[int], barrier: Callable[[], None]) -> None:
        self._changed, self._numbers, self._barrier = changed, numbers, barrier

    def add(self, index: int, amount: int) -> int:
        check_index(index, len(self._numbers))
        with self._changed:
            before = self._numbers[index]
            self._numbers[index] += amount
        return before

    def reset(self) -> None:
        """Set all counters to 0, between two barriers."""
        self._barrier()
        with self._changed:
            self._numbers[:] = [0] * len(self._numbers)
        self._barrier()

    def free(self) -> None:
        """Wait for all ranks; there is nothing to release."""
        self._barrier()


class LoopbackChannel:
    """Channel of one thread; `LoopbackChannel()` is the channel of a single rank."""

    def __init__(self, world: _World | None = None, rank: int = 0) -> None:
        self._world = world or _World(1, 60.0, unread=[0])
        self._rank = rank
        self._calls = 0

    @property
    def rank(self) -> int:
        return self._rank

    @property
    def size(self) -> int:
        return self._world.size

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        return _Receive(as_bytes(buffer), source, tag)

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        world = self._world
        with world.changed:
            world.sent.setdefault((self._rank, target, tag), deque()).append(as_bytes(buffer))
            world.unread[self._rank] += 1
            world.changed.notify_all()

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Wait for a message, and copy every one that has arrived."""
        world, receives = self._world, cast(Sequence[_Receive], pending)
        with world.changed:
            if receives:
                tags = [(each.source, each.tag) for each in receives]
                world.wait(lambda: bool(self._arrived(receives)), f"rank {self._rank} waits for {tags}")
            return self._take_arrived(receives)

    def test_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        with self._world.changed:
            return self._take_arrived(cast(Sequence[_Receive], pending))

    def _arrived(self, receives: Sequence[_Receive]) -> list[int]:
        sent = self._world.sent
        return [index for index, each in enumerate(receives) if sent.get((each.source, self._rank, each.tag))]

    def _take_arrived(self, receives: Sequence[_Receive]) -> list[tuple[int, int]]:
        done = [(index, self._take(receives[index])) for index in self._arrived(receives)]
        self._world.changed.notify_all()
        return done

    def _take(self, receive: _Receive) -> int:
        data = self._world.sent[receive.source, self._rank, receive.tag].popleft()
        if data.size > receive.buffer.size:
            raise MessageError.too_long(receive.source, receive.tag, receive.buffer.size)
        receive.buffer[: data.size] = data
        self._world.unread[receive.source] -= 1
        return data.size

    def wait_sends(self) -> None:
        world = self._world
        with world.changed:
            world.wait(lambda: world.unread[self._rank] == 0, f"rank {self._rank} waits for its sends")

    def allgather(self, value: T) -> list[T]:
        """Return one value of each rank; the objects are shared, not copied."""
        world = self._world
        call, self._calls = self._calls, self._calls + 1
        with world.changed:
            offered = world.offered.setdefault(call, {})
            offered[self._rank] = value
            world.changed.notify_all()
            world.wait(lambda: len(offered) == world.size, f"rank {self._rank} waits in a collective call")
            world.taken[call] = world.taken.get(call, 0) + 1
            if world.taken[call] == world.size:
                del world.offered[call], world.taken[call]
        return [offered[rank] for rank in range(world.size)]

    def allgather_numbers(self, values: Sequence[int] | Numbers) -> Numbers:
        return np.stack(self.allgather(np.array(values, np.int64)))

    def gather(self, value: T, root: int = 0) -> list[T] | None:
        values = self.allgather(value)
        return values if self._rank == root else None

    def broadcast(self, value: T, root: int = 0) -> T:
        return self.allgather(value)[root]

    def maximum(self, value: int) -> int:
        return max(self.allgather(value))

    def barrier(self) -> None:
        self.allgather(None)

    def placement(self) -> Placement:
        """Return the placement on one node that all ranks share."""
        return single_placement(self._rank, self.size)

    def nodes(self) -> Nodes:
        """Return one node, or simulated nodes of `ranks_per_node` ranks."""
        return group_by_node([0] * self.size, self._world.ranks_per_node)

    def window(self, own_bytes: int) -> LoopbackWindow:
        """Allocate a part on each rank, and the boards on each node's first member."""
        check_sizes(self.allgather(own_bytes))
        members = next(node for node in self.nodes() if self._rank in node)
        boards = np.zeros((BOARDS, len(members), ROW_NUMBERS), np.int64)
        brought = self.allgather((np.zeros(own_bytes, np.uint8), boards))
        parts = [brought[member][0] for member in members]
        return LoopbackWindow(self._world, members, members.index(self._rank), parts, brought[members[0]][1])

    def remote_memory(self, own_bytes: int, folder: Path | None = None) -> RemoteMemory:
        check_sizes(self.allgather(own_bytes))
        part, fault = np.empty(0, np.uint8), ""
        try:
            if folder is None:
                part = np.zeros(own_bytes, np.uint8)
            else:
                path = make_part_file(folder, own_bytes)
                part = map_part_file(path, own_bytes)
                path.unlink()
        except (MemoryError, OSError) as error:
            fault = part_fault(error, own_bytes, folder)
        check_faults(self, fault, RemoteMemoryError)
        parts = LoopbackParts(self.allgather(part), self.barrier)
        return RemoteMemory(self._rank, parts, self.counters(2 * LOCKS))

    def counters(self, count: int) -> LoopbackCounters:
        """Create counters in a list of rank 0 that all ranks share."""
        return LoopbackCounters(self._world.changed, self.broadcast([0] * count), self.barrier)

    def for_thread(self) -> LoopbackChannel:
        return LoopbackChannel(self.broadcast(self._world.duplicate() if self._rank == 0 else None), self._rank)

    def duplicate(self) -> LoopbackChannel:
        return self.for_thread()

    def close(self) -> None:
        """Do nothing: the channel holds only Python objects."""

    def abort(self, status: int) -> None:
        """Do nothing: the error itself ends the ranks, which share this process."""


def run_loopback(
    ranks: int,
    function: Callable[[LoopbackChannel], T],
    *,
    timeout_seconds: float = 30.0,
    ranks_per_node: int | None = None,
) -> list[T]:
    """Run a function on `ranks` ranks, one thread each, on simulated nodes of `ranks_per_node` ranks.

    Returns the function's values by rank, or raises the error of the lowest rank that failed; TimeoutError if ranks
    wait for each other without end.
    """
    world = _World(ranks, timeout_seconds, ranks_per_node, unread=[0] * ranks)
    results: list[Any] = [None] * ranks
    errors: dict[int, BaseException] = {}

    def run(rank: int) -> None:
        try:
            results[rank] = function(LoopbackChannel(world, rank))
        except _EndedError:
            pass
        except BaseException as error:
            errors[rank] = error
            world.fail()

    threads = [threading.Thread(target=run, args=(rank,), daemon=True) for rank in range(ranks)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[min(errors)]
    return results
