"""Depth compositing for opaque images: the nearest fragment of each pixel wins.

A pixel is a colour and a depth, a distance along the view that grows away from the viewer; where nothing was drawn the
colour is zero and the depth infinite. Of equal depths the one further in front in the order of the images wins, so the
result does not depend on who blends with whom first. Nothing is rounded. `nearest` is the plain NumPy twin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.over.job import entry, head, run
from clusterviz.composite.over.job_layout import BEFORE, BEHIND, FRESH
from clusterviz.composite.over.native import kernel
from clusterviz.composite.patch import Patch
from clusterviz.errors import InputError

Depths = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class DepthLayer:
    """One image's share.

    Attributes
    ----------
    patch : which pixels of the canvas
    pixels : uint8, float16 or float32 (patch.count, 4), C order
    depths : float32 (patch.count,), C order; no NaN, infinite where there is nothing
    """

    patch: Patch
    pixels: NDArray[Any]
    depths: Depths


def nearest(front: tuple[NDArray[Any], Depths], back: tuple[NDArray[Any], Depths]) -> tuple[NDArray[Any], Depths]:
    """Colours (..., 4) and depths (...) of the nearer of two images in plain NumPy; of equals, the front's."""
    wins = front[1] <= back[1]
    return np.where(wins[..., None], front[0], back[0]), np.where(wins, front[1], back[1])


def put_nearest(target: DepthLayer, source: DepthLayer, *, before: bool, threads: int = 1) -> None:
    """Put the source into the target wherever it is nearer, in place.

    Parameters
    ----------
    target : its arrays are written
    source : of the same type of pixel; clipped to the target
    before : whether the source comes before the target in the order of the images, and so wins where depths are equal
    threads : how many may work at once; small targets are not shared out

    Raises
    ------
    InputError
        An array of a wrong type or shape, not in C order, or a target that is read-only.
    """
    _put([source], target, BEFORE if before else BEHIND, threads)


def nearest_layers(
    layers: Sequence[DepthLayer], patch: Patch, out: NDArray[Any], out_depths: Depths, *, threads: int = 1
) -> None:
    """The nearest fragments of many layers, in one pass.

    Parameters
    ----------
    layers : in the order that decides between equal depths, of one type; clipped to the patch
    patch : of the target, on the same canvas
    out : of the layers' type (patch.count, 4), C order; every pixel is written, zero where there is nothing
    out_depths : float32 (patch.count,), infinite where there is nothing
    threads : as in `put_nearest`

    Raises
    ------
    InputError
        As in `put_nearest`.
    """
    _put(layers, DepthLayer(patch, out, out_depths), FRESH, threads)


def _put(layers: Sequence[DepthLayer], target: DepthLayer, wish: int, threads: int) -> None:
    if not target.depths.flags.writeable:
        raise InputError("the target's depths are read-only")
    numbers = head(target.pixels, target.patch, len(layers), wish, _depths_at(target))
    for layer in layers:
        if layer.pixels.dtype != target.pixels.dtype:
            raise InputError("images differ in pixel type", found=layer.pixels.dtype, allowed=target.pixels.dtype)
        numbers += entry(layer.pixels, layer.patch, _depths_at(layer))
    patches = [target.patch, *(layer.patch for layer in layers)]
    run(kernel("depth_kernels", "put_nearest"), numbers, patches, threads)


def _depths_at(layer: DepthLayer) -> int:
    depths = layer.depths
    if depths.dtype != np.float32 or depths.shape != layer.pixels.shape[:1] or not depths.flags.c_contiguous:
        found = f"{depths.dtype} {depths.shape} for pixels {layer.pixels.shape}"
        raise InputError("not the depths of these pixels", found=found, allowed="float32 (n,), C order")
    address: int = depths.__array_interface__["data"][0]
    return address
