"""A source whose samples lie elsewhere than its file says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.data.header import place
from clusterviz.data.source import Index, Source
from clusterviz.scene.values import Volume


@dataclass(frozen=True)
class PlacedSource:
    """The samples of `source` on another grid of the same shape."""

    source: Source
    grid: Grid

    @property
    def name(self) -> str:
        return self.source.name

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.source.dtype

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """The samples of the box; see `Source.read`."""
        return self.source.read(begin_zyx, end_zyx)


def placed(source: Source, volume: Volume) -> Source:
    """The source with the spacing, origin and direction of the scene's volume, where the scene has them."""
    if volume.spacing is None and volume.origin is None and volume.direction is None:
        return source
    grid = source.grid
    axes = np.array(volume.direction or grid.direction)
    steps = axes / np.linalg.norm(axes, axis=0) * np.array(volume.spacing or grid.spacing)
    moved = place(grid.shape_zyx, steps, volume.origin or grid.origin, source.name)
    return PlacedSource(source, replace(moved, orientation="" if volume.direction else grid.orientation))
