"""Random partial images of every kind of pixel, and what must come of merging them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.composite import CompositeCounters, Compositor, collect, composite
from clusterviz.image.merge import CLOSED, EXISTS, STARTS, Operator, merge_partials
from clusterviz.image.partial import PartialImage, Rect

SIZE = (23, 17)
OPERATORS: tuple[Operator, ...] = ("maximum", "minimum", "sum", "run", "two-flux")
DTYPES = (np.dtype(np.uint8), np.dtype(np.float16), np.dtype(np.float32))
KINDS = ("float32", "uint8", *OPERATORS)
"""Colours of these types, merged by over, scalars of projections, or fluxes."""


def random_pixels(rng: np.random.Generator, count: int, kind: Any) -> NDArray[Any]:
    """Pixels (count, 4) of a kind, with a run of blank ones or of others."""
    run = slice(*np.sort(rng.integers(0, count + 1, 2)))
    if kind in OPERATORS:
        return _random_scalars(rng, count, kind, run)
    alpha = rng.choice([0, 1e-8, 1 / 255, 0.3, 254 / 255, 1], (count, 1)) * rng.choice([1, rng.random()], (count, 1))
    alpha[run] = rng.choice([0, 1])
    straight = rng.choice([0, 1 / 255, 0.5, 254 / 255, 1], (count, 3))
    pixels = np.concatenate([straight * alpha, alpha], axis=1)
    return (np.rint(pixels * 255) if kind == "uint8" else pixels).astype(kind)


def _random_scalars(rng: np.random.Generator, count: int, operator: str, run: slice) -> NDArray[np.float32]:
    seen = rng.random(count) < rng.choice([0.2, 0.7, 1.0])
    seen[run] = rng.random() < 0.5
    pixels = np.zeros((count, 4), np.float32)
    # Few values, so that many are equal; the scalar 0 is not a blank pixel.
    scalars = rng.choice(np.float32([-1.5, -1e-8, 0, 1e-8, 0.3, 0.7, 1, 40]), (2, count))
    pixels[:, 0], pixels[:, 3] = scalars[0], 1
    if operator == "sum":
        pixels[:, 3] = rng.choice(np.float32([1, 2, 0.3, 17]), count)
        pixels[:, 0] = np.abs(pixels[:, 0]) * rng.random(count, np.float32)
    if operator == "run":
        exists = rng.random(count) < 0.7
        flags = EXISTS + rng.choice([0, STARTS], count) + rng.choice([0, CLOSED], count)
        pixels[:, 0] = np.where(exists, scalars[0], 0)
        pixels[:, 1] = np.where(exists, scalars.max(axis=0), scalars[1])
        pixels[:, 2] = np.where(exists, flags, 0)
    if operator == "two-flux":
        pixels[:, :2] = rng.choice(np.float32([0, 1e-8, 0.3, 1 - 2.0**-24, 1]), (count, 2))
        pixels[:, 2] = rng.choice(np.float32([0, 1e-8, 0.5, 1]), count) * (1 - pixels[:, :2].max(axis=1))
    pixels[~seen] = 0
    return pixels


def random_rect(rng: np.random.Generator, size: tuple[int, int] = SIZE) -> Rect:
    """A rectangle inside the picture, empty now and then."""
    x, y = np.sort(rng.integers(0, size[0] + 1, 2)), np.sort(rng.integers(0, size[1] + 1, 2))
    return Rect(int(x[0]), int(y[0]), int(x[1]), int(y[1]))


def random_image(rng: np.random.Generator, rect: Rect, kind: Any = "float32") -> PartialImage:
    """A read-only partial image."""
    pixels = random_pixels(rng, rect.pixels, kind).reshape(rect.height, rect.width, 4)
    pixels.setflags(write=False)
    return PartialImage(rect, pixels)


@dataclass(frozen=True, eq=False)
class Case:
    """Partial images from front to back, and the rank of each."""

    ranks: int
    order: Sequence[int]
    images: Sequence[PartialImage]
    kind: str = "float32"
    size: tuple[int, int] = SIZE

    @property
    def operator(self) -> Operator:
        return self.kind if self.kind in OPERATORS else "over"  # type: ignore[return-value]

    def of(self, rank: int) -> list[PartialImage]:
        """A rank's own images."""
        return [image for image, owner in zip(self.images, self.order, strict=True) if owner == rank]

    def check(self, made: np.ndarray | None, roundings: int = 1) -> None:
        """Compare with merging one by one; bytes and halves may be rounded so many times, to half a level each."""
        assert made is not None
        if self.kind in OPERATORS:
            wanted = merge_partials(self.images, self.size, self.operator)
            assert made.dtype == np.float32
            # n additions, each rounded, of terms of one sign.
            bound = len(self.images) * 2.0**-23 * np.abs(wanted) if self.kind == "sum" else 0.0
            bound = len(self.images) * 2.0**-21 if self.kind == "two-flux" else bound
            assert np.all(np.abs(made - wanted) <= bound)
            return
        assert made.dtype == self.kind
        bound = {"uint8": 0.5 * roundings + 0.01, "float16": roundings * 2.0**-11, "float32": 0.0}[self.kind]
        bound += max(len(self.images), 2) * 2.0**-23
        assert np.abs(made - over_all(self.images, self.size)).max(initial=0) <= bound


def random_case(
    ranks: int, kind: str = "float32", counts: Sequence[int] | None = None, seed: int | None = None, **keys: Any
) -> Case:
    """One image a rank, or so many, anywhere, in any order."""
    rng = np.random.default_rng(ranks if seed is None else seed)
    order = rng.permutation(np.repeat(np.arange(ranks), 1 if counts is None else counts)).tolist()
    return Case(
        ranks, order, [random_image(rng, random_rect(rng, keys.get("size", SIZE)), kind) for _ in order], kind, **keys
    )


def dense_case(ranks: int, kind: str = "float32", size: tuple[int, int] = SIZE) -> Case:
    """Images of the whole picture, in the order of ranks."""
    rng = np.random.default_rng(ranks)
    return Case(ranks, range(ranks), [random_image(rng, Rect(0, 0, *size), kind) for _ in range(ranks)], kind, size)


def over_all(images: Sequence[PartialImage], size: tuple[int, int]) -> np.ndarray:
    """The first in front, in float64; bytes as they stand, 0 to 255."""
    full = 255.0 if images[0].rgba.dtype == np.uint8 else 1.0
    result = np.zeros((size[1], size[0], 4))
    for image in reversed(images):
        rect, rgba = image.rect, image.rgba.astype(np.float64)
        if rect.pixels:
            window = result[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end]
            window[:] = rgba + (1 - rgba[..., 3:] / full) * window
    return result


def compose_on(channel: Channel, case: Case, **options: Any) -> tuple[np.ndarray | None, CompositeCounters]:
    """Two frames by one compositor: the second picture, and what it cost."""
    compositor = Compositor(channel, case.size, operator=case.operator, **options)
    for _ in range(2):
        picture, counters = compositor.composite(case.of(channel.rank), case.order)
        assert (picture is not None) == (channel.rank == options.get("root", 0))
    kept = None if picture is None else picture.copy()
    compositor.close()
    return kept, counters


def picture(channel: Channel, case: Case, algorithm: str, root: int = 0) -> np.ndarray | None:
    """The picture by `composite` and `collect`."""
    owned, _ = composite(case.of(channel.rank), case.order, channel, algorithm, operator=case.operator)
    return collect(owned, case.size, channel, root)


def compose(
    case: Case, algorithm: str = "auto", transport: str = "messages", per_node: int | None = None, **options: Any
) -> tuple[np.ndarray | None, list[CompositeCounters]]:
    """The same on threads: the root's picture, and what it cost each rank."""

    def run(channel: LoopbackChannel) -> tuple[np.ndarray | None, CompositeCounters]:
        return compose_on(channel, case, algorithm=algorithm, transport=transport, **options)

    found = run_loopback(case.ranks, run, ranks_per_node=per_node)
    return found[options.get("root", 0)][0], [counters for _, counters in found]
