"""Jobs of the compiled kernels: tables of int64 in which arrays become addresses.

Arrays that a kernel cannot handle are refused here: wrong types and shapes, arrays that are not in C order or are
read-only. A job is a head for the target, then one entry for each layer. Each has the geometry of its array: the patch
of the canvas (see `fragment.py`) that the array holds.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import kernels
from clusterviz.composite.fragment import Patch
from clusterviz.errors import InputError
from clusterviz.image.merge import Operator
from clusterviz.kernels.compiled import CompiledKernel

# Head: address, type and number of the target's pixels; number of layers, mode, operator, canvas width, geometry.
OUT, KIND, SIZE, LAYERS, MODE, OPERATOR, WIDTH, TARGET = range(8)
HEAD = TARGET + 6

# Layer: address, type and number of its stored pixels; address and number of its runs (-1 for none); geometry; the next
# run, and the number of stored pixels before it.
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

# Modes of two images: the layer is merged behind or before the target. Many layers: those in the front group.
BEHIND, BEFORE = range(2)

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


def job_head(out: NDArray[Any], patch: Patch, layers: int, mode: int, operator: Operator) -> list[int]:
    """Return the head of a job; a target that is read-only raises InputError."""
    if not out.flags.writeable:
        raise InputError("the target is read-only")
    return [*pixels_at(out, "target"), layers, mode, _OPERATORS[operator], patch.width, *_geometry(patch)]


def check_floats(operator: Operator, *images: NDArray[Any]) -> None:
    """Raise InputError if an operator cannot merge the pixels: all but over need float32."""
    if operator != "over" and any(image.dtype != np.float32 for image in images):
        found = ", ".join(sorted({str(image.dtype) for image in images}))
        raise InputError(f"pixels that the operator {operator} cannot merge", found=found, allowed="float32")


def layer_entry(pixels: NDArray[Any], patch: Patch, runs: NDArray[np.int32] | None = None) -> tuple[int, ...]:
    """Return the entry of a layer, with the runs of its stored pixels if it does not store all."""
    return *pixels_at(pixels, "layer"), *runs_at(runs), *_geometry(patch), 0, 0


def pixels_at(pixels: NDArray[Any], where: str) -> tuple[int, int, int]:
    """Return address, type and number of pixels; raise InputError if a kernel cannot handle them."""
    kind, shape = _KINDS.get(pixels.dtype, -1), pixels.shape
    if kind < 0 or len(shape) != 2 or shape[1] != 4 or not pixels.flags.c_contiguous:
        found = f"{pixels.dtype} {shape}{'' if pixels.flags.c_contiguous else ', not in C order'}"
        raise InputError(
            "not an array of pixels", where=where, found=found, allowed="uint8, float16 or float32 (n, 4), C order"
        )
    return pixels.__array_interface__["data"][0], kind, shape[0]


def runs_at(runs: NDArray[np.int32] | None) -> tuple[int, int]:
    """Return address and number of runs, 0 and -1 for None; raise InputError if a kernel cannot handle them."""
    if runs is None:
        return 0, -1
    if runs.dtype != np.int32 or runs.ndim != 2 or runs.shape[1] != 2 or not runs.flags.c_contiguous:
        raise InputError("not an array of runs", found=f"{runs.dtype} {runs.shape}", allowed="int32 (k, 2), C order")
    return runs.__array_interface__["data"][0], runs.shape[0]


def run(kernel: CompiledKernel, numbers: Sequence[int], patches: Sequence[Patch]) -> None:
    """Run a job on the patches of the target and the layers; raise InputError if an array does not fit its patch."""
    kernel.prepare()
    job = array("q", numbers)
    result = kernel(job.buffer_info()[0])
    if result < OK:
        wrong = FIRST_BAD - result
        where = f"layer {wrong - 1}" if wrong else "target"
        raise InputError("the pixels do not fit their patch", where=where, allowed=f"{patches[wrong].count} pixels")


def _geometry(patch: Patch) -> tuple[int, ...]:
    rect = patch.rect
    return patch.begin, patch.end, rect.x_begin, rect.y_begin, rect.x_end, rect.y_end


COMMON_KERNELS = ("blend_layers", "put")
"""Names of all kernels."""
SOURCES = ("job", "vector_code", "intrinsics", "geometry", "merging_pixels", "kernels")


@cache
def kernel(name: str) -> CompiledKernel:
    """Return a function of `kernels.py`, of the address of a job; several threads can call it at once."""
    paths = [Path(__file__).with_name(f"{source}.py") for source in SOURCES]
    paths.append(Path(str(kernels.__file__)).with_name("intrinsics.py"))
    return CompiledKernel("clusterviz.composite.over.kernels", name, "int64", paths, results=1)
