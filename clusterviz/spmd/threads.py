"""Threads that run a shader's machine code on pieces of work, which they take from a counter."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import Any

from numpy.typing import NDArray

REPORT_SECONDS = 0.05


def _nothing() -> None:
    """Report nothing."""


def run_threads(
    code: Callable[[int], None],
    table: NDArray[Any],
    counter: NDArray[Any],
    pieces: int,
    threads: int,
    report: Callable[[], None] = _nothing,
) -> None:
    """Run machine code in several threads until it is done; this thread waits, so that it can be interrupted.

    Parameters
    ----------
    code : of a shader whose work groups take pieces from a counter; see `machine_code.compiled`
    table : of the blocks' addresses; see `machine_code.addresses`
    counter : (1,), the number of the next piece, in one of the blocks
    pieces : number of pieces
    report : called 20 times a second
    """
    if threads == 1 and report is _nothing:
        code(table.ctypes.data)
        return
    running = [thread_pool(os.getpid()).submit(code, table.ctypes.data) for _ in range(threads)]
    try:
        while wait(running, REPORT_SECONDS).not_done:
            report()
    finally:
        # After an interrupt there are no more pieces; those that are being done write to the blocks.
        counter[0] = pieces
        wait(running)


@cache
def thread_pool(process: int) -> ThreadPoolExecutor:
    """Threads that wait for work, made as they are needed; a forked process has none of its parent's."""
    return ThreadPoolExecutor(2 * (os.cpu_count() or 1), thread_name_prefix="spmd")
