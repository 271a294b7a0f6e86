"""Memory that each rank may use for bricks, and the check that its bricks fit.

A brick's size is counted as the renderer stores it: OpenGL keeps packed words or texels, the CPU ray caster one word a
voxel. All ranks decide before bricks are loaded. Where ranks draw by different means, a brick counts with its largest
size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.frame.opening import HELD_SHARE_OF_MEMORY
from clusterviz.frame.run import Run
from clusterviz.plan.plan import Plan
from clusterviz.render.choice import prefers_processor
from clusterviz.render.storage import Slot, slot_of
from clusterviz.report.machine import memory
from clusterviz.scene.values import Cluster

Shares = Callable[[int], NDArray[np.int64]]
"""Bytes of bricks that each of a number of ranks would hold, int64 (ranks,)."""


def check_memory(shares: Shares, ranks: int, brick_bytes: NDArray[np.int64], limit_bytes: int | None) -> None:
    """Refuse a limit below the largest share.

    Parameters
    ----------
    shares : of the distribution
    ranks : how many there are
    brick_bytes : int64 (bz, by, bx), 0 for bricks that are not held
    limit_bytes : of bricks a rank; None: any

    Raises
    ------
    InputError
        It names the largest share, and a number of ranks that would do, if any does.
    """
    if limit_bytes is None:
        return
    most = int(shares(ranks).max())
    if most <= limit_bytes:
        return
    if int(brick_bytes.max()) > limit_bytes:
        remedy = f"smaller bricks: one takes {int(brick_bytes.max())} bytes, which no number of ranks changes"
    elif enough := fitting_ranks(shares, ranks, brick_bytes, limit_bytes):
        remedy = f"{enough} ranks, or {most} bytes a rank"
    else:
        remedy = f"{most} bytes a rank"
    raise InputError(
        f"the largest share of {ranks} {'rank' if ranks == 1 else 'ranks'} takes {most} bytes",
        where="cluster.memory_limit",
        found=f"{limit_bytes} bytes a rank",
        allowed=remedy,
    )


def fitting_ranks(shares: Shares, above: int, brick_bytes: NDArray[np.int64], limit_bytes: int) -> int | None:
    """A number of ranks above one that fails, with which every share fits; None where none was found.

    Doubled until it fits, then halved down: the answer was tried. Shares need not fall with every single rank more, so
    a smaller number might do as well. More ranks than bricks do not help.
    """
    bricks = int(np.count_nonzero(brick_bytes))
    fails, fits = above, max(above + 1, -(-int(brick_bytes.sum()) // max(1, limit_bytes)))
    while int(shares(fits).max()) > limit_bytes:
        if fits >= bricks:
            return None
        fails, fits = fits, min(2 * fits, bricks)
    while fits - fails > 1:
        middle = (fails + fits) // 2
        if int(shares(middle).max()) > limit_bytes:
            fails = middle
        else:
            fits = middle
    return fits


@dataclass(frozen=True)
class MemoryBudget:
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
        from clusterviz.render.cpu.kernel import can_draw

        laid_out = self.on_processor and can_draw(plan)
        found = laid_out_bytes(plan) if laid_out else np.zeros(plan.cost.shape, np.int64)
        if self.by_opengl or not laid_out:
            found = np.maximum(found, slot_of(plan).counted(plan.layout.counts_zyx, lambda slot: slot.bytes))
        return np.where(plan.cost > 0, found, 0)


def memory_budget_of(run: Run, cluster: Cluster, shares_screen: bool) -> MemoryBudget:
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
        return MemoryBudget()
    without = prefers_processor(run.options.device)
    return MemoryBudget(limit, bool(run.channel.maximum(without)), bool(run.channel.maximum(not without)))


def laid_out_bytes(plan: Plan) -> NDArray[np.int64]:
    """Memory that bricks take where the processor draws, int64 (bz, by, bx)."""
    slot = slot_of(plan)
    if plan.multi_volume is None:
        return slot.counted(plan.layout.counts_zyx, _laid_out)
    found = np.zeros(plan.cost.shape, np.int64)
    for part, room in zip(plan.multi_volume.volume_layers, slot.parts, strict=True):
        # Of a volume that a brick does not meet it holds nothing.
        found += np.where(part.cut.bricks_met(), _laid_out(room), 0)
    return found


def _laid_out(slot: Slot) -> int:
    from clusterviz.render.cpu.memory import VOXEL_BYTES, words_of

    return VOXEL_BYTES * words_of(slot)
