"""Memory that each rank may use for bricks, and the check that its bricks fit.

The size of a brick is that of its storage in the renderer: OpenGL keeps packed words or texels, the CPU ray caster one
word a voxel. Primitives and tetrahedra are counted as ranks hold them, in main memory, and as they are
drawn. If ranks use different renderers, the larger size counts. All ranks decide before bricks are
loaded.

If bricks can be drawn in passes (`frame/residency.py`), a limit must only suffice for one brick. Others are refused
beyond the limit, or beyond the memory that is free, before they are read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.gl.devices import prefers_cpu
from clusterviz.plan.plan import Plan
from clusterviz.render.choice import brick_bytes
from clusterviz.render.storage import slot_of
from clusterviz.report.machine import HELD_SHARE_OF_MEMORY, LARGEST_SHARE_OF_MEMORY, memory
from clusterviz.scene.values import Cluster

if TYPE_CHECKING:
    from clusterviz.frame.run import Run

READING = 2
"""Bytes for a byte of samples that is read: the box that spans several bricks lies beside these."""
Shares = Callable[[int], NDArray[np.int64]]
"""Bytes of bricks that each of a number of ranks would hold, int64 (ranks,)."""


def check_memory(
    shares: Shares, ranks: int, brick_bytes: NDArray[np.int64], limit_bytes: int | None, is_free: bool = False
) -> None:
    """Refuse a limit below the largest share.

    The InputError names the largest share, and a sufficient number of ranks, if any.

    Parameters
    ----------
    shares : bytes of bricks on each rank, for a number of ranks
    ranks : number of ranks
    brick_bytes : int64 (bz, by, bx), 0 for bricks that are not held
    limit_bytes : of bricks a rank; None: no limit
    is_free : the limit is not one that was asked for, but the memory that is free
    """
    if limit_bytes is None or int(brick_bytes.sum()) <= limit_bytes:
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
        where="the memory that is free" if is_free else "cluster.memory_limit",
        found=f"{limit_bytes} bytes a rank",
        allowed=remedy,
    )


def check_passes(plan: Plan, brick_bytes: NDArray[np.int64], limit_bytes: int | None) -> None:
    """Raise InputError if a limit is below what the largest brick takes while it is loaded."""
    least = int(brick_bytes.max()) + READING * slot_of(plan).sample_bytes if brick_bytes.any() else 0
    if limit_bytes is not None and least > limit_bytes:
        text = f"a brick takes {least} bytes while it is loaded, which no number of ranks changes"
        allowed = f"{least} bytes a rank, or smaller bricks"
        raise InputError(text, where="cluster.memory_limit", found=f"{limit_bytes} bytes a rank", allowed=allowed)


def fitting_ranks(shares: Shares, above: int, brick_bytes: NDArray[np.int64], limit_bytes: int) -> int | None:
    """Find a number of ranks for which every share fits; None if there is none up to the number of bricks.

    The number is doubled until the shares fit, then bisected. Shares need not fall with each further rank, so a smaller
    number may fit as well.

    `above`: number of ranks that is too small.
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
    """Memory budget, the same on every rank; where nothing is limited the renderers do not matter."""

    limit_bytes: int | None = None  # of bricks that a rank may hold; None: no limit
    on_cpu: bool = False  # some rank prefers the CPU ray caster
    by_opengl: bool = True  # some rank draws everything by OpenGL
    free_bytes: int | None = None  # the smallest memory of a rank that is free for bricks; None: unknown

    def check(self, shares: Shares, ranks: int, brick_bytes: NDArray[np.int64]) -> None:
        """Refuse bricks, which all have to be held, beyond the limit, or without one beyond the memory that is free.

        Parameters as of `check_memory`, which raises.
        """
        limit = self.free_bytes if self.limit_bytes is None else self.limit_bytes
        check_memory(shares, ranks, brick_bytes, limit, is_free=self.limit_bytes is None)

    def brick_bytes(self, plan: Plan) -> NDArray[np.int64]:
        """Return the size of each brick in bytes, int64 (bz, by, bx); 0 for bricks that are not visible."""
        sizes = brick_bytes(plan, self.on_cpu)
        if self.on_cpu and self.by_opengl:
            sizes = np.maximum(sizes, brick_bytes(plan, on_cpu=False))
        for layer in plan.content.layers:
            sizes = sizes + layer.nbytes + layer.table_bytes
        return np.where(plan.cost > 0, sizes, 0)


def memory_budget_of(run: Run, cluster: Cluster, shares_screen: bool, has_surfaces: bool = False) -> MemoryBudget:
    """Return the memory budget of a scene; collective.

    Parameters
    ----------
    shares_screen : True if ranks may share the screen; then a scene without a limit gets one: the smallest share of
        free memory of any rank
    has_surfaces : there are meshes, lines, points or grids, whose bricks all have to be held
    """
    limit, free = cluster.memory_limit, None
    if has_surfaces or (limit is None and shares_screen):
        free = -run.channel.maximum(-(memory().available_bytes // run.channel.placement().local_size))
    if limit is None and shares_screen and free is not None:
        limit = int(HELD_SHARE_OF_MEMORY * free)
    if limit is None and not free:
        return MemoryBudget()
    without = prefers_cpu(run.options.device)
    held = int(LARGEST_SHARE_OF_MEMORY * free) if free and has_surfaces else None
    return MemoryBudget(limit, bool(run.channel.maximum(without)), bool(run.channel.maximum(not without)), held)
