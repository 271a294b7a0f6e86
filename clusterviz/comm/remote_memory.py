"""Remote memory: any rank reads and writes boxes of arrays in the memory of any other, without a call by it.

Each rank gives a part of its memory, or of a file. `get` and `put` move boxes; they are complete on return. Ranks of
one node map each other's parts, so that an access copies memory and calls no MPI. Other parts are reached by the
channel (`Parts`). `sync` is collective: what any rank wrote before it is seen by all after it.

`accumulate` and `compare_and_swap` read, change and write under a lock, a ticket lock of two counters. Compared with
MPI_Accumulate it serves every number type, parts in files, and NaN in the same way on all channels; over shared memory
it is also faster. Between nodes it takes four accesses in place of one. A lock guards the arrays that begin at one
offset of one rank's part (and by chance some others): ranks that change different arrays seldom wait for each other.

Cost: between ranks of one node that of a copy; between nodes a message both ways. Some MPI libraries serve boxes whose
rows are not contiguous, and parts in files, only while their owner calls MPI; a job that computes for long then delays
others (MPICH: MPICH_ASYNC_PROGRESS=1 adds a thread for them).

Reference: J. Nieplocha, R. Harrison, R. Littlefield: Global Arrays, Supercomputing 1994. MPI Forum: MPI, a
message-passing interface standard, version 4.1, chapter 12.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.back_off import poll_until
from clusterviz.comm.window import Counters
from clusterviz.errors import ClustervizError, InputError

OPERATIONS: dict[str, Callable[..., Any]] = {"sum": np.add, "min": np.minimum, "max": np.maximum}
"""What `accumulate` does with the old and the given value. NaN wins over every number."""

LOCKS = 64
_SPIN_CALLS = 20


@dataclass(frozen=True, slots=True)
class RemoteBox:
    """Box of an array that lies in C order in a rank's part."""

    rank: int  # owner of the part
    offset: int  # bytes before the array in the part, a multiple of the size of its elements
    shape: tuple[int, ...]  # of the array
    # the box, half-open, along each axis of the array
    begin: tuple[int, ...]
    end: tuple[int, ...]

    @property
    def slices(self) -> tuple[slice, ...]:
        """Slices of the box in the array."""
        return tuple(map(slice, self.begin, self.end))


Transfer = tuple[RemoteBox, NDArray[Any]]
"""A box, and local values of its shape and of the array's type, with any strides."""


class RemoteMemoryError(ClustervizError):
    """The ranks cannot give the memory that was asked for."""

    def __init__(self, cause: str) -> None:
        super().__init__(f"no memory for data of all ranks ({cause}); give it more room, or use more nodes")


class ThreadError(ClustervizError):
    """Access to remote memory by a thread that may not communicate."""

    def __init__(self) -> None:
        super().__init__("MPI was not started for several threads; open the channel with several_threads=True")


class Parts(Protocol):
    """Memory of all ranks as a channel reaches it."""

    def view(self, rank: int) -> NDArray[np.uint8] | None:
        """Return a rank's part, uint8 (its bytes,), if this process has it in its address space; else None."""

    def fetch(self, transfers: Sequence[Transfer]) -> None:
        """Read boxes of parts without a view into the local values; complete on return."""
        return

    def store(self, transfers: Sequence[Transfer]) -> None:
        """Write the local values into boxes of parts without a view; complete at their owners on return."""
        return

    def check_thread(self) -> None:
        """Raise ThreadError if MPI was not started for several threads, and another one made the memory."""
        return

    def fence(self) -> None:
        """Order accesses of this thread to memory before it and after it."""
        return

    def sync(self) -> None:
        """Make all that was written before visible to all ranks; collective."""

    def free(self) -> None:
        """Release the memory; collective."""


class RemoteMemory:
    """Remote memory of one rank; `Channel.remote_memory` makes it.

    `rank`: of this process; `parts`: memory of all ranks; `counters`: two for each lock.
    """

    def __init__(self, rank: int, parts: Parts, counters: Counters) -> None:
        self._rank, self._parts, self._counters = rank, parts, counters

    @property
    def own(self) -> NDArray[np.uint8]:
        """This rank's part, uint8 (own_bytes,), initially zero."""
        view = self._parts.view(self._rank)
        assert view is not None, "every channel maps the own part"
        return view

    def get(self, transfers: Sequence[Transfer]) -> None:
        """Read boxes into local values."""
        if far := self._copy_near(transfers, lambda array, values: np.copyto(values, array)):
            self._parts.check_thread()
            self._parts.fetch(far)

    def put(self, transfers: Sequence[Transfer]) -> None:
        """Write local values into boxes, not atomically; of writes to one element at once, one wins."""
        if far := self._copy_near(transfers, np.copyto):
            self._parts.check_thread()
            self._parts.store(far)

    def accumulate(self, transfers: Sequence[Transfer], operation: str) -> None:
        """Combine boxes with local values; atomic for each box among all accumulate and compare_and_swap.

        Raises InputError if there is no such operation.
        """
        combine = operation_of(operation)
        for box, values in transfers:
            with self._locked(box):
                if (array := self._array(box, values.dtype)) is not None:
                    target = array[box.slices]
                    combine(target, values, out=target)
                else:
                    found = np.empty(values.shape, values.dtype)
                    self._parts.fetch([(box, found)])
                    self._parts.store([(box, combine(found, values, out=found))])

    def compare_and_swap(self, box: RemoteBox, expected: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
        """Write `new` into a box if its bytes equal those of `expected`; atomic.

        Returns the values before, of the shape and type of `new`.
        """
        previous = np.empty(new.shape, new.dtype)
        with self._locked(box):
            self.get([(box, previous)])
            if previous.tobytes() == expected.tobytes():
                self.put([(box, new)])
        return previous

    def sync(self) -> None:
        """Make all that was written before visible to all ranks; collective."""
        self._parts.sync()

    def free(self) -> None:
        """Release the memory; collective. Views of it must not be used any longer."""
        self._counters.free()
        self._parts.free()

    def _copy_near(self, transfers: Sequence[Transfer], copy: Callable[..., None]) -> list[Transfer]:
        """Copy between boxes and local values where the parts have views, and return the other transfers."""
        far = []
        for box, values in transfers:
            if (array := self._array(box, values.dtype)) is not None:
                copy(array[box.slices], values)
            else:
                far.append((box, values))
        return far

    def _array(self, box: RemoteBox, dtype: np.dtype[Any]) -> NDArray[Any] | None:
        part = self._parts.view(box.rank)
        return None if part is None else np.ndarray(box.shape, dtype, part, box.offset)

    @contextmanager
    def _locked(self, box: RemoteBox) -> Iterator[None]:
        self._parts.check_thread()
        lock = 2 * ((box.offset // 64 + 17 * box.rank) % LOCKS)
        ticket = self._counters.add(lock, 1)
        if self._counters.add(lock + 1, 0) != ticket:
            poll_until(lambda: self._counters.add(lock + 1, 0) == ticket, _SPIN_CALLS)
        self._parts.fence()
        try:
            yield
        finally:
            self._parts.fence()
            self._counters.add(lock + 1, 1)


def operation_of(name: str) -> Callable[..., Any]:
    """Return the function of an operation; raise InputError if there is none of this name."""
    if name not in OPERATIONS:
        raise InputError("no such operation", where="accumulate", found=name, allowed=", ".join(OPERATIONS))
    return OPERATIONS[name]


def make_part_file(folder: Path, own_bytes: int) -> Path:
    """Reserve a file of zeros for a rank's part, and return its path; the caller removes it once it is mapped.

    Raises OSError, and leaves no file, if the folder cannot be written, or has not enough space left.
    """
    handle, name = tempfile.mkstemp(prefix="clusterviz-", suffix=".part", dir=folder)
    try:
        os.posix_fallocate(handle, 0, max(1, own_bytes))
    except OSError:
        os.unlink(name)
        raise
    finally:
        os.close(handle)
    return Path(name)


def map_part_file(path: Path, part_bytes: int) -> NDArray[np.uint8]:
    """Map the file of a rank's part, uint8 (part_bytes,); processes that map it share it."""
    return np.asarray(np.memmap(path, np.uint8, "r+", shape=(max(1, part_bytes),)))[:part_bytes]


def part_fault(error: OSError | MemoryError, own_bytes: int, folder: Path | None) -> str:
    """Return why a part could not be allocated, as a short clause."""
    text = error.strerror if isinstance(error, OSError) else "too little memory"
    return f"{text} while {own_bytes} bytes were allocated" + (f" in {folder}" if folder else "")
