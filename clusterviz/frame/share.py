"""What a rank has of the volume, and what it has to draw; all but its own bricks is the same on every rank."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import VolumeSummary
from clusterviz.partition import BspTree, bricks_of
from clusterviz.plan.plan import Plan
from clusterviz.scene.complete import VolumeFacts
from clusterviz.scene.values import Scene


@dataclass(frozen=True)
class OpenedVolume:
    """A volume, ready to be planned for.

    Attributes
    ----------
    source : where its voxels are
    layout : how it is cut
    summary : what it holds
    held : bricks that this rank has read and may need, by index; not the same on every rank
    """

    source: Source
    layout: BrickLayout
    summary: VolumeSummary
    held: dict[Index, NDArray[Any]]

    @property
    def facts(self) -> VolumeFacts:
        """What completing a scene needs to know."""
        grid, summary = self.source.grid, self.summary
        low, high = summary.value_range
        percentile_1, percentile_99 = summary.percentile(1.0), summary.percentile(99.0)
        return VolumeFacts(grid.shape_zyx, grid.spacing, grid.corners, low, high, percentile_1, percentile_99)


@dataclass(frozen=True)
class Share:
    """What one rank has to draw.

    Attributes
    ----------
    scene : completed
    plan, tree, dealt : None where there is no volume; `dealt` holds the costs from which the tree was built, float64
        (bz, by, bx): a brick is held where it is above 0
    order : the ranks from front to back
    bricks : this rank's, by index; emptied as they go to the GPU
    """

    scene: Scene
    plan: Plan | None
    tree: BspTree | None
    dealt: NDArray[np.float64] | None
    order: list[int]
    bricks: dict[Index, NDArray[Any]]

    def holds(self, plan: Plan) -> bool:
        """Whether every brick that a plan shows is held by some rank."""
        return self.dealt is not None and not np.any((plan.cost > 0) & (self.dealt == 0))


def indices_of(tree: BspTree, rank: int, cost: NDArray[np.float64]) -> set[Index]:
    """The bricks that a rank draws, as `bricks_of` finds them, as indices (z, y, x)."""
    return {(int(z), int(y), int(x)) for z, y, x in bricks_of(tree, rank, cost)}
