"""Blending of many layers in one pass: each is read once, blended in float32, and the result is rounded once.

Merging two images at a time reads and writes the result again for each layer, and rounds bytes each time. Here all
layers that touch a patch are blended at once: whole images in shared memory, received messages, runs of active pixels.
Bytes are within 0.51 levels of the exact picture for any number of layers, floats within n·2⁻²³. Floats may also be
merged by the operators of projections. `plain_layers` is the plain NumPy reference; the compiled kernel equals it bit
for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.job import check_floats, job_head, kernel, layer_entry, run
from clusterviz.image.merge import MERGES, Operator


@dataclass(frozen=True, eq=False)
class Layer:
    patch: Patch  # pixels of the canvas
    # uint8, float16 or float32 (patch.count, 4), premultiplied, C order; with `runs`, the active ones only
    pixels: NDArray[Any]
    # int32 (k, 2), ascending and disjoint: index in the patch of the first active pixel of each run, and length of the
    # run; None if all pixels are stored
    runs: NDArray[np.int32] | None = None


def blend_layers(
    layers: Sequence[Layer], patch: Patch, out: NDArray[Any], *, operator: Operator = "over", split: int = 0
) -> None:
    """Blend layers into `out`: (the first `split` over each other) over (the others over each other).

    Raises InputError for an array of a wrong type or shape, not in C order, or a target that is read-only.

    Parameters
    ----------
    layers : layers from front to back, of any types; they are clipped to the patch
    out : uint8, float16 or float32 (patch.count, 4), C order; overlaps no layer; every pixel is written
    operator : merge operator of `image/merge.py`; all but over need float32 arrays
    """
    check_floats(operator, out, *(layer.pixels for layer in layers))
    numbers = job_head(out, patch, len(layers), min(max(split, 0), len(layers)), operator)
    for layer in layers:
        numbers += layer_entry(layer.pixels, layer.patch, layer.runs)
    run(kernel("blend_layers"), numbers, [patch, *(layer.patch for layer in layers)])


def plain_layers(
    layers: Sequence[Layer], patch: Patch, dtype: np.dtype[Any], split: int = 0, operator: Operator = "over"
) -> NDArray[Any]:
    """Return what `blend_layers` writes, (patch.count, 4), computed with whole canvases in plain NumPy."""
    bottom = max(place.rect.y_end for place in (patch, *(layer.patch for layer in layers)))
    groups = []
    for group in (layers[:split], layers[split:]):
        groups.append(np.zeros((patch.width * bottom, 4), np.float32))
        for layer in group:
            behind = np.zeros_like(groups[-1])
            behind[_active(layer)] = _as_floats(layer.pixels)
            groups[-1] = MERGES[operator](groups[-1], behind)
    blended = MERGES[operator](*(group[_numbers(patch)] for group in groups))
    if dtype == np.uint8:
        blended = np.clip(blended * np.float32(255) + np.float32(0.5), 0, 255)
    result: NDArray[Any] = blended.astype(dtype)
    return result


def _as_floats(pixels: NDArray[Any]) -> NDArray[np.float32]:
    floats = pixels.astype(np.float32)
    return floats * np.float32(1 / 255) if pixels.dtype == np.uint8 else floats


def _numbers(patch: Patch) -> NDArray[np.int64]:
    rect = patch.rect
    rows, columns = np.arange(rect.y_begin, rect.y_end), np.arange(rect.x_begin, rect.x_end)
    numbers = (rows[:, None] * patch.width + columns).reshape(-1)
    return numbers[(numbers >= patch.begin) & (numbers < patch.end)]


def _active(layer: Layer) -> NDArray[np.int64]:
    numbers = _numbers(layer.patch)
    if layer.runs is None:
        return numbers
    return np.concatenate([numbers[first : first + length] for first, length in layer.runs] + [numbers[:0]])
