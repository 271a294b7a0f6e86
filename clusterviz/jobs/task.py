"""Tasks: Python functions of a block of a grid, spread over the devices of a node.

@jobs.task
def smooth_part(block, src, dst):
    smooth[dst[block].shape](src, dst[block], 0.5)

smooth_part[4](src, dst)         # blocks 0 to 3; devices take them from one queue
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from operator import index
from threading import Lock
from typing import Any

import numpy as np

from clusterviz.errors import InputError
from clusterviz.jobs.device import current_pool

Index = int | tuple[int, ...]
Grid = int | Sequence[int]


def indices(grid: Grid) -> list[Index]:
    """Return the indices of a grid of blocks in C order: of n blocks the numbers 0 … n − 1, else tuples.

    Raises
    ------
    InputError
        A count is no number, or negative.
    """
    sides = (grid,) if isinstance(grid, int | np.integer) else tuple(grid)
    if not all(isinstance(side, int | np.integer) and side >= 0 for side in sides) or not sides:
        raise InputError("wrong grid of blocks", found=grid, allowed="a number of blocks, or one for each axis")
    found = product(*(range(index(side)) for side in sides))
    return [each[0] for each in found] if isinstance(grid, int | np.integer) else list(found)


@dataclass(frozen=True)
class Task:
    """Task; `task[grid](*arguments)` runs its blocks, and returns their values in the order of blocks.

    Attributes
    ----------
    function : of a block and the arguments; kernels in it run on the device that has taken the block
    """

    function: Callable[..., Any]

    def __getitem__(self, grid: Grid) -> Callable[..., list[Any]]:
        return partial(self._run, indices(grid))

    def _run(self, blocks: list[Index], *arguments: Any) -> list[Any]:
        values: list[Any] = [None] * len(blocks)
        lock, left = Lock(), iter(range(len(blocks)))

        def taken() -> Iterator[int]:
            while True:
                with lock:
                    number = next(left, None)
                if number is None:
                    return
                yield number

        def work() -> None:
            for number in taken():
                try:
                    values[number] = self.function(blocks[number], *arguments)
                except BaseException:
                    with lock:  # the other devices take no more
                        for _ in left:
                            pass
                    raise

        current_pool().run(work)
        return values


def task(function: Callable[..., Any]) -> Task:
    """Make a task of a function; see `Task`."""
    return Task(function)
