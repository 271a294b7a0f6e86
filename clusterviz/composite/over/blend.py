"""The over operator for two images: in place, out of place, and for runs of active pixels.

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
    DTYPES,
    INTO,
    check_floats,
    job_head,
    layer_entry,
    run,
    runs_at,
)
from clusterviz.composite.over.native import COMMON_KERNELS, kernel
from clusterviz.errors import InputError
from clusterviz.image.merge import Operator
from clusterviz.image.partial import Rect

__all__ = ["DTYPES", "compile_kernels", "merge_runs", "over", "over_into", "put_before", "put_behind"]

# Active pixels (n, 4), and their runs as in `layers.Layer`.
Active = tuple[NDArray[Any], NDArray[np.int32]]


def over(front: Pixels, back: Pixels) -> NDArray[Any]:
    """Return front over back, in plain NumPy.

    Parameters
    ----------
    front, back : float32, float16 or uint8 (..., 4), both of one type, premultiplied
    """
    if front.dtype == np.uint8:
        product = back.astype(np.uint32) * (255 - front[..., 3:].astype(np.uint32)) + 128
        return np.minimum(front + ((product + (product >> 8)) >> 8), 255).astype(np.uint8)
    near, far = front.astype(np.float32, copy=False), back.astype(np.float32, copy=False)
    blended: NDArray[Any] = near + (np.float32(1) - near[..., 3:]) * far
    return blended.astype(front.dtype, copy=False)


def put_before(
    target: Pixels,
    target_patch: Patch,
    source: Pixels,
    source_patch: Patch,
    *,
    operator: Operator = "over",
    threads: int = 1,
) -> None:
    """Blend source over target in place, where both have pixels.

    Parameters
    ----------
    target, source : uint8, float16 or float32 (patch.count, 4), both of one type, premultiplied, C order
    target_patch, source_patch : patches of the canvas
    operator : merge operator of `image/merge.py`; all but over need float32
    threads : most threads; small targets are blended by one

    Raises
    ------
    InputError
        Arrays of different or wrong types, wrong shapes, not in C order, or a target that is read-only.
    """
    _put((target, target_patch), (source, source_patch), BEFORE, operator, threads)


def put_behind(
    target: Pixels,
    target_patch: Patch,
    source: Pixels,
    source_patch: Patch,
    *,
    operator: Operator = "over",
    threads: int = 1,
) -> None:
    """Blend target over source in place, where both have pixels; otherwise as `put_before`."""
    _put((target, target_patch), (source, source_patch), BEHIND, operator, threads)


def _put(into: tuple[Pixels, Patch], given: tuple[Pixels, Patch], mode: int, operator: Operator, threads: int) -> None:
    (target, target_patch), (source, source_patch) = into, given
    _check_types(target, source)
    check_floats(operator, target)
    numbers = [*job_head(target, target_patch, 1, mode, operator=operator), *layer_entry(source, source_patch)]
    run(kernel("pair_kernels", "put"), numbers, (target_patch, source_patch), threads)


def over_into(out: Pixels, front: Pixels, back: Pixels, *, threads: int = 1) -> None:
    """Blend front over back into `out`; all (n, 4) of one type, C order; otherwise as `put_before`."""
    _check_types(out, front, back)
    patch = Patch(1, 0, len(out), Rect(0, 0, 1, len(out)))
    numbers = [*job_head(out, patch, 2, INTO), *layer_entry(front, patch), *layer_entry(back, patch)]
    run(kernel("pair_kernels", "put"), numbers, (patch,) * 3, threads)


def merge_runs(front: Active, back: Active) -> Active:
    """Blend front over back, both runs of active pixels, into runs; blank pixels are not unpacked or blended.

    Parameters
    ----------
    front, back : pixels (n, 4) of one type, and int32 (k, 2) runs, ascending and disjoint, indices in the same patch

    Returns
    -------
    pixels, runs : pixels that are active in either; adjacent runs are joined

    Raises
    ------
    InputError
        As in `put_before`.
    """
    _check_types(front[0], back[0])
    pixels = np.empty((len(front[0]) + len(back[0]), 4), front[0].dtype)
    runs = np.empty((len(front[1]) + len(back[1]), 2), np.int32)
    nowhere = Patch(0, 0, 0, Rect(0, 0, 0, 0))
    numbers = job_head(pixels, nowhere, 2, 0, runs_at(runs)[0])
    for active, where in (front, back):
        numbers += layer_entry(active, nowhere, *runs_at(where))
    count = run(kernel("pair_kernels", "merge_runs"), numbers, (nowhere,) * 3)
    runs = runs[:count]
    return pixels[: int(runs[:, 1].sum())], runs


def _check_types(*images: Pixels) -> None:
    types = {image.dtype for image in images}
    if len(types) > 1:
        raise InputError("images differ in pixel type", found=", ".join(sorted(str(dtype) for dtype in types)))


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
    for names in COMMON_KERNELS:
        kernel(*names).prepare()
