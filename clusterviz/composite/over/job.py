"""Jobs of the compiled kernels: tables of int64 in which arrays become addresses.

Arrays that a kernel cannot handle are refused here: wrong types and shapes, arrays that are not in C order or are
read-only. A job is a head for the target, then one entry for each layer. Each has the geometry of its array: the patch
of the canvas (see `fragment.py`) that the array holds.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch
from clusterviz.errors import InputError
from clusterviz.image.merge import Operator
from clusterviz.kernels.compiled import CompiledKernel

# Head: address, type and number of the target's pixels, address of its depths or runs; number of layers, mode,
# operator, width of the canvas, geometry.
OUT, KIND, SIZE, OUT_EXTRA, LAYERS, MODE, OPERATOR, WIDTH, TARGET = range(9)
HEAD = TARGET + 6

# Layer: address, type and number of its stored pixels; address of its runs or depths, number of runs (-1 for none);
# geometry; the next run, and the number of stored pixels before it.
PIXELS, TYPE, STORED, EXTRA, RUN_COUNT, GEOMETRY = range(6)
RUN, PASSED = GEOMETRY + 6, GEOMETRY + 7
LAYER = GEOMETRY + 8

# Geometry: begin and end of a range, and the four sides of a rectangle. `prepare_geometry` converts them to the number
# of the rectangle's pixels before the range and in it, and to corner, width and height of the rectangle.
FIRST, COUNT, X, Y, COLUMNS, ROWS = range(6)

# Pixel types.
FLOAT, BYTE, HALF = range(3)

# Merge operators; all but over are for floats only.
OVER, MAXIMUM, MINIMUM, SUM, FIRST_RUN, TWO_FLUX = range(6)

# Modes: merge layers behind or before the target, begin with an empty target, or merge the first layer over the second.
BEHIND, BEFORE, FRESH, INTO = range(4)

# Results of a kernel: OK, or FIRST_BAD and less for a wrong array: the target, the first layer, the second, …
OK, FIRST_BAD = -1, -2


_OPERATORS: dict[Operator, int] = {
    "over": OVER,
    "maximum": MAXIMUM,
    "minimum": MINIMUM,
    "sum": SUM,
    "run": FIRST_RUN,
    "two-flux": TWO_FLUX,
}
_KINDS: dict[np.dtype[Any], int] = {np.dtype(np.float32): FLOAT, np.dtype(np.uint8): BYTE, np.dtype(np.float16): HALF}
# Pixel types by number.
DTYPES: tuple[np.dtype[Any], ...] = tuple(sorted(_KINDS, key=_KINDS.__getitem__))

_DEPTH_BYTES = 4
# Waking a thread takes as long as blending two layers of this many pixels (measured: 0.06 ms).
PIXELS_A_THREAD = 1 << 17


def job_head(
    out: NDArray[Any], patch: Patch, layers: int, mode: int, extra: int = 0, operator: Operator = "over"
) -> list[int]:
    """Return the head of a job; `extra` is the address of the target's depths.

    Raises
    ------
    InputError
        The target is read-only.
    """
    if not out.flags.writeable:
        raise InputError("the target is read-only")
    return [*pixels_at(out, "target"), extra, layers, mode, _OPERATORS[operator], patch.width, *_geometry(patch)]


def check_floats(operator: Operator, *images: NDArray[Any]) -> None:
    """Raise if an operator cannot merge the pixels.

    Raises
    ------
    InputError
        The operator is not over, and the pixels are not float32.
    """
    if operator != "over" and any(image.dtype != np.float32 for image in images):
        found = ", ".join(sorted({str(image.dtype) for image in images}))
        raise InputError(f"pixels that the operator {operator} cannot merge", found=found, allowed="float32")


def layer_entry(pixels: NDArray[Any], patch: Patch, extra: int = 0, runs: int = -1) -> tuple[int, ...]:
    """Return the entry of a layer; `extra` is the address of its runs or depths, `runs` the number of runs or -1."""
    return *pixels_at(pixels, "layer"), extra, runs, *_geometry(patch), 0, 0


def pixels_at(pixels: NDArray[Any], where: str) -> tuple[int, int, int]:
    """Return address, type and number of pixels.

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
    """Return address and number of runs.

    Raises
    ------
    InputError
        Not int32 (k, 2) in C order.
    """
    if runs.dtype != np.int32 or runs.ndim != 2 or runs.shape[1] != 2 or not runs.flags.c_contiguous:
        raise InputError("not an array of runs", found=f"{runs.dtype} {runs.shape}", allowed="int32 (k, 2), C order")
    return runs.__array_interface__["data"][0], runs.shape[0]


def run(kernel: CompiledKernel, numbers: Sequence[int], patches: Sequence[Patch], threads: int = 1) -> int:
    """Run a job on the patches of the target and the layers, with several threads if the target is large enough.

    Returns
    -------
    result : of a kernel that counts something; OK from the others

    Raises
    ------
    InputError
        The size of an array does not fit its patch.
    """
    job = array("q", numbers)
    threads = min(threads, job[SIZE] // PIXELS_A_THREAD)
    parts = [job] if threads < 2 else _parts(job, patches[0], threads)
    kernel.prepare()
    others = [_pool(os.getpid()).submit(kernel, part.buffer_info()[0]) for part in parts[1:]]
    first: int = kernel(parts[0].buffer_info()[0])
    result: int = min([first, *(other.result() for other in others)])
    if result < OK:
        wrong = FIRST_BAD - result
        where = f"layer {wrong - 1}" if wrong else "target"
        raise InputError("the pixels do not fit their patch", where=where, allowed=f"{patches[wrong].count} pixels")
    return result


def _parts(job: array[int], patch: Patch, count: int) -> list[array[int]]:
    """Return the job of each thread: adjacent rows of the target."""
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
    """Return the thread pool of a process; a forked process does not have the threads of its parent."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="blend")


def _geometry(patch: Patch) -> tuple[int, ...]:
    """Return the geometry of a patch: its range, and the sides of its rectangle."""
    rect = patch.rect
    return patch.begin, patch.end, rect.x_begin, rect.y_begin, rect.x_end, rect.y_end
