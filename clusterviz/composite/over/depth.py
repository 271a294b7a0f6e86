"""Depth compositing of opaque images: the nearest colour of each pixel is kept.

A pixel has a colour and a depth, a distance along the view that grows away from the viewer. Where nothing was drawn the
colour is zero and the depth infinite. Of equal depths that of the front image (in the order of the images) is kept, so
the result does not depend on the order of merging. Nothing is rounded. `nearest` is the plain NumPy reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.job import BEFORE, BEHIND, job_head, layer_entry, run
from clusterviz.composite.over.native import kernel
from clusterviz.errors import InputError

Depths = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class DepthLayer:
    """Pixels of one image, with depths.

    Attributes
    ----------
    patch : pixels of the canvas
    pixels : uint8, float16 or float32 (patch.count, 4), C order
    depths : float32 (patch.count,), C order; no NaN, infinite where nothing was drawn
    """

    patch: Patch
    pixels: NDArray[Any]
    depths: Depths


def nearest(front: tuple[NDArray[Any], Depths], back: tuple[NDArray[Any], Depths]) -> tuple[NDArray[Any], Depths]:
    """Return colours (..., 4) and depths (...) of the nearer of two images, in plain NumPy; of equals, the front's."""
    wins = front[1] <= back[1]
    return np.where(wins[..., None], front[0], back[0]), np.where(wins, front[1], back[1])


def put_nearest(target: DepthLayer, source: DepthLayer, *, before: bool, threads: int = 1) -> None:
    """Write the source into the target where it is nearer.

    Parameters
    ----------
    target : layer whose arrays are written
    source : layer of the same pixel type, clipped to the target
    before : whether the source is in front of the target in the order of the images, and is kept at equal depths
    threads : most threads; small targets are merged by one

    Raises
    ------
    InputError
        An array of a wrong type or shape, not in C order, or a target that is read-only.
    """
    if not target.depths.flags.writeable:
        raise InputError("the target's depths are read-only")
    if source.pixels.dtype != target.pixels.dtype:
        raise InputError("images differ in pixel type", found=source.pixels.dtype, allowed=target.pixels.dtype)
    numbers = job_head(target.pixels, target.patch, 1, BEFORE if before else BEHIND, _depths_at(target))
    numbers += layer_entry(source.pixels, source.patch, _depths_at(source))
    run(kernel("depth_kernels", "put_nearest"), numbers, [target.patch, source.patch], threads)


def _depths_at(layer: DepthLayer) -> int:
    depths = layer.depths
    if depths.dtype != np.float32 or depths.shape != layer.pixels.shape[:1] or not depths.flags.c_contiguous:
        found = f"{depths.dtype} {depths.shape} for pixels {layer.pixels.shape}"
        raise InputError("not the depths of these pixels", found=found, allowed="float32 (n,), C order")
    address: int = depths.__array_interface__["data"][0]
    return address
