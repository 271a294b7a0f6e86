"""Levels of a volume that a picture uses: which level for which brick of the volume.

A `LevelMap` defines one continuous field, whatever bricks the renderer has: in a brick of level l it is that of the
level's samples, except that on faces, edges and corners that bricks share it is that of the coarsest of them. See
`data/levels.py`, which samples it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import MultilevelSource
from clusterviz.errors import SceneError
from clusterviz.scene.values import Volume


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

    @property
    def is_uniform(self) -> bool:
        """Whether all bricks have one level."""
        return bool((self.levels == self.levels.flat[0]).all())


def choose_levels(volume: Volume, source: MultilevelSource | None, where: str = "volumes[0]") -> LevelMap | None:
    """Return the level of each brick of a volume; None: the volume is drawn as it is.

    Parameters
    ----------
    volume : of the scene
    source : its data; None if they have no levels

    Raises
    ------
    SceneError
        The volume has no levels, or not the one asked for.
    """
    if volume.detail == "full":
        return None
    if source is None:
        text, allowed = "the volume has no levels", "full, or a store that `clusterviz store` wrote"
        raise SceneError(text, where=f"{where}.detail", found=volume.path, allowed=allowed)
    level, last = volume.detail.level, source.levels - 1
    if level > last:
        raise SceneError("no such level", where=f"{where}.detail.level", found=level, allowed=f"0 … {last}")
    layout = BrickLayout(source.grid.shape_zyx, source.brick)
    return LevelMap(np.full(layout.counts_zyx, level, np.uint8), source.brick)
