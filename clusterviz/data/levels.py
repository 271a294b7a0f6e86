"""Sampling of a volume whose bricks have several levels: one continuous field, whatever box is read at whatever level.

A `LevelMap` gives each brick a level. Where bricks of several levels meet, on faces, edges and corners, the field is
that of the coarsest of them: samples of finer levels are replaced there by interpolated ones. Going from coarse to
fine, each level's samples are complete before the next finer one is interpolated from them, so levels of neighbours may
differ by any number, and samples where a face meets a still coarser brick are right, too.

Everything is linear along each axis between samples of a level, and constant beyond the last one; so a box read at a
finer level than its bricks holds the same field.

References
----------
M. Weiler, R. Westermann, C. Hansen, K. Zimmermann, T. Ertl: Level-of-detail volume rendering via 3D textures, IEEE
Volume Visualization 2000, section 3 (interpolated samples at borders).
J. Beyer, M. Hadwiger, T. Möller, L. Fritz: Smooth mixed-resolution GPU volume rendering, IEEE/EG Volume Graphics 2008.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import Box, read_boxes
from clusterviz.data.source import Grid, Index, MultilevelSource, as_index


@dataclass(frozen=True, eq=False)
class LevelMap:
    """Level of each brick of a volume.

    Attributes
    ----------
    levels : uint8 (z, y, x bricks), for cubes of `brick` cells, see `BrickLayout.counts_zyx`; 0 is the finest level
    brick : cells of the finest level along the side of a brick; where levels differ, a multiple of 2^(coarsest level)
    """

    levels: NDArray[np.uint8]
    brick: int

    def __post_init__(self) -> None:
        coarsest = int(self.levels.max())
        if not self.is_uniform and self.brick % (1 << coarsest):
            raise ValueError(f"bricks of {self.brick} cells have no border at samples of level {coarsest}")

    @cached_property
    def is_uniform(self) -> bool:
        return bool((self.levels == self.levels.flat[0]).all())

    def around(self, box: Box, level: int) -> NDArray[np.uint8]:
        """Return the levels of the bricks that hold samples of a half-open box of a level, also on their borders."""
        return self.levels[tuple(slice(first, last + 1) for first, last in self._bricks(box, level))]

    def coarser_parts(self, box: Box, level: int) -> Iterator[tuple[slice, slice, slice]]:
        """Yield the parts of a half-open box of samples of a level that lie in or on bricks of coarser levels."""
        begin, end = box
        for brick in product(*(range(first, last + 1) for first, last in self._bricks(box, level))):
            if self.levels[brick] > level:
                low = [max(b, i * self.brick >> level) for b, i in zip(begin, brick, strict=True)]
                # The last brick along an axis holds what lies beyond it.
                high = [
                    e if i == count - 1 else min(e, ((i + 1) * self.brick >> level) + 1)
                    for e, i, count in zip(end, brick, self.levels.shape, strict=True)
                ]
                z, y, x = (slice(a - b, c - b) for a, b, c in zip(low, begin, high, strict=True))
                yield z, y, x

    def _bricks(self, box: Box, level: int) -> list[tuple[int, int]]:
        return [
            (min(max(0, -(-(b << level) // self.brick) - 1), count - 1), min((e - 1 << level) // self.brick, count - 1))
            for b, e, count in zip(*box, self.levels.shape, strict=True)
        ]


def mixed_type(dtype: np.dtype[Any], level_map: LevelMap) -> np.dtype[Any]:
    """Return the type of samples: the volume's if bricks have one level, else float32, or float64 of wider types."""
    return dtype if level_map.is_uniform else np.result_type(dtype, np.float32)


@dataclass(frozen=True, eq=False)
class MixedSource:
    """Field of a volume with a `LevelMap`, at the positions of the samples of one level.

    Attributes
    ----------
    level : whose samples are read; bricks of finer levels beside a box count as of this one
    """

    source: MultilevelSource
    level_map: LevelMap
    level: int

    @property
    def name(self) -> str:
        return self.source.name

    @property
    def grid(self) -> Grid:
        """Grid of the samples; the last one along an axis may lie beyond the volume."""
        return self.source.grid.covering(self.level)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the samples; see `mixed_type`. They are interpolated where the level is finer than the map's."""
        own, levels = self.source.dtype, self.level_map
        return own if levels.is_uniform and levels.levels.flat[0] <= self.level else np.result_type(own, np.float32)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        return self.read_boxes([(begin_zyx, end_zyx)])[0]

    def read_boxes(self, boxes: list[Box]) -> list[NDArray[Any]]:
        return _sampled(self, boxes, self.level)


def _sampled(field: MixedSource, boxes: list[Box], level: int) -> list[NDArray[Any]]:
    """Return the field at the samples of a level, from that level and from coarser ones where bricks are coarser."""
    parts = [list(field.level_map.coarser_parts(box, level)) for box in boxes]
    masks: list[NDArray[np.bool_]] = []
    for box, coarser in zip(boxes, parts, strict=True):
        masks.append(np.zeros(np.subtract(box[1], box[0]), bool))
        for part in coarser:
            masks[-1][part] = True
    own = [n for n, mask in enumerate(masks) if not mask.all()]
    mixed = [n for n, mask in enumerate(masks) if mask.any()]
    found = [np.empty(0, field.dtype)] * len(boxes)
    for n, samples in zip(own, _read_level(field, [boxes[n] for n in own], level), strict=True):
        found[n] = samples.astype(field.dtype, copy=False)
    # Samples of the next coarser level around each box.
    wider = [halved(boxes[n]) for n in mixed]
    for n, box, coarser_samples in zip(mixed, wider, _sampled(field, wider, level + 1) if mixed else [], strict=True):
        finer = _interpolated(coarser_samples, box, boxes[n])
        found[n] = np.where(masks[n], finer, found[n]) if n in own else finer
    return found


def _read_level(field: MixedSource, boxes: list[Box], level: int) -> list[NDArray[Any]]:
    """Read boxes of samples of a level; the last samples are repeated beyond the volume."""
    source = field.source.level(level)
    shape = source.grid.shape_zyx
    inside: list[Box] = []
    for (z, y, x), end in boxes:
        z_end, y_end, x_end = (min(e, n) for e, n in zip(end, shape, strict=True))
        inside.append(((z, y, x), (z_end, y_end, x_end)))
    read = read_boxes(source, inside) or [source.read(*box) for box in inside]
    missing = [np.subtract(end, short) for (_, end), (_, short) in zip(boxes, inside, strict=True)]
    return [
        np.pad(samples, [(0, int(n)) for n in more], mode="edge") if more.any() else samples
        for samples, more in zip(read, missing, strict=True)
    ]


def halved(box: Box) -> Box:
    """Return the box of samples of the next coarser level between which those of a box lie."""
    begin, end = box
    return as_index(b // 2 for b in begin), as_index(e // 2 + 1 for e in end)


def _interpolated(samples: NDArray[Any], box: Box, finer: Box) -> NDArray[Any]:
    """Return the samples of the next finer level in a box, from those of a coarser one in another box."""
    for axis, (first, begin, end) in enumerate(zip(box[0], *finer, strict=True)):
        wanted = np.arange(begin, end)
        finer_samples = np.moveaxis(samples.take(wanted // 2 - first, axis), axis, 0)
        odd = wanted % 2 == 1
        after = np.moveaxis(samples.take(wanted[odd] // 2 + 1 - first, axis), axis, 0)
        with np.errstate(invalid="ignore"):
            finer_samples[odd] = 0.5 * finer_samples[odd] + 0.5 * after
        samples = np.moveaxis(finer_samples, 0, axis)
    return np.ascontiguousarray(samples)
