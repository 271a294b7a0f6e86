"""The over operator for two images, in place.

For floats, c = f + (1 − α_f)·b in each channel and alpha; product and sum are each rounded to float32. Half floats are
blended in float32 and rounded. For uint8 the division by 255 is rounded to nearest exactly,
(x + 128 + ((x + 128) >> 8)) >> 8, so each merge rounds once, by half a level at most. `over` is the plain NumPy
reference; the compiled kernels equal it bit for bit. `layers.py` blends many layers at once and rounds only once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Pixels
from clusterviz.comm.channel import Channel
from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.job import (
    BEFORE,
    BEHIND,
    COMMON_KERNELS,
    DTYPES,
    check_floats,
    job_head,
    kernel,
    layer_entry,
    run,
)
from clusterviz.errors import InputError
from clusterviz.image.merge import Operator

__all__ = ["DTYPES", "compile_kernels", "over", "put_before", "put_behind"]


def over(front: Pixels, back: Pixels) -> NDArray[Any]:
    """Return front over back, in plain NumPy.

    `front`, `back`: float32, float16 or uint8 (..., 4), both of one type, premultiplied.
    """
    if front.dtype == np.uint8:
        product = back.astype(np.uint32) * (255 - front[..., 3:].astype(np.uint32)) + 128
        return np.minimum(front + ((product + (product >> 8)) >> 8), 255).astype(np.uint8)
    near, far = front.astype(np.float32, copy=False), back.astype(np.float32, copy=False)
    blended: NDArray[Any] = near + (np.float32(1) - near[..., 3:]) * far
    return blended.astype(front.dtype, copy=False)


def put_before(
    target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch, *, operator: Operator = "over"
) -> None:
    """Blend source over target in place, where both have pixels.

    Raises InputError for arrays of different or wrong types, wrong shapes, not in C order, or a target that is
    read-only.

    `target`, `source`: uint8, float16 or float32 (patch.count, 4), both of one type, premultiplied, C order.
    `operator`: merge operator of `image/merge.py`; all but over need float32.
    """
    _put((target, target_patch), (source, source_patch), BEFORE, operator)


def put_behind(
    target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch, *, operator: Operator = "over"
) -> None:
    """Blend target over source in place, where both have pixels; otherwise as `put_before`."""
    _put((target, target_patch), (source, source_patch), BEHIND, operator)


def _put(into: tuple[Pixels, Patch], given: tuple[Pixels, Patch], mode: int, operator: Operator) -> None:
    types = {into[0].dtype, given[0].dtype}
    if len(types) > 1:
        raise InputError("images differ in pixel type", found=", ".join(sorted(map(str, types))))
    check_floats(operator, into[0])
    numbers = [*job_head(*into, 1, mode, operator), *layer_entry(*given)]
    run(kernel("put"), numbers, (into[1], given[1]))


def compile_kernels(channel: Channel) -> None:
    """Compile the blending kernels, or load those that an earlier run compiled; collective.

    One rank of each node compiles while the others wait: all together would be no faster.
    """
    if channel.size == 1:
        return
    if channel.placement().local_rank == 0:
        _load_kernels()
    channel.barrier()
    _load_kernels()


def _load_kernels() -> None:
    for name in COMMON_KERNELS:
        kernel(name).prepare()
