"""Many layers in one pass: read once each, blended in float32, rounded once.

Merging two images at a time reads and writes the result again for each layer, and rounds bytes each time. Here a strip
of the picture is made from all layers that touch it at once, wherever they lie: whole images in shared memory, received
messages, runs of active pixels.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.patch import Patch
from clusterviz.errors import InputError

# As `vector_code` numbers them.
_KINDS = {np.dtype(np.float32): 0, np.dtype(np.uint8): 1, np.dtype(np.float16): 2}


@dataclass(frozen=True, eq=False)
class Layer:
    """One image's share.

    Attributes
    ----------
    patch : which pixels of the canvas
    pixels : uint8, float16 or float32 (patch.count, 4), premultiplied, C order; with `runs`, the active ones only
    runs : int32 (k, 2), ascending and disjoint: the first active pixel of each run, counted in the patch's own pixels,
        and how many follow each other; None where all pixels are there
    """

    patch: Patch
    pixels: NDArray[Any]
    runs: NDArray[np.int32] | None = None


def blend_layers(layers: Sequence[Layer], patch: Patch, out: NDArray[Any], *, split: int = 0, threads: int = 1) -> None:
    """out = (the first `split` layers over each other) over (the others over each other), clipped to a patch.

    Parameters
    ----------
    layers : front to back, of any types; they may reach outside the patch, or not into it
    patch : of the target, on the same canvas
    out : uint8, float16 or float32 (patch.count, 4), C order; overlaps no layer; every pixel is written
    split : layers in the front group
    threads : how many may work at once

    Raises
    ------
    InputError
        An array of a wrong type or shape.
    """
    from clusterviz.composite import layer_kernels

    numbers = [*_array(out, "out"), len(layers), min(max(split, 0), len(layers)), patch.width, *_place(patch)]
    if not out.flags.writeable or len(out) != patch.count:
        raise InputError("the target does not fit its patch", found=out.shape, allowed=(patch.count, 4))
    for layer in layers:
        runs = layer.runs
        numbers += _array(layer.pixels, "a layer")
        numbers += (0, -1) if runs is None else _runs(runs)
        numbers += _place(layer.patch)
        numbers += (0, 0)
    job = array("q", numbers)
    fault = layer_kernels.blend_layers(job.buffer_info()[0])
    if fault >= 0:
        patch, found = layers[fault].patch, layers[fault].pixels.shape
        raise InputError(
            "a layer does not fit its patch", where=f"layer {fault}", found=found, allowed=(patch.count, 4)
        )


def _array(pixels: NDArray[Any], what: str) -> tuple[int, int, int]:
    """Address, type and number of pixels."""
    kind, shape = _KINDS.get(pixels.dtype, -1), pixels.shape
    if kind < 0 or len(shape) != 2 or shape[1] != 4 or not pixels.flags.c_contiguous:
        found = f"{pixels.dtype} {shape}{'' if pixels.flags.c_contiguous else ', not in C order'}"
        raise InputError(
            "not an array of pixels", where=what, found=found, allowed="uint8, float16 or float32 (n, 4), C order"
        )
    return pixels.__array_interface__["data"][0], kind, shape[0]


def _runs(runs: NDArray[np.int32]) -> tuple[int, int]:
    """Address and number of runs."""
    if runs.dtype != np.int32 or runs.ndim != 2 or runs.shape[1] != 2 or not runs.flags.c_contiguous:
        raise InputError("not an array of runs", found=f"{runs.dtype} {runs.shape}", allowed="int32 (k, 2), C order")
    return runs.__array_interface__["data"][0], runs.shape[0]


def _place(patch: Patch) -> tuple[int, ...]:
    """Where its pixels are: the range and the rectangle's sides."""
    rect = patch.rect
    return patch.begin, patch.end, rect.x_begin, rect.y_begin, rect.x_end, rect.y_end
