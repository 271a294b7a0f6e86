"""Contract of a channel: communication between ranks, independent of the transport.

Point-to-point calls are non-blocking and move whole C-contiguous NumPy buffers as bytes. Post every receive, start the
sends, then take arrived messages with `wait_some`: a rank then works on one message while others travel. Messages from
one source with one tag arrive in the order in which they were sent. Only one receive at a time may be pending for a
source and a tag. A sent buffer must not change until `wait_sends` returns. A message may be shorter than its buffer; a
longer one is a MessageError.

Collective calls (`allgather`, `allgather_numbers`, `broadcast`, `gather`, `maximum`, `barrier`, `placement`, `nodes`,
`window`, `remote_memory`, `counters`, `for_thread`, `duplicate`, `close`) are made by every rank in the same order.
They carry small Python objects or a few numbers. Pixels travel point to point, or lie in a window that the ranks of a
node share.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.back_off import poll_until
from clusterviz.comm.placement import Nodes, Placement
from clusterviz.comm.remote_memory import RemoteMemory
from clusterviz.comm.window import Counters, Numbers, SharedWindow
from clusterviz.errors import ClustervizError

T = TypeVar("T")
Buffer = NDArray[Any]


class Pending(Protocol):
    """Posted receive, as `post_receive` returns it."""


@runtime_checkable
class Channel(Protocol):
    """Connection of one rank to all ranks."""

    @property
    def rank(self) -> int: ...

    @property
    def size(self) -> int: ...

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        """Start to receive at most `buffer.nbytes` bytes into a writable C-contiguous buffer."""

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        """Start to send all bytes of a C-contiguous buffer of any size, also above 2 GiB."""

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Wait until at least one message has arrived.

        Returns (index in `pending`, bytes received) of each message that has arrived; empty if nothing is pending. The
        caller removes them from `pending` before the next call. Raises MessageError if a message is longer than its
        buffer, or was lost.
        """

    def test_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Return what `wait_some` does, possibly nothing, without waiting. Completed sends are released too."""

    def wait_sends(self) -> None:
        """Wait until every buffer sent so far may be changed again."""

    def allgather(self, value: T) -> list[T]:
        """Return one value of each rank, on each rank."""

    def allgather_numbers(self, values: Sequence[int] | Numbers) -> Numbers:
        """Return k numbers of each rank, on each rank: int64 (k,), the same k everywhere, gives int64 (size, k)."""

    def gather(self, value: T, root: int = 0) -> list[T] | None:
        """Return one value of each rank on the root, None elsewhere."""

    def broadcast(self, value: T, root: int = 0) -> T:
        """Return the root's value on each rank."""

    def maximum(self, value: int) -> int:
        """Return the largest of the ranks' values on each rank; the cheapest collective call."""

    def barrier(self) -> None:
        """Wait for all ranks."""

    def placement(self) -> Placement:
        """Return the node and the cores of this rank."""

    def nodes(self) -> Nodes:
        """Return the ranks of each node, ascending, with the nodes in the order of their first ranks.

        CLUSTERVIZ_RANKS_PER_NODE=m splits every node into simulated nodes of m ranks; `placement` still describes the
        real ones.

        Raises InputError on every rank if the variable's value is no positive integer.
        """

    def window(self, own_bytes: int) -> SharedWindow:
        """Allocate memory that the ranks of each node share.

        `own_bytes`: size of this rank's part, 0 or more; it may differ between ranks. Raises InputError on every rank
        for a negative size. Raises WindowError on every rank for a node has no such memory.
        """

    def remote_memory(self, own_bytes: int, folder: Path | None = None) -> RemoteMemory:
        """Allocate memory that every rank reads and writes.

        Raises InputError on every rank for a negative size. Raises RemoteMemoryError on every rank if there is not
        enough memory, or space in a folder.

        Parameters
        ----------
        own_bytes : size of this rank's part, 0 or more; it may differ between ranks
        folder : on this rank's node, for parts in files, which the operating system writes where memory is short;
            None: parts in memory. All ranks give a folder, or none does.
        """

    def counters(self, count: int) -> Counters:
        """Create `count` counters that every rank reads and raises; the same count on every rank."""

    def for_thread(self) -> Channel | None:
        """Return another channel to the same ranks for one other thread of each rank, independent of this one.

        None, on every rank, if MPI was not started for several threads.
        """

    def duplicate(self) -> Channel:
        """Return another channel to the same ranks for the same thread, with its own messages and `wait_sends`."""

    def close(self) -> None:
        """Free a channel that `duplicate` returned, once all its messages are complete."""

    def abort(self, status: int) -> None:
        """End the processes of all ranks at once; returns only if the ranks share this process."""


class MessageError(ClustervizError):
    """Message that could not be received as expected."""

    @classmethod
    def too_long(cls, source: int, tag: int, room: int) -> MessageError:
        """Return the error of a message that does not fit into its buffer of `room` bytes."""
        return cls(f"a message from rank {source} with tag {tag} is longer than the {room} bytes expected")


def check_contiguous(buffer: Buffer) -> None:
    """Raise ValueError if an array is not C-contiguous."""
    if not buffer.flags.c_contiguous:
        raise ValueError("only C-contiguous buffers can be sent or received")


def as_bytes(buffer: Buffer) -> NDArray[np.uint8]:
    """Return a view of the bytes of an array, uint8 (nbytes,); raise ValueError if it is not C-contiguous."""
    check_contiguous(buffer)
    return buffer.reshape(-1).view(np.uint8)


def all_to_all(channel: Channel, sent: Sequence[Buffer], tag: int, counts: Sequence[int] | None = None) -> list[Buffer]:
    """Send an array to each rank, and return those of all ranks, the own one uncopied; collective.

    `sent`: one array (k,) for each rank, C order, of the same type everywhere. `tag`: of the messages. `counts`: length
    of the array from each rank; None: the ranks tell each other.
    """
    if counts is None:
        counts = channel.allgather_numbers([len(each) for each in sent])[:, channel.rank].tolist()
    received = [np.empty(count, sent[0].dtype) for count in counts]
    received[channel.rank] = sent[channel.rank]
    others = [source for source in range(channel.size) if source != channel.rank]
    pending = [channel.post_receive(received[source], source, tag) for source in others if counts[source]]
    for target in others:
        if len(sent[target]):
            channel.isend(sent[target], target, tag)
    while pending:
        done = {index for index, _ in channel.wait_some(pending)}
        pending = [one for index, one in enumerate(pending) if index not in done]
    channel.wait_sends()
    return received


class WorkQueue:
    """Queue of numbered work items that groups of ranks take, each item once, as one rank sees it.

    All members of a group take the same items. In a group of one rank, taking is one access to a counter. In a larger
    group the first member that reaches the group's k-th turn takes an item and stores its number; the others read it.
    Fast members run ahead, and no member waits for a leader. Construction, `start` and `free` are collective.

    `channel`: to the other ranks; `most`: largest number of items; `group`, `groups`: index of this rank's group, and
    number of groups; `alone`: whether every group is one rank.
    """

    def __init__(self, channel: Channel, most: int, group: int, groups: int, alone: bool) -> None:
        self._most, self._alone = most, alone
        # Counter 0: the next item. Then two a group and turn: members that have come, and the item taken plus one.
        turns = most + 1
        self._first = 1 + 2 * turns * group
        self._counters = channel.counters(1 if alone else 1 + 2 * turns * groups)

    def start(self) -> None:
        self._counters.reset()

    def take(self, items: int) -> Iterator[int]:
        """Yield the numbers below `items` that this rank's group takes, each on request; not collective.

        `items`: number of items, the same on every rank, at most `most`.
        """
        turn = 0
        while (item := self._next(turn)) < items:
            yield item
            turn += 1

    def free(self) -> None:
        self._counters.free()

    def _next(self, turn: int) -> int:
        counters = self._counters
        if self._alone:
            return counters.add(0, 1)
        here = self._first + 2 * turn
        if counters.add(here, 1) == 0:
            item = counters.add(0, 1)
            counters.add(here + 1, item + 1)
            return item
        return poll_until(lambda: counters.add(here + 1, 0)) - 1
