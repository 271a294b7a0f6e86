"""Partial images for tests, and a serial compositor in float64 that shares no code with what it checks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.comm import Channel, run_loopback
from clusterviz.composite import collect, composite
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect


def random_partial(rng: np.random.Generator, rect: Rect, dtype: type) -> PartialImage:
    """A premultiplied read-only image: colour at most alpha, some pixels fully clear, some fully opaque."""
    shape = (rect.height, rect.width)
    alpha = rng.random(shape) * rng.choice([0.0, 0.3, 1.0], shape)
    alpha[rng.random(shape) < 0.1] = 1.0
    rgba = np.concatenate([rng.random((*shape, 3)) * alpha[..., None], alpha[..., None]], axis=-1)
    pixels = np.rint(rgba * 255).astype(np.uint8) if dtype is np.uint8 else rgba.astype(np.float32)
    pixels.setflags(write=False)
    return PartialImage(rect, pixels)


def random_rect(rng: np.random.Generator, size: tuple[int, int]) -> Rect:
    """A rectangle inside the picture, empty now and then."""
    x, y = np.sort(rng.integers(0, size[0] + 1, 2)), np.sort(rng.integers(0, size[1] + 1, 2))
    return Rect(int(x[0]), int(y[0]), int(x[1]), int(y[1]))


def over_all(partials: Sequence[PartialImage], order: Sequence[int], size: tuple[int, int]) -> np.ndarray:
    """Front to back in float64; bytes as they stand, 0..255."""
    full = 255.0 if partials[order[0]].rgba.dtype == np.uint8 else 1.0
    result = np.zeros((size[1], size[0], 4))
    for rank in reversed(order):
        rect, rgba = partials[rank].rect, partials[rank].rgba.astype(np.float64)
        if rect.pixels:
            window = result[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end]
            window[:] = rgba + (1 - rgba[..., 3:] / full) * window
    return result


def picture(
    channel: Channel,
    partials: Sequence[PartialImage],
    order: Sequence[int],
    size: tuple[int, int],
    algorithm: str,
    root: int = 0,
) -> np.ndarray | None:
    """Composite and collect on one rank."""
    piece, _ = composite(partials[channel.rank], order, channel, algorithm)
    return collect(piece, size, channel, root)


def composite_all(
    partials: Sequence[PartialImage], order: Sequence[int], size: tuple[int, int], algorithm: str, root: int = 0
) -> np.ndarray:
    """The picture that loopback ranks make."""
    results = run_loopback(len(partials), lambda channel: picture(channel, partials, order, size, algorithm, root))
    assert [rank for rank, result in enumerate(results) if result is not None] == [root]
    rgba = results[root]
    assert rgba is not None
    return rgba


def worst_error(partials: Sequence[PartialImage], order: Sequence[int], size: tuple[int, int], algorithm: str) -> float:
    """The largest difference from float64."""
    return float(
        np.max(np.abs(composite_all(partials, order, size, algorithm) - over_all(partials, order, size)), initial=0)
    )
