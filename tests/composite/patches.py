"""Random patches of a canvas, and runs of active pixels."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch
from clusterviz.image.partial import Rect


def canvas_of(width: int, height: int) -> Patch:
    return Patch(width, 0, width * height, Rect(0, 0, width, height))


# Narrow ones, one as wide as a few steps of a kernel, and one wider than a block.
CANVASES = st.sampled_from((1, 3, 7, 40, 1100)).flatmap(
    lambda width: st.integers(1, 20 if width < 100 else 3).map(lambda height: canvas_of(width, height))
)


def line(count: int) -> Patch:
    """A patch of one row."""
    return canvas_of(count, 1)


@st.composite
def patches(draw: st.DrawFn, canvas: Patch) -> Patch:
    """Any range of any rectangle, often with whole rows or of the whole canvas."""
    whole, rect = draw(st.integers(0, 3)), canvas.rect
    x, y, span = (
        sorted(draw(st.tuples(st.integers(0, most), st.integers(0, most))))
        for most in (rect.width, rect.height, canvas.count)
    )
    if whole & 1:
        x = [0, rect.width]
    if whole & 2:
        span = [0, canvas.count]
    return Patch(rect.width, *span, Rect(x[0], y[0], x[1], y[1]))


def random_runs(rng: np.random.Generator, count: int) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Which of so many pixels are active, and their runs."""
    active = rng.random(count) < rng.choice([0.1, 0.5, 0.95])
    begin, end = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]]))).reshape(-1, 2).T
    return active, np.ascontiguousarray(np.stack([begin, end - begin], axis=1).astype(np.int32))
