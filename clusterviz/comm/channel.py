"""The contract of every channel: how ranks talk to each other, whatever carries the bytes.

A channel knows its own rank and the number of ranks. Point-to-point calls are non-blocking and move whole contiguous
NumPy buffers as bytes: post every receive, start the sends, then take what has arrived with `wait_some`, so that a
rank works on one message while others travel. Messages from one source with one tag arrive in the order in which
they were sent; only one receive at a time may be pending for a source and a tag. A sent buffer must stay as it is
until `wait_sends` returns. A message may be shorter than the buffer posted for it; a longer one is a MessageError.

Collective calls (`allgather`, `allgather_numbers`, `broadcast`, `gather`, `maximum`, `barrier`, `place`, `nodes`,
`window`, `counters`, `for_thread`, `beside`, `close`) are made by every rank in the same order. They carry small Python
objects, or few numbers; pixels travel point to point, or lie in a window that the ranks of a node share.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.counters import Counters
from clusterviz.comm.nodes import Nodes
from clusterviz.comm.place import NodePlace
from clusterviz.comm.window import Numbers, SharedWindow
from clusterviz.errors import ClustervizError

T = TypeVar("T")
Buffer = NDArray[Any]


class Pending(Protocol):
    """A receive that was posted, as `post_receive` returned it."""


@runtime_checkable
class Channel(Protocol):
    """What the rest of clusterviz knows of the other ranks."""

    @property
    def rank(self) -> int: ...

    @property
    def size(self) -> int: ...

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        """Start to receive at most `buffer.nbytes` bytes into a writable C-contiguous buffer."""
        ...

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        """Start to send all bytes of a C-contiguous buffer, of any size, above 2 GiB too."""
        ...

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Wait until a message is here: (index in `pending`, bytes received) of each that has arrived, at least one.

        The caller takes them out of `pending` before the next call. Nothing pending gives an empty list.

        Raises
        ------
        MessageError
            A message is longer than its buffer, or was lost.
        """
        ...

    def test_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """What `wait_some` gives for the messages that are here by now, maybe none; it also forgets what was sent.

        Raises
        ------
        MessageError
            As `wait_some`.
        """
        ...

    def wait_sends(self) -> None:
        """Wait until every buffer sent so far may be changed again."""
        ...

    def allgather(self, value: T) -> list[T]:
        """One value from each rank, on each rank."""
        ...

    def allgather_numbers(self, values: Sequence[int] | Numbers) -> Numbers:
        """Few numbers from each rank, on each rank: int64 (k,), the same k everywhere, gives int64 (size, k)."""
        ...

    def gather(self, value: T, root: int = 0) -> list[T] | None:
        """One value from each rank, on the root; None elsewhere."""
        ...

    def broadcast(self, value: T, root: int = 0) -> T:
        """The root's value, on each rank."""
        ...

    def maximum(self, value: int) -> int:
        """The largest of the ranks' values, on each rank: the cheapest question that all can agree on."""
        ...

    def barrier(self) -> None:
        """Wait for all ranks."""
        ...

    def place(self) -> NodePlace:
        """Where this rank runs, and with whom it shares the node."""
        ...

    def nodes(self) -> Nodes:
        """The ranks of each node, ascending, nodes by their first ranks.

        CLUSTERVIZ_RANKS_PER_NODE=m cuts every node into pretended ones of m ranks; `place` goes on telling the truth.

        Raises
        ------
        InputError
            On every rank: the variable's value is no positive integer.
        """
        ...

    def window(self, own_bytes: int) -> SharedWindow:
        """Memory that the ranks of each of these nodes share; each asks for its own part, of any size, 0 included.

        Raises
        ------
        InputError
            On every rank: a negative size.
        WindowError
            On every rank: there is no such memory on some node.
        """
        ...

    def counters(self, count: int) -> Counters:
        """So many numbers that every rank reads and raises; the same count on every rank."""
        ...

    def for_thread(self) -> Channel | None:
        """Another channel to the same ranks, for one other thread of each: neither waits for the other's calls.

        None, on every rank, where MPI was started for one thread at a time.
        """
        ...

    def beside(self) -> Channel:
        """Another channel to the same ranks, for the same thread: `wait_sends` of one does not wait for the other's."""
        ...

    def close(self) -> None:
        """Give back what `beside` made; nothing is under way any more."""
        ...

    def abort(self, status: int) -> None:
        """End the processes of all ranks at once; returns only where the ranks share this process."""
        ...


class MessageError(ClustervizError):
    """A message could not be received as it was expected."""

    @classmethod
    def too_long(cls, source: int, tag: int, room: int) -> MessageError:
        """It does not fit into its buffer."""
        return cls(f"a message from rank {source} with tag {tag} is longer than the {room} bytes expected")


def check_contiguous(buffer: Buffer) -> None:
    """Refuse an array that does not lie in one piece, in C order.

    Raises
    ------
    ValueError
        The array is not C-contiguous.
    """
    if not buffer.flags.c_contiguous:
        raise ValueError("only C-contiguous buffers can be sent or received")


def as_bytes(buffer: Buffer) -> NDArray[np.uint8]:
    """The bytes of a C-contiguous array, without a copy.

    Raises
    ------
    ValueError
        The array is not C-contiguous.
    """
    check_contiguous(buffer)
    return buffer.reshape(-1).view(np.uint8)
