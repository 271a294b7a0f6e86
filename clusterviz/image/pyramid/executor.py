"""Executor of pyramid filters: any filter by one kernel, a launch a pass, on CPU vectors or OpenGL.

Images are float32 (h, w, c), grids float32 (d, h, w, c), of any number c of channels, filtered alike. Values are those
of the filter's formula in float32; they may not be beyond 4e37 in magnitude (`LARGEST`).

Cost: linear in the pixels. On a GPU each pass sends its source and its result over the bus, which takes longer than
the fetches; a fetch reads four values from a storage buffer, as texture units have weights of 8 bits only.

Reference: M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, 4.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.image.pyramid.contract import Filter, Pass, Step
from clusterviz.jobs.kernel import Kernel, kernel

Floats = NDArray[np.float32]
RATES: dict[Step, tuple[int, int]] = {"reduce": (2, 0), "keep": (1, 0), "double": (1, 1)}
WIDEST = 2**21
LARGEST = 4e37
"""Magnitude up to which values are filtered: the sum of eight is finite, which a driver may form."""


@dataclass
class Fetches:
    """Bilinear fetches that an executor has made."""

    count: int = 0


def _fetch_pixels(
    source: Floats,
    result: Floats,
    channels: int,
    rate: tuple[int, int],
    begin: tuple[int, int, int, int],
    part: tuple[float, float, float, float],
    sides: int,
) -> None:
    """Fetch each pixel of a pass.

    `begin`, `part` : whole and fractional parts of the offsets, at even pixels of fetches before and behind the place,
    then at odd ones; `sides` : 2, or 1 if there is no fetch behind it.
    """


def kernels_of(name: str, function: Callable[..., None]) -> dict[bool, Kernel]:
    """Return kernels of `source` and `result`, by whether they take channels by four."""
    files, writes = ("numbers.glsl", "pyramid/bilinear.glsl", f"pyramid/{name}.glsl"), ("result",)
    return {
        False: kernel("pyramid/channels.glsl", *files, writes=writes)(function),
        True: kernel("pyramid/channels_by_four.glsl", *files, writes=writes, vectors=("source", "result"))(function),
    }


def launch(kernels: Mapping[bool, Kernel], image: Floats, sides: Sequence[int], *arguments: Any) -> Floats:
    """Return an image of another size that a kernel computes from one; `arguments` follow the number of channels."""
    channels = image.shape[-1]
    by_four = channels % 4 == 0
    count, last = (channels // 4, (4,)) if by_four else (channels, ())
    result = np.empty((*sides, channels), np.float32)
    source, target = (
        array.reshape(*array.shape[:-2], array.shape[-2] * count, *last)
        for array in (np.ascontiguousarray(image), result)
    )
    kernels[by_four][(*sides[:-1], sides[-1] * count)](source, target, count, *arguments)
    return result


FETCH = kernels_of("fetch", _fetch_pixels)


def apply_filter(
    filter: Filter, image: Floats, size: Sequence[int] | None = None, fetches: Fetches | None = None
) -> Floats:
    """Return the image after a filter.

    Parameters
    ----------
    filter : basic, analysis or synthesis
    image : float32 (h, w, c) or (d, h, w, c), no side 0
    size : of a synthesis, (h, w) or (d, h, w) of its result, of which ⌈half⌉ are those of the image; default: twice

    Returns
    -------
    image : float32, of the same number of axes and channels

    Raises
    ------
    InputError
        The image has another type or number of axes, or the size does not fit.
    """
    pixels = check_image(image)
    sides = pixels.shape[:-1]
    for each in filter.passes:
        if each.step == "reduce":
            sides = halved(sides)
        elif each.step == "double":
            sides = _doubled(sides, size)
        pixels = _run(each, pixels, tuple(side + each.more for side in sides))
        if fetches is not None:
            fetches.count += math.prod(pixels.shape[:-1]) * each.fetches(len(sides))
    return pixels


def check_image(image: NDArray[np.generic]) -> Floats:
    """Return an image, or refuse what is none.

    Raises
    ------
    InputError
        It is not float32, has no pixels, or another number of axes.
    """
    if image.dtype != np.float32 or image.ndim not in (3, 4) or 0 in image.shape or image.shape[-2] > WIDEST:
        allowed = f"float32 (h, w, c) or (d, h, w, c), w up to {WIDEST}"
        raise InputError("no image", where="pyramid", found=f"{image.dtype} {image.shape}", allowed=allowed)
    return image  # type: ignore[return-value]


def halved(sides: Sequence[int]) -> tuple[int, ...]:
    """Return the size of the next coarser level."""
    return tuple((side + 1) // 2 for side in sides)


def build_levels(filter: Filter, image: Floats, count: int, fetches: Fetches | None = None) -> list[Floats]:
    """Return an image and `count` coarser levels of it; fewer where a level is a single pixel."""
    levels = [image]
    while len(levels) <= count and max(levels[-1].shape[:-1]) > 1:
        levels.append(apply_filter(filter, levels[-1], fetches=fetches))
    return levels


def _doubled(sides: Sequence[int], size: Sequence[int] | None) -> tuple[int, ...]:
    if size is None:
        return tuple(2 * side for side in sides)
    if halved(size) != tuple(sides):
        allowed = " × ".join(f"{2 * side - 1} or {2 * side}" for side in sides)
        raise InputError("wrong size of a synthesis", where="pyramid", found=tuple(size), allowed=allowed)
    return tuple(size)


def _run(each: Pass, image: Floats, sides: Sequence[int]) -> Floats:
    odd = each.odd if each.step == "double" else each.offset
    offsets = [place + side * each.spread for place in (each.offset, odd) for side in (-1, 1)]
    begin = tuple(math.floor(offset) for offset in offsets)
    part = tuple(offset - whole for offset, whole in zip(offsets, begin, strict=True))
    return launch(FETCH, image, sides, RATES[each.step], begin, part, each.fetches(1))
