"""Program of several ranks that fails as its argument says, while others read its blocks and wait for it."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz import jobs


def wrong(dst: Any) -> None:
    """Kernel with a mistake."""


def fail(how: str, folder: str) -> None:
    """Fail in a block, on whichever rank runs it."""
    if how == "kernel":
        file = Path(folder) / "wrong.glsl"
        file.write_text("void kernel(ivec3 at) {\n    dst_set(at, 1.0 +);\n}\n")
        jobs.kernel(file, writes=("dst",))(wrong)[4](np.zeros(4, np.float32))
    if how == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "endless":
        file = Path(folder) / "endless.glsl"
        file.write_text("void kernel(ivec3 at) {\n    while (dst_at(at) < 1.0) dst_set(at, 0.0);\n}\n")
        jobs.kernel(file, writes=("dst",))(wrong)[4](np.zeros(4, np.float32))
    if how == "exit":
        sys.exit(3)


def main(how: str, folder: str) -> None:
    """Run a job of 30 blocks, each behind the one before it, on an array of which each rank holds a part."""
    whole = ((0, 0, 0), (8, 8, 8))

    @jobs.job(after=lambda block: range(max(0, block - 1), block), time_limit=1 if how == "endless" else None)
    def run(block: int) -> None:
        if block == 17:
            fail(how, folder)
        array.accumulate(whole, 1)

    with jobs.cluster() as c:
        array = c.array((8, 8, 8), np.float32, 2)
        array.fill(c.rank)
        if how == "raise" and c.rank == 1:
            raise ValueError("odd")
        if how == "leave" and c.rank == 1:
            sys.exit()
        while how in ("raise", "leave") and c.rank == 2:
            array.read(whole)
        c.run(run, 30)


if __name__ == "__main__":
    main(*sys.argv[1:])
