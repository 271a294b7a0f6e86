"""What `clusterviz bench over` measures: every form of the over operator, on images that wait in no cache.

A variant works on one of several sets of images; sets take turns, so that none is still in a cache when its turn comes.
All images are slices of one pool of random premultiplied pixels.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.blend import merge_runs, over, over_into, put_before, put_behind
from clusterviz.composite.over.depth import DepthLayer, put_nearest
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.image.region import Rect

RUN = 64  # active pixels in a row, and as many blank ones after them, in the variants with runs
_TILE = 1 << 18  # pixels that are really random; the pool repeats them


@dataclass(frozen=True)
class Variant:
    """One form of the operator.

    Attributes
    ----------
    call : does it on set number k
    sets : how many sets there are
    copies : how many images' bytes a fair copy would move
    slow : whether a few repetitions must do
    threaded : whether it may use all cores
    """

    call: Callable[[int], object]
    sets: int
    copies: float = 1.0
    slow: bool = False
    threaded: bool = False


@dataclass(frozen=True)
class Pool:
    """Sets of images of one size and type: float32, float16 or uint8 (sets, images, pixels, 4)."""

    images: NDArray[Any]
    size: tuple[int, int]

    @property
    def patch(self) -> Patch:
        """A whole image."""
        return Patch(self.size[0], 0, self.size[0] * self.size[1], Rect(0, 0, *self.size))


def make_pool(pixel: type, size: tuple[int, int], images: int, cache_bytes: int) -> Pool:
    """At least two sets of so many images, and together more than a cache holds."""
    count = size[0] * size[1]
    sets = max(2, -(-cache_bytes // (images * count * 4 * np.dtype(pixel).itemsize)))
    rng = np.random.default_rng(0)
    alpha = rng.random((_TILE, 1), np.float32)
    tile = np.concatenate([rng.random((_TILE, 3), np.float32) * alpha, alpha], axis=1)
    tile = np.rint(tile * 255).astype(np.uint8) if pixel is np.uint8 else tile.astype(pixel)
    return Pool(np.resize(tile, (sets, images, count, 4)), size)


def pairs(pool: Pool) -> dict[str, Variant]:
    """A copy of one image, two images into one, and the plain twin."""
    front, target, patch, sets = pool.images[:, 0], pool.images[:, 1], pool.patch, len(pool.images)
    return {
        "copy": Variant(lambda k: np.copyto(target[k], front[k]), sets),
        "put_before": Variant(lambda k: put_before(target[k], patch, front[k], patch), sets),
        "put_behind": Variant(lambda k: put_behind(target[k], patch, front[k], patch), sets),
        "numpy": Variant(lambda k: over(front[k], target[k]), sets, slow=True),
    }


def shapes(pool: Pool) -> dict[str, Variant]:
    """Two images in other ways: out of place, only a rectangle, only runs of active pixels, the nearer one, threads."""
    front, back, out, patch = (*(pool.images[:, index] for index in range(3)), pool.patch)
    (width, height), cores, sets = pool.size, os.cpu_count() or 1, len(pool.images)
    middle = Patch(width, 0, width * height, Rect(width // 4, 0, width // 4 + width // 2, height))
    active, runs = patch.count // (2 * RUN) * RUN, _every_second_run(patch.count)
    depths = np.resize(np.random.default_rng(1).random((_TILE,), np.float32), (sets, 2, patch.count))
    into_strip = [[Layer(patch, half[k][:active], runs) for half in (front, back)] for k in range(sets)]
    fragments = [
        [DepthLayer(patch, half[k], depths[k, number]) for number, half in enumerate((front, out))] for k in range(sets)
    ]
    return {
        "out of place": Variant(lambda k: over_into(out[k], front[k], back[k]), sets),
        "rectangle into strip": Variant(
            lambda k: put_before(out[k], patch, front[k][: middle.count], middle), sets, middle.count / patch.count
        ),
        "runs over runs": Variant(
            lambda k: merge_runs((front[k][:active], runs), (back[k][:active], runs)), sets, active / patch.count
        ),
        "runs into strip": Variant(lambda k: blend_layers(into_strip[k], patch, out[k]), sets),
        "nearest": Variant(lambda k: put_nearest(fragments[k][1], fragments[k][0], before=True), sets),
        "in place, all cores": Variant(
            lambda k: put_before(out[k], patch, front[k], patch, threads=cores), sets, threaded=True
        ),
    }


def _every_second_run(count: int) -> NDArray[np.int32]:
    first = np.arange(0, count // (2 * RUN) * 2 * RUN, 2 * RUN, dtype=np.int32)
    return np.stack([first, np.full_like(first, RUN)], axis=1)


def many(pool: Pool) -> dict[str, Variant]:
    """Two, four and eight layers into one image of bytes, on one core and on all of them."""
    patch, cores, sets = pool.patch, os.cpu_count() or 1, len(pool.images)
    out = np.zeros((sets, patch.count, 4), np.uint8)

    def blend(count: int, threads: int) -> Variant:
        layers = [[Layer(patch, image) for image in images[:count]] for images in pool.images]
        call = lambda k: blend_layers(layers[k], patch, out[k], threads=threads)  # noqa: E731
        return Variant(call, sets, copies=count, threaded=threads > 1)

    counts = [count for count in (2, 4, 8) if count <= pool.images.shape[1]]
    one = {f"{count} layers": blend(count, 1) for count in counts}
    return one | {f"{counts[-1]} layers, all cores": blend(counts[-1], cores)}
