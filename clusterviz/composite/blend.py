"""The over operator: a patch of premultiplied pixels put in front of, or behind, a larger one that contains it.

For float32, c = f + (1 − α_f)·b in each channel, alpha too. For uint8 the same with a division by 255 rounded to
nearest exactly, (x + 128 + ((x + 128) >> 8)) >> 8; each merge rounds once, by half a level at most. `over` is the plain
NumPy twin; the numba kernels equal it bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clusterviz.codec.contract import Pixels
from clusterviz.comm.channel import Channel
from clusterviz.composite.patch import Patch
from clusterviz.image.region import Rect

DTYPES = (np.dtype(np.float32), np.dtype(np.uint8))


def over(front: Pixels, back: Pixels) -> Pixels:
    """Front over back in plain NumPy.

    Parameters
    ----------
    front, back : float32 or uint8 (..., 4), premultiplied
    """
    if front.dtype == np.uint8:
        product = back.astype(np.uint32) * (255 - front[..., 3:].astype(np.uint32)) + 128
        return np.minimum(front + ((product + (product >> 8)) >> 8), 255).astype(np.uint8)
    return (front + (np.float32(1) - front[..., 3:]) * back).astype(np.float32, copy=False)


def put_before(target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch) -> None:
    """target = source over target, in place; the target's patch contains the source's."""
    _put(target, target_patch, source, source_patch, True)


def put_behind(target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch) -> None:
    """target = target over source, in place; the target's patch contains the source's."""
    _put(target, target_patch, source, source_patch, False)


def _put(target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch, before: bool) -> None:
    from clusterviz.composite import kernels

    put = kernels.put_bytes if target.dtype == np.uint8 else kernels.put_floats
    runs = (4 * number for number in _runs(target_patch, source_patch))
    seen = source.reshape(-1)
    # Read-only arrays are a type of their own to numba; making all sources so halves what it compiles.
    seen.setflags(write=False)
    put(target.reshape(-1), seen, before, *runs)


def copy(target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch) -> None:
    """target = source where the source has pixels; the target's patch contains the source's."""
    start, skip, length, stride = _runs(target_patch, source_patch)
    taken = 0
    while taken < len(source):
        count = min(length - skip, len(source) - taken)
        target[start + skip : start + skip + count] = source[taken : taken + count]
        taken, start, skip = taken + count, start + stride, 0


def compile_kernels(channel: Channel, dtypes: Sequence[np.dtype[Any]] = DTYPES) -> None:
    """Compile what blending pixels of these types needs, or load it from numba's cache; collective.

    One rank of each node compiles and the others wait and load, since ranks that write numba's cache at once disturb
    each other.
    """
    if channel.size == 1:
        return
    # All import numba at once, which takes longer than loading compiled kernels.
    from clusterviz.composite import kernels  # noqa: F401

    if channel.place().local_rank == 0:
        _blend_one_pixel(dtypes)
    channel.barrier()
    _blend_one_pixel(dtypes)


def _blend_one_pixel(dtypes: Sequence[np.dtype[Any]]) -> None:
    """Call each kernel once: numba compiles a function when it is first called."""
    patch = Patch(1, 0, 1, Rect(0, 0, 1, 1))
    for dtype in dtypes:
        put_before(np.zeros((1, 4), dtype), patch, np.zeros((1, 4), dtype), patch)


def _runs(target: Patch, source: Patch) -> tuple[int, int, int, int]:
    """Where the source's pixels go in the target's: start, skip, length, stride as `kernels.put_floats` takes them."""
    rect, into = source.rect, target.rect
    skip = source.first
    start = (rect.y_begin - into.y_begin) * into.width + rect.x_begin - into.x_begin - target.first
    if rect.width == into.width:
        return start + skip, 0, max(source.count, 1), 0
    return start, skip, rect.width, into.width
