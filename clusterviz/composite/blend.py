"""The over operator: a patch of premultiplied pixels put in front of, or behind, a larger one that contains it.

For float32, c = f + (1 − α_f)·b in each channel, alpha too. For uint8 the same with a division by 255 rounded to
nearest exactly, (x + 128 + ((x + 128) >> 8)) >> 8; each merge rounds once, by half a level at most. `over` is the plain
NumPy twin; the numba kernels equal it bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    from clusterviz.composite import kernels

    runs = _runs(target_patch, source_patch)
    if target.dtype == np.uint8:
        kernels.words_before(_words(target), _words(source), *runs)
    else:
        kernels.floats_before(_floats(target), _floats(source), *runs)


def put_behind(target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch) -> None:
    """target = target over source, in place; the target's patch contains the source's."""
    from clusterviz.composite import kernels

    runs = _runs(target_patch, source_patch)
    if target.dtype == np.uint8:
        kernels.words_behind(_words(target), _words(source), *runs)
    else:
        kernels.floats_behind(_floats(target), _floats(source), *runs)


def copy(target: Pixels, target_patch: Patch, source: Pixels, source_patch: Patch) -> None:
    """target = source where the source has pixels; the target's patch contains the source's."""
    start, skip, length, stride = _runs(target_patch, source_patch)
    taken = 0
    while taken < len(source):
        count = min(length - skip, len(source) - taken)
        target[start + skip : start + skip + count] = source[taken : taken + count]
        taken, start, skip = taken + count, start + stride, 0


def compile_kernels(channel: Channel) -> None:
    """Compile what blending needs, or load it from numba's cache; collective.

    One rank of each node compiles and the others wait and load, since ranks that write numba's cache at once disturb
    each other.
    """
    if channel.size == 1:
        return
    if channel.place().local_rank == 0:
        _blend_one_pixel()
    channel.barrier()
    _blend_one_pixel()


def _blend_one_pixel() -> None:
    """Call each kernel once: numba compiles a function when it is first called."""
    patch = Patch(1, 0, 1, Rect(0, 0, 1, 1))
    for dtype in DTYPES:
        for put in (put_before, put_behind):
            # Pixels of the caller may be read-only, which is a type of its own to numba.
            for writable in (True, False):
                source = np.zeros((1, 4), dtype)
                source.setflags(write=writable)
                put(np.zeros((1, 4), dtype), patch, source, patch)


def _floats(pixels: Pixels) -> NDArray[np.float32]:
    """Pixels that are known to be float32."""
    return pixels.view(np.float32)


def _words(pixels: Pixels) -> NDArray[np.uint32]:
    """Pixels as little-endian words, without a copy."""
    return pixels.reshape(-1).view("<u4")


def _runs(target: Patch, source: Patch) -> tuple[int, int, int, int]:
    """Where the source's pixels go in the target's: start, skip, length, stride as in `kernels`."""
    rect, into = source.rect, target.rect
    skip = source.first
    start = (rect.y_begin - into.y_begin) * into.width + rect.x_begin - into.x_begin - target.first
    if rect.width == into.width:
        return start + skip, 0, max(source.count, 1), 0
    return start, skip, rect.width, into.width
