"""What compiled code shall do, as a table of numbers: the only place where arrays become addresses.

Whatever a kernel could not survive is refused here: types, shapes, arrays that are not in C order or may not be
written. The numbers are laid out as `job_layout.py` says.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.over.job_layout import (
    BYTE,
    FINE,
    FIRST_WRONG,
    FLOAT,
    HALF,
    KIND,
    MAXIMUM,
    MINIMUM,
    OUT,
    OUT_EXTRA,
    OVER,
    RESULT,
    SIZE,
    STRETCH,
    SUM,
    TARGET,
)
from clusterviz.composite.over.native import Kernel
from clusterviz.composite.patch import Patch
from clusterviz.errors import InputError
from clusterviz.image.merge import Operator

_OPERATORS: dict[Operator, int] = {
    "over": OVER,
    "maximum": MAXIMUM,
    "minimum": MINIMUM,
    "sum": SUM,
    "stretch": STRETCH,
}
_KINDS: dict[np.dtype[Any], int] = {np.dtype(np.float32): FLOAT, np.dtype(np.uint8): BYTE, np.dtype(np.float16): HALF}
# The types of pixel, by their numbers.
DTYPES: tuple[np.dtype[Any], ...] = tuple(sorted(_KINDS, key=_KINDS.__getitem__))

_DEPTH_BYTES = 4
# Waking a thread takes as long as blending two layers of this many pixels (measured: 0.06 ms); below, it does not pay.
PIXELS_A_THREAD = 1 << 17


def head(
    out: NDArray[Any], patch: Patch, layers: int, wish: int, extra: int = 0, operator: Operator = "over"
) -> list[int]:
    """The numbers of a target; `extra` is where its depths are.

    Raises
    ------
    InputError
        It cannot be written.
    """
    if not out.flags.writeable:
        raise InputError("the target is read-only")
    return [0, 0, *pixels_at(out, "target"), extra, layers, wish, _OPERATORS[operator], patch.width, *_place(patch)]


def check_floats(operator: Operator, *images: NDArray[Any]) -> None:
    """Refuse pixels that an operator cannot merge.

    Raises
    ------
    InputError
        The operator is not over, and the pixels are no float32.
    """
    if operator != "over" and any(image.dtype != np.float32 for image in images):
        found = ", ".join(sorted({str(image.dtype) for image in images}))
        raise InputError(f"pixels that the operator {operator} cannot merge", found=found, allowed="float32")


def entry(pixels: NDArray[Any], patch: Patch, extra: int = 0, runs: int = -1) -> tuple[int, ...]:
    """The numbers of a layer: `extra` is where its runs or depths are, `runs` how many runs it has, -1 for none."""
    return *pixels_at(pixels, "layer"), extra, runs, *_place(patch), 0, 0


def pixels_at(pixels: NDArray[Any], where: str) -> tuple[int, int, int]:
    """Address, type and number of pixels.

    Raises
    ------
    InputError
        Not uint8, float16 or float32 (n, 4) in C order.
    """
    kind, shape = _KINDS.get(pixels.dtype, -1), pixels.shape
    if kind < 0 or len(shape) != 2 or shape[1] != 4 or not pixels.flags.c_contiguous:
        found = f"{pixels.dtype} {shape}{'' if pixels.flags.c_contiguous else ', not in C order'}"
        raise InputError(
            "not an array of pixels", where=where, found=found, allowed="uint8, float16 or float32 (n, 4), C order"
        )
    return pixels.__array_interface__["data"][0], kind, shape[0]


def runs_at(runs: NDArray[np.int32]) -> tuple[int, int]:
    """Address and number of runs.

    Raises
    ------
    InputError
        Not int32 (k, 2) in C order.
    """
    if runs.dtype != np.int32 or runs.ndim != 2 or runs.shape[1] != 2 or not runs.flags.c_contiguous:
        raise InputError("not an array of runs", found=f"{runs.dtype} {runs.shape}", allowed="int32 (k, 2), C order")
    return runs.__array_interface__["data"][0], runs.shape[0]


def run(kernel: Kernel, numbers: Sequence[int], patches: Sequence[Patch], threads: int = 1) -> int:
    """Do a job on the patches of the target and the layers, with several threads where the target is large enough.

    Returns
    -------
    answer : of a kernel that counts something; -1 from the others

    Raises
    ------
    InputError
        An array is not as large as its patch.
    """
    job = array("q", numbers)
    threads = min(threads, job[SIZE] // PIXELS_A_THREAD)
    parts = [job] if threads < 2 else _parts(job, patches[0], threads)
    if len(parts) == 1:
        kernel(job.buffer_info()[0])
    else:
        others = [_pool(os.getpid()).submit(kernel, part.buffer_info()[0]) for part in parts[1:]]
        kernel(parts[0].buffer_info()[0])
        wait(others)
    answer = min(part[RESULT] for part in parts)
    if answer < FINE:
        wrong = FIRST_WRONG - answer
        where = f"layer {wrong - 1}" if wrong else "target"
        raise InputError("the pixels do not fit their patch", where=where, allowed=f"{patches[wrong].count} pixels")
    return answer


def _parts(job: array[int], patch: Patch, count: int) -> list[array[int]]:
    """The job for each thread: rows of the target, which are neighbours in memory."""
    rect, bytes_a_pixel = patch.rect, 4 * DTYPES[job[KIND]].itemsize
    rows = [rect.y_begin + rect.height * k // count for k in range(1, count)]
    cuts = [patch.begin, *(min(max(row * patch.width, patch.begin), patch.end) for row in rows), patch.end]
    sizes = [Patch(patch.width, begin, end, rect).count for begin, end in pairwise(cuts)]
    if sum(sizes) != job[SIZE]:
        return [job]  # which is refused
    parts: list[array[int]] = []
    done = 0
    for size, (begin, end) in zip(sizes, pairwise(cuts), strict=True):
        part = job[:]
        part[OUT] += done * bytes_a_pixel
        part[OUT_EXTRA] += done * _DEPTH_BYTES
        part[SIZE], part[TARGET], part[TARGET + 1] = size, begin, end
        parts.append(part)
        done += size
    return parts


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Threads that wait for work, made as they are needed; a forked process has none of its parent's."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="blend")


def _place(patch: Patch) -> tuple[int, ...]:
    """Which pixels: the range and the rectangle's sides."""
    rect = patch.rect
    return patch.begin, patch.end, rect.x_begin, rect.y_begin, rect.x_end, rect.y_end
