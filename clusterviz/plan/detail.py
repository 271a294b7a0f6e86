"""Levels of a volume that a picture uses: which level for which brick of the volume, and of the domain.

A `LevelMap` defines one continuous field, whatever bricks the renderer has. See `data/levels.py`, which samples it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.levels import LevelMap
from clusterviz.data.source import MultilevelSource
from clusterviz.errors import SceneError
from clusterviz.plan.domain import Cut
from clusterviz.scene.values import Volume

ROUNDING = 1e-6
"""Part of a brick of a volume that a brick of the domain does not touch."""


def choose_levels(volume: Volume, source: MultilevelSource | None, where: str = "volumes[0]") -> LevelMap | None:
    """Return the level of each brick of a volume; None: the volume is drawn as it is.

    Levels that depend on the view are the finest here, see `refinement.py`. `volume`: of the scene. `source`: its data;
    None if they have no levels. Raises SceneError: the volume has no levels, or not the one asked for.
    """
    if volume.detail == "full":
        return None
    if source is None:
        text, allowed = "the volume has no levels", "full, a store that `clusterviz store` wrote, or `array: LEVEL`"
        raise SceneError(text, where=f"{where}.detail", found=volume.path, allowed=allowed)
    level, last = volume.detail.level or 0, source.levels - 1
    if level > last:
        raise SceneError("no such level", where=f"{where}.detail.level", found=level, allowed=f"0 … {last}")
    layout = BrickLayout(source.grid.shape_zyx, source.brick)
    return LevelMap(np.full(layout.counts_zyx, level, np.uint8), source.brick)


def levels_in_bricks(cut: Cut, level_map: LevelMap) -> NDArray[np.uint8]:
    """Return the finest level that each brick of the domain touches, uint8 (bz, by, bx).

    A brick with samples of this level holds the field of all bricks of the volume in it.
    """
    if level_map.is_uniform:
        return np.full(cut.layout.counts_zyx, level_map.levels.flat[0], np.uint8)
    low, high = replace(cut, reach=0).images(*cut.brick_edges())
    last = np.array(level_map.levels.shape[::-1]) - 1
    first = np.clip(np.floor(low / level_map.brick + ROUNDING), 0, last).astype(int)
    end = np.clip(np.ceil(high / level_map.brick - ROUNDING) - 1, first, last).astype(int)
    found = np.full(cut.layout.counts_zyx, 255, np.uint8)
    for offset in np.ndindex(*((end - first).reshape(-1, 3).max(axis=0) + 1).tolist()):
        x, y, z = np.moveaxis(np.minimum(first + offset, end), -1, 0)
        found = np.minimum(found, level_map.levels[z, y, x])
    return found
