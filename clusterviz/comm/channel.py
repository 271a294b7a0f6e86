"""The contract of every channel: how ranks talk to each other, whatever carries the bytes.

A channel knows its own rank and the number of ranks. Point-to-point calls are non-blocking and move whole contiguous
NumPy buffers as bytes: post every receive, start the sends, then take what has arrived with `wait_some`, so that a
rank works on one message while others travel. Messages from one source with one tag arrive in the order in which
they were sent; only one receive at a time may be pending for a source and a tag. A sent buffer must stay as it is
until `wait_sends` returns. A message may be shorter than the buffer posted for it, never longer.

Collective calls (`allgather`, `broadcast`, `gather`, `maximum`, `barrier`, `place`) are made by every rank in the same
order. They carry small Python objects; pixels travel point to point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.place import NodePlace

T = TypeVar("T")
Buffer = NDArray[Any]


class Pending(Protocol):
    """A receive that was posted, as `post_receive` returned it."""


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

        The caller takes them out of `pending` before the next call.
        """
        ...

    def wait_sends(self) -> None:
        """Wait until every buffer sent so far may be changed again."""
        ...

    def allgather(self, value: T) -> list[T]:
        """One value from each rank, on each rank."""
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

    def abort(self, status: int) -> None:
        """End the processes of all ranks at once; returns only where the ranks share this process."""
        ...


def as_bytes(buffer: Buffer) -> NDArray[np.uint8]:
    """The bytes of a C-contiguous array, without a copy.

    Raises
    ------
    ValueError
        The array is not C-contiguous.
    """
    if not buffer.flags.c_contiguous:
        raise ValueError("only C-contiguous buffers can be sent or received")
    return buffer.reshape(-1).view(np.uint8)
