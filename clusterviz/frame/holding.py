"""What ranks may hold, and how that is counted: as bricks lie where they are drawn.

OpenGL keeps a brick as packed words or texels, the processor's ray caster one word a voxel. Who holds what is decided
by all ranks alike, before bricks are loaded; where they draw by different means, every brick counts as it lies where it
takes most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.frame.opening import HELD_SHARE_OF_MEMORY
from clusterviz.frame.run import Run
from clusterviz.plan.plan import Plan
from clusterviz.render.choice import prefers_processor
from clusterviz.render.storage import Slot, slot_of
from clusterviz.report.machine import memory
from clusterviz.scene.values import Cluster


@dataclass(frozen=True)
class Holding:
    """The same on every rank; what draws is not asked where nothing is limited.

    Attributes
    ----------
    limit_bytes : of bricks that a rank may hold; None: any
    on_processor : some rank draws without OpenGL what it can
    by_opengl : some rank draws all by OpenGL
    """

    limit_bytes: int | None = None
    on_processor: bool = False
    by_opengl: bool = True

    def brick_bytes(self, plan: Plan) -> NDArray[np.int64]:
        """Memory that each brick takes, int64 (bz, by, bx); 0 for those that have nothing to show."""
        from clusterviz.render.vectors.kernel import can_draw

        laid_out = self.on_processor and can_draw(plan)
        found = laid_out_bytes(plan) if laid_out else np.zeros(plan.cost.shape, np.int64)
        if self.by_opengl or not laid_out:
            found = np.maximum(found, slot_of(plan).counted(plan.layout.counts_zyx, lambda slot: slot.bytes))
        return np.where(plan.cost > 0, found, 0)


def holding_of(run: Run, cluster: Cluster, shares_screen: bool) -> Holding:
    """What a scene allows; collective.

    Parameters
    ----------
    shares_screen : whether ranks may share the screen, for which there is always a limit: the smallest share of free
        memory where the scene names none
    """
    limit = cluster.memory_limit
    if limit is None and shares_screen:
        mine = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.placement().local_size
        limit = -run.channel.maximum(-int(mine))
    if limit is None:
        return Holding()
    without = prefers_processor(run.options.device)
    return Holding(limit, bool(run.channel.maximum(without)), bool(run.channel.maximum(not without)))


def laid_out_bytes(plan: Plan) -> NDArray[np.int64]:
    """Memory that bricks take where the processor draws, int64 (bz, by, bx)."""
    slot = slot_of(plan)
    if plan.mixture is None:
        return slot.counted(plan.layout.counts_zyx, _laid_out)
    found = np.zeros(plan.cost.shape, np.int64)
    for part, room in zip(plan.mixture.ingredients, slot.parts, strict=True):
        # Of a volume that a brick does not meet it holds nothing.
        found += np.where(part.cut.bricks_met(), _laid_out(room), 0)
    return found


def _laid_out(slot: Slot) -> int:
    from clusterviz.render.vectors.memory import VOXEL_BYTES, words_of

    return VOXEL_BYTES * words_of(slot)
