"""Volumes that are made of another one: guarded, on another grid, or with a thickness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab
from clusterviz.data.bricks import Box, read_boxes
from clusterviz.data.header import check_box, make_grid
from clusterviz.data.source import Grid, Index, MultilevelSource, Source, levels_of
from clusterviz.errors import DataError, guard


@dataclass(frozen=True)
class DerivedSource:
    """Base of volumes that are made of another one: their name, type and part of a file are that one's."""

    source: Any

    @property
    def name(self) -> str:
        return str(self.source.name)

    @property
    def dtype(self) -> np.dtype[Any]:
        found: np.dtype[Any] = self.source.dtype
        return found

    @property
    def slab(self) -> Hyperslab | None:
        return getattr(self.source, "slab", None)


@dataclass(frozen=True)
class _OfSource(DerivedSource):
    """Base of sources with the samples of another one, and its levels if it is a `MultilevelSource`."""

    source: Source

    @property
    def version(self) -> str:
        """Tells the data from what is there after a change, if the format can; else empty."""
        return getattr(self.source, "version", "")

    @property
    def levels(self) -> int:
        """Number of levels; 0: it is no `MultilevelSource`."""
        return getattr(self.source, "levels", 0)

    @property
    def brick(self) -> int:
        return self._multilevel.brick

    def bounds(self, number: int) -> NDArray[np.float64]:
        with guard(DataError, self.name):
            return self._multilevel.bounds(number)

    def at_time(self, time: int) -> Source | None:
        with guard(DataError, self.name):
            found = getattr(self.source, "at_time", lambda step: None)(time)
            return cast("Source", replace(self, source=found)) if found is not None else None

    def is_same(self, other: Source, begin_zyx: Index, end_zyx: Index) -> bool:
        known, there = getattr(self.source, "is_same", None), getattr(other, "source", None)
        with guard(DataError, self.name):
            return bool(known and there and known(there, begin_zyx, end_zyx))

    @property
    def _multilevel(self) -> MultilevelSource:
        found = levels_of(self.source)
        assert found, "the source has levels"
        return found


@dataclass(frozen=True)
class GuardedSource(_OfSource):
    """Source whose failures are all `DataError`, whatever library reads it."""

    @property
    def grid(self) -> Grid:
        return self.source.grid

    def level(self, number: int) -> Source:
        with guard(DataError, self.name):
            return GuardedSource(self._multilevel.level(number)) if number else self

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        with guard(DataError, self.name):
            return self.source.read(begin_zyx, end_zyx)

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]] | None:
        with guard(DataError, self.name):
            return read_boxes(self.source, boxes)


@dataclass(frozen=True)
class GridOverride(_OfSource):
    """Source with the samples of another one on a different grid of the same shape."""

    grid: Grid

    def level(self, number: int) -> Source:
        return GridOverride(self._multilevel.level(number), self.grid.coarser(number)) if number else self

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        return self.source.read(begin_zyx, end_zyx)

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]] | None:
        return read_boxes(self.source, boxes)


@dataclass(frozen=True)
class ThickSource(GridOverride):
    """Source with one sample along an axis, repeated so that it fills a layer as thick as its pixels are wide.

    Without it, a slice or a picture is a volume without thickness, of which no ray has a segment. Levels of a store are
    hidden: two samples have no coarser level than one has.
    """

    @property
    def levels(self) -> int:
        return 0

    def is_same(self, other: Source, begin_zyx: Index, end_zyx: Index) -> bool:
        return super().is_same(other, *self._stored((begin_zyx, end_zyx)))

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        return self._repeated(super().read(*self._stored((begin_zyx, end_zyx))), (begin_zyx, end_zyx))

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]] | None:
        found = super().read_boxes([self._stored(box) for box in boxes])
        return found and [self._repeated(*each) for each in zip(found, boxes, strict=True)]

    def _stored(self, box: Box) -> Box:
        sides = self.source.grid.shape_zyx
        begin = tuple(min(i, side - 1) for i, side in zip(box[0], sides, strict=True))
        end = tuple(min(i, side) for i, side in zip(box[1], sides, strict=True))
        return cast("Box", (begin, end))

    def _repeated(self, samples: NDArray[Any], box: Box) -> NDArray[Any]:
        return np.broadcast_to(samples, [end - begin for begin, end in zip(*box, strict=True)])


def with_thickness(source: Source) -> Source:
    """Return a source with at least two samples along each axis; one with a single sample there is repeated."""
    grid = source.grid
    sides, spacing = np.array(grid.shape_zyx[::-1]), np.array(grid.spacing)
    is_thin = sides == 1
    if not is_thin.any():
        return source
    width = spacing[~is_thin].min() if not is_thin.all() else spacing.min()
    steps = np.array(grid.direction) * np.where(is_thin, width, spacing)
    z, y, x = (max(2, side) for side in grid.shape_zyx)
    origin = np.array(grid.origin) - steps[:, is_thin].sum(axis=1) / 2
    found = make_grid((z, y, x), steps, origin, source.name)
    return ThickSource(source, replace(found, orientation=grid.orientation, modality=grid.modality))
