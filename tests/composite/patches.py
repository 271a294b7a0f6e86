"""Random patches of a canvas, and pixels and runs for them."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch
from clusterviz.image.region import Rect

DTYPES = (np.dtype(np.uint8), np.dtype(np.float16), np.dtype(np.float32))
# Narrow canvases, one as wide as a few steps of a kernel, and one wider than a block.
WIDTHS = (1, 3, 7, 40, 1100)


def line(count: int) -> Patch:
    """A patch of one row."""
    return Patch(count, 0, count, Rect(0, 0, count, 1))


@st.composite
def patches(draw: st.DrawFn, width: int, height: int) -> Patch:
    """Any range of any rectangle, often with whole rows or of the whole canvas."""
    whole = draw(st.integers(0, 3))
    x, y = sorted(draw(_two(width))), sorted(draw(_two(height)))
    begin, end = sorted(draw(_two(width * height)))
    if whole & 1:
        x = [0, width]
    if whole & 2:
        begin, end = 0, width * height
    return Patch(width, begin, end, Rect(x[0], y[0], x[1], y[1]))


def _two(most: int) -> st.SearchStrategy[tuple[int, int]]:
    return st.tuples(st.integers(0, most), st.integers(0, most))


def random_pixels(rng: np.random.Generator, count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Premultiplied pixels: some blank, some nearly so, some opaque, with stretches of each."""
    alpha = rng.choice([0, 1e-8, 1 / 255, 0.3, 254 / 255, 1], (count, 1), p=[0.2, 0.1, 0.2, 0.2, 0.2, 0.1])
    stretch = np.sort(rng.integers(0, count + 1, 2))
    alpha[stretch[0] : stretch[1]] = rng.choice([0, 1])
    straight = rng.choice([0, 1 / 255, 0.5, 254 / 255, 1], (count, 3))
    pixels = np.concatenate([straight * alpha, alpha], axis=1)
    return np.rint(pixels * 255).astype(dtype) if dtype == np.uint8 else pixels.astype(dtype)


def random_runs(rng: np.random.Generator, count: int) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Which of so many pixels are active, and their runs."""
    active = rng.random(count) < rng.choice([0.1, 0.5, 0.95])
    return active, runs_of(active)


def runs_of(active: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The runs of the pixels that are active."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]])))
    begin, end = edges[::2], edges[1::2]
    return np.ascontiguousarray(np.stack([begin, end - begin], axis=1).astype(np.int32))
