"""One rank's ray caster from frame to frame: compiled, and filled, only when the plan asks for it.

A program is made for a variant and a box; bricks are stored in an encoding, and in chunks whose order is that of the
view. Another camera needs nothing new, unless it sees several chunks in another order; another transfer function may
need another program, or bricks that nobody could see before.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass, replace
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox, BspTree
from clusterviz.plan.encoding import Encoding
from clusterviz.plan.plan import Plan
from clusterviz.render.chunks import chunks_of
from clusterviz.render.raycast import Drawn, Raycaster
from clusterviz.render.residence import capacity
from clusterviz.render.storage import make_slot
from clusterviz.render.variant import Variant, variant_of

Index = tuple[int, int, int]


@dataclass(frozen=True)
class Needs:
    """What a ray caster is made for.

    Attributes
    ----------
    variant, box : of the program
    encoding : of the bricks; None for integers, which are stored as they are
    chunks : boxes of bricks from front to back
    """

    variant: Variant
    box: BrickBox
    encoding: Encoding | None
    chunks: tuple[BrickBox, ...]


class LastingCaster:
    """What a rank keeps for drawing: its context, and a ray caster for its last plan.

    Parameters
    ----------
    rank : whose leaf of the tree is drawn
    """

    def __init__(self, rank: int) -> None:
        self._rank = rank
        self._context: moderngl.Context | None = None
        self._caster: Raycaster | None = None
        self._needs: Needs | None = None
        self._tree: BspTree | None = None

    def is_stale(self, plan: Plan, tree: BspTree, loaded: NDArray[np.float64]) -> bool:
        """Whether this rank's bricks must be uploaded, or uploaded again, before the plan can be drawn.

        Parameters
        ----------
        loaded : float64 (bz, by, bx), the costs from which the tree was built: above 0 where a brick is in memory
        """
        if tree is not self._tree:
            return True
        return self._caster is not None and self._needs_of(plan, tree, loaded) != self._needs

    def open(self, local_rank: int, device: int | None) -> None:
        """Make the context, unless there is one."""
        from clusterviz.gl.context import open_context

        if self._context is None:
            self._context = open_context(local_rank, device)

    def compile(self, plan: Plan, tree: BspTree, loaded: NDArray[np.float64]) -> None:
        """Make the program, unless the last one will do."""
        if self._context is None:
            raise ValueError("there is no context yet")
        last, self._needs = self._needs, self._needs_of(plan, tree, loaded)
        wanted = (self._needs.variant, self._needs.box)
        if self._caster is None or last is None or (last.variant, last.box) != wanted:
            self._drop()
            self._caster = Raycaster(self._context, plan, self._needs.box)

    def load(self, plan: Plan, tree: BspTree, bricks: MutableMapping[Index, NDArray[Any]]) -> None:
        """Put bricks into GPU memory, taken out as they are stored; without any, nothing is drawn from now on."""
        self._tree = tree
        if not bricks:
            self._drop()
        elif self._caster is not None:
            self._caster.load(plan, bricks)

    def draw(self, plan: Plan) -> Drawn | None:
        """Draw a frame; None on a rank that has nothing to draw."""
        return None if self._caster is None else self._caster.draw(plan)

    @property
    def held(self) -> dict[str, Any]:
        """What there is to draw with: renderer, OpenGL's name of it, and voxel_bytes, of GPU memory."""
        caster = self._caster
        return {"renderer": caster.renderer, "voxel_bytes": caster.voxel_bytes} if caster else {}

    def release(self) -> None:
        """Give everything back to the driver."""
        self._drop()
        if self._context is not None:
            self._context.release()
            self._context = None

    def _drop(self) -> None:
        if self._caster is not None:
            self._caster.release()
            self._caster = None

    def _needs_of(self, plan: Plan, tree: BspTree, loaded: NDArray[np.float64]) -> Needs:
        if self._context is None:
            raise ValueError("there is no context yet")
        box = tree.leaves[self._rank].trimmed
        slot = make_slot(plan.layout, plan.encoding, plan.march)
        variant = variant_of(plan, slot, int(self._context.info["GL_MAX_UNIFORM_BLOCK_SIZE"]))
        # Bricks that are loaded but hidden now stay where they are: only the order of the chunks may change.
        chunks = chunks_of(box, replace(plan, cost=loaded), capacity(self._context, slot))
        encoding = plan.encoding if plan.encoding.kind == "f32" else None
        return Needs(variant, box, encoding, tuple(chunks))
