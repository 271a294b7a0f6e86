"""One rank's ray caster from frame to frame: compiled, and filled, only when the plan asks for it.

A program is made for a variant; bricks are stored in an encoding. Another camera needs nothing new; another transfer
function may need another program, or bricks that nobody could see before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, MutableMapping
from typing import Any

import moderngl
from numpy.typing import NDArray

from clusterviz.image.partial import blank
from clusterviz.partition import Piece
from clusterviz.plan.encoding import Encoding
from clusterviz.plan.plan import Plan
from clusterviz.render.raycast import Drawn, Raycaster
from clusterviz.render.storage import Slot, make_slot

Index = tuple[int, int, int]


class LastingCaster:
    """What a rank keeps for drawing: its context, and a ray caster for its last plan."""

    def __init__(self) -> None:
        self._context: moderngl.Context | None = None
        self._caster: Raycaster | None = None
        self._encoding: Encoding | None = None

    def missing(self, plan: Plan, wanted: Collection[Index]) -> set[Index]:
        """The bricks that have to be loaded, or loaded again, before the plan can be drawn."""
        if self._caster is None or self._encoding != _encoding_of(plan) or self._caster.slot != _slot_of(plan):
            return set(wanted)
        return set(wanted) - self._caster.pool.bricks

    def is_compiled(self, plan: Plan) -> bool:
        """Whether there is a program for the plan."""
        return self._caster is not None and self._caster.slot == _slot_of(plan) and self._caster.can_draw(plan)

    def open(self, local_rank: int, device: int | None) -> None:
        """Make the context, unless there is one."""
        from clusterviz.gl.context import open_context

        if self._context is None:
            self._context = open_context(local_rank, device)

    def compile(self, plan: Plan) -> None:
        """Make the program, unless the last one will do; bricks stay where they fit the plan's slots."""
        if self._context is None:
            raise ValueError("there is no context yet")
        if self._caster is not None and self._caster.slot != _slot_of(plan):
            self._drop()
        if self._caster is None:
            self._caster = Raycaster(self._context, plan)
        elif not self._caster.can_draw(plan):
            self._caster.compile(plan)

    def load(self, plan: Plan, wanted: Collection[Index], bricks: MutableMapping[Index, NDArray[Any]]) -> None:
        """Keep of what is there what is wanted, and upload bricks, taken out as they are stored."""
        if self._caster is None:
            return
        here = self._caster.pool.bricks
        self._caster.drop(here - set(wanted) | here & bricks.keys())
        self._caster.load(plan, bricks)
        self._encoding = _encoding_of(plan)

    def draw(self, plan: Plan, pieces: Iterable[Piece]) -> list[Drawn]:
        """Draw a frame's pieces of this rank; blank ones where it never had a brick."""
        return [Drawn(blank()) for _ in pieces] if self._caster is None else self._caster.draw(plan, pieces)

    @property
    def held(self) -> dict[str, Any]:
        """What there is to draw with: renderer, OpenGL's name of it; bricks, their voxels and bytes of GPU memory."""
        if self._caster is None:
            return {}
        pool = self._caster.pool
        counted = {"bricks": len(pool.bricks), "voxels": pool.voxels, "voxel_bytes": pool.bytes}
        return {"renderer": self._caster.renderer, **counted}

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


def _slot_of(plan: Plan) -> Slot:
    return make_slot(plan.layout, plan.encoding, plan.march)


def _encoding_of(plan: Plan) -> Encoding | None:
    """What stored bricks depend on; None for integers, which are stored as they are."""
    return plan.encoding if plan.encoding.kind == "f32" else None
