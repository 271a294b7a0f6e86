"""All ranks in one process, one thread each: for tests, and (with one rank) for work without MPI.

Buffers are not copied when sent but when received, as a large MPI message does, so that a test meets the same faults.
A rank that raises ends all ranks; a rank that waits longer than the time-out raises TimeoutError, which ends them too.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.channel import Buffer, MessageError, Pending, as_bytes
from clusterviz.comm.loopback_counters import LoopbackCounters
from clusterviz.comm.loopback_window import LoopbackWindow, empty_boards
from clusterviz.comm.nodes import Nodes, group_by_node
from clusterviz.comm.place import NodePlace, single_place
from clusterviz.comm.window import Numbers, check_sizes

T = TypeVar("T")


class _EndedError(Exception):
    """Another rank has failed; raised in the ranks that wait for it."""


@dataclass
class _Receive:
    """A posted receive: where the bytes go, and from whom."""

    buffer: NDArray[np.uint8]
    source: int
    tag: int


@dataclass
class _World:
    """What the ranks share; `changed` guards all of it."""

    size: int
    timeout_seconds: float
    ranks_per_node: int | None = None
    changed: threading.Condition = field(default_factory=threading.Condition)
    sent: dict[tuple[int, int, int], deque[NDArray[np.uint8]]] = field(default_factory=dict)
    unread: list[int] = field(default_factory=list)
    offered: dict[int, dict[int, Any]] = field(default_factory=dict)
    taken: dict[int, int] = field(default_factory=dict)
    failed: bool = False
    others: list[_World] = field(default_factory=list)

    def wait(self, ready: Callable[[], bool], what: str) -> None:
        """Wait (with `changed` held) until something is so, a rank has failed, or the time is out."""
        if not self.changed.wait_for(lambda: self.failed or ready(), self.timeout_seconds):
            raise TimeoutError(f"no progress for {self.timeout_seconds} s: {what}")
        if self.failed and not ready():
            raise _EndedError

    def fail(self) -> None:
        """Wake every rank, to end."""
        with self.changed:
            self.failed = True
            self.changed.notify_all()
        for other in self.others:
            other.fail()

    def beside(self) -> _World:
        """Another one of the same ranks, which ends with this one."""
        other = _World(self.size, self.timeout_seconds, self.ranks_per_node, unread=[0] * self.size)
        with self.changed:
            self.others.append(other)
        return other


class LoopbackChannel:
    """One rank of a world of threads; `LoopbackChannel()` alone is a world of one rank."""

    def __init__(self, world: _World | None = None, rank: int = 0) -> None:
        self._world = world or _World(1, 60.0, unread=[0])
        self._rank = rank
        self._calls = 0

    @property
    def rank(self) -> int:
        """This rank."""
        return self._rank

    @property
    def size(self) -> int:
        """The number of ranks."""
        return self._world.size

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        """Remember where the message shall go."""
        return _Receive(as_bytes(buffer), source, tag)

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        """Offer the buffer to the target."""
        world = self._world
        with world.changed:
            world.sent.setdefault((self._rank, target, tag), deque()).append(as_bytes(buffer))
            world.unread[self._rank] += 1
            world.changed.notify_all()

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Copy every message that is here."""
        world = self._world
        receives = cast(Sequence[_Receive], pending)
        if not receives:
            return []

        def arrived() -> list[int]:
            return [i for i, r in enumerate(receives) if world.sent.get((r.source, self._rank, r.tag))]

        with world.changed:
            world.wait(lambda: bool(arrived()), f"rank {self._rank} waits for {[(r.source, r.tag) for r in receives]}")
            done = [(index, self._take(receives[index])) for index in arrived()]
            world.changed.notify_all()
        return done

    def test_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Copy every message that is here, and wait for none."""
        world, receives = self._world, cast(Sequence[_Receive], pending)
        with world.changed:
            here = [i for i, r in enumerate(receives) if world.sent.get((r.source, self._rank, r.tag))]
            done = [(index, self._take(receives[index])) for index in here]
            world.changed.notify_all()
        return done

    def _take(self, receive: _Receive) -> int:
        data = self._world.sent[receive.source, self._rank, receive.tag].popleft()
        if data.size > receive.buffer.size:
            raise MessageError.too_long(receive.source, receive.tag, receive.buffer.size)
        receive.buffer[: data.size] = data
        self._world.unread[receive.source] -= 1
        return data.size

    def wait_sends(self) -> None:
        """Wait until all that this rank sent was received."""
        world = self._world
        with world.changed:
            world.wait(lambda: world.unread[self._rank] == 0, f"rank {self._rank} waits for its sends")

    def allgather(self, value: T) -> list[T]:
        """One value from each rank; the objects are shared, not copied."""
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
        """Few numbers from each rank."""
        return np.stack(self.allgather(np.array(values, np.int64)))

    def gather(self, value: T, root: int = 0) -> list[T] | None:
        """One value from each rank, on the root."""
        values = self.allgather(value)
        return values if self._rank == root else None

    def broadcast(self, value: T, root: int = 0) -> T:
        """The root's value."""
        return self.allgather(value)[root]

    def maximum(self, value: int) -> int:
        """The largest value."""
        return max(self.allgather(value))

    def barrier(self) -> None:
        """Wait for all ranks."""
        self.allgather(None)

    def place(self) -> NodePlace:
        """All ranks share one node."""
        return single_place(self._rank, self.size)

    def nodes(self) -> Nodes:
        """One node, or pretended ones as `run_loopback` was told."""
        return group_by_node([0] * self.size, self._world.ranks_per_node)

    def window(self, own_bytes: int) -> LoopbackWindow:
        """Each rank brings its own part; the boards are those of the node's first member."""
        check_sizes(self.allgather(own_bytes))
        members = next(node for node in self.nodes() if self._rank in node)
        brought = self.allgather((np.zeros(own_bytes, np.uint8), empty_boards(len(members))))
        parts = [brought[member][0] for member in members]
        return LoopbackWindow(self._world, members, members.index(self._rank), parts, brought[members[0]][1])

    def counters(self, count: int) -> LoopbackCounters:
        """One list for all ranks: that of rank 0."""
        return LoopbackCounters(self._world.changed, self.broadcast([0] * count), self.barrier)

    def for_thread(self) -> LoopbackChannel:
        """A channel of another world."""
        return LoopbackChannel(self.broadcast(self._world.beside() if self._rank == 0 else None), self._rank)

    def beside(self) -> LoopbackChannel:
        """A channel of another world."""
        return self.for_thread()

    def close(self) -> None:
        """Nothing: there is only memory, which goes by itself."""

    def abort(self, status: int) -> None:
        """Nothing: the error itself ends the ranks, which share this process."""


def run_loopback(
    ranks: int,
    function: Callable[[LoopbackChannel], T],
    *,
    timeout_seconds: float = 30.0,
    ranks_per_node: int | None = None,
) -> list[T]:
    """Run a function on each of `ranks` ranks, one thread each, on pretended nodes of `ranks_per_node` ranks.

    Returns
    -------
    results : what the function returned, by rank

    Raises
    ------
    Exception
        The error of the lowest rank that failed; TimeoutError where ranks wait for each other without end.
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
