"""Unstructured grids of finite-element programs, which the meshlane package reads (extra `grids`).

NASTRAN, Abaqus, MED, Medit, TetGen, SU2 and UGRID. The reader of each format is called, as `meshlane.read` ends the
process on errors.
"""

from __future__ import annotations

import ctypes
import io
import resource
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

from clusterviz.data.files import library, require_file
from clusterviz.data.unstructured import UnstructuredGrid, grid_of_blocks
from clusterviz.errors import DataError

GROWTH, ROOM = 128, 1 << 27
"""Bytes of memory for a byte of a file, and for any file."""
RATE, SECONDS = 50_000, 1.0
"""Bytes of a file that are read in a second of CPU time, at least, and seconds for any file."""
READERS = {".bdf": "nastran", ".fem": "nastran", ".nas": "nastran", ".inp": "abaqus", ".med": "med", ".mesh": "medit"}
READERS |= {".meshb": "medit", ".ele": "tetgen", ".su2": "su2", ".ugrid": "ugrid"}
"""Names of meshlane's readers by extension."""


def read_meshlane(path: Path) -> UnstructuredGrid:
    where, name = str(path), READERS[path.suffix.lower()]
    size, package, said = require_file(path), library("meshlane", "grids", where), io.StringIO()
    with limited_time(size, where), limited_memory(size), redirect_stdout(said), redirect_stderr(said):  # its warnings
        try:
            mesh = package._helpers.reader_map[name](where)
        except package.ReadError as error:
            raise DataError(f"meshlane does not read the file: {error or said.getvalue()}", where=where) from error
    return grid_of_blocks(mesh, where)


@contextmanager
def limited_time(size: int, where: str) -> Iterator[None]:
    """Context in which this thread gets as much CPU time as a file of `size` bytes may need, on Linux.

    Some of meshlane's readers wait for a line at the end of a file for ever, or count to what a damaged file states.
    """
    if not hasattr(time, "pthread_getcpuclockid"):
        yield
        return
    thread, done = threading.get_ident(), threading.Event()
    clock = time.pthread_getcpuclockid(thread)
    end = time.clock_gettime(clock) + SECONDS + size / RATE

    def watch() -> None:
        while not done.wait(0.1):
            if time.clock_gettime(clock) > end:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(TimeoutError))
                return

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    except TimeoutError as error:
        raise DataError("damaged: reading does not end", where=where) from error
    finally:
        done.set()
        watcher.join()


@contextmanager
def limited_memory(size: int) -> Iterator[None]:
    """Context in which the process gets little more memory than a file of `size` bytes may need, on Linux.

    meshlane allocates what a file states, and a damaged one may state anything.
    """
    status = Path("/proc/self/statm")
    if not status.exists():
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = int(status.read_text().split()[0]) * resource.getpagesize() + GROWTH * size + ROOM
    if before[0] == resource.RLIM_INFINITY or most < before[0]:
        resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
