"""Tables of the bricks of a piece on an OpenGL device: where their voxels begin, and which groups of cells are visible.

With early ray termination, bricks are stored on the device when a ray comes to them: until then they are absent.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2
(early ray termination, here for whole bricks, too).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.gl.device import Device
from clusterviz.partition import BrickBox, bounding_box
from clusterviz.plan.plan import Plan
from clusterviz.render.brick_atlas import BrickAtlas, BrickPool
from clusterviz.render.device import BricksApartError


def waits_for_rays(plan: Plan) -> bool:
    """Return True if a brick is stored on the device when a ray comes to it, and never if all end in front of it."""
    is_alone = not plan.content.mixed and not plan.refraction and plan.blend_mode.traits.composited
    # Slabs that are split at borders need the bricks behind them.
    return bool(plan.march.residual > 0 and is_alone and not plan.march.split)


@dataclass(frozen=True, eq=False)
class Part:
    """Bricks of one atlas in a box, and their tables."""

    atlas: BrickAtlas
    box: BrickBox
    bricks: NDArray[np.int64]
    offsets: NDArray[Any]
    visible: NDArray[Any]


class BrickTables:
    """Offsets and visible groups of the bricks of a piece, in parts from front to back.

    Parameters
    ----------
    device, pool : with the tables, and with the bricks
    members : int64 (m, 3), the bricks
    """

    def __init__(self, device: Device, pool: BrickPool, plan: Plan, members: NDArray[np.int64]) -> None:
        self._device, self._pool, self._plan, self._members = device, pool, plan, members
        self.waits = waits_for_rays(plan) and pool.holds_in_one(self._members)
        self._reached = np.zeros(len(self._members), np.bool_)
        self.parts = self._made()
        if plan.refraction and len(self.parts) > 1:
            # A ray that bends may come back to what lies in another buffer.
            raise InputError(
                "too many bricks for rays that bend",
                where="optics.refraction",
                found=f"bricks in {len(self.parts)} buffers",
                allowed="one; set cluster.memory_limit to load them in turn",
            )

    def hold_for(self, plan: Plan) -> bool:
        """Return True if a plan of another view has the same tables, as neither bricks nor what they show changed."""
        now, then = ((plan.march, *plan.content.shown_by) for plan in (plan, self._plan))
        same = all(one is other for one, other in zip(now, then, strict=True))
        return same and self.alone and self._version == self._pool.version

    def begin(self) -> None:
        """Begin another view: no ray has come to a brick."""
        self._reached[:] = False

    @property
    def alone(self) -> bool:
        """True if all bricks are in one box."""
        return len(self.parts) == 1

    @property
    def bricks_in_box(self) -> int:
        """Bricks of the only box, those of others and of nobody included."""
        return self.parts[0].offsets.size

    def bind(self, number: int) -> None:
        """Bind the bricks of a part."""
        part = self.parts[number]
        self._device.give("offsets", part.offsets)
        self._device.give("groups", part.visible)
        part.atlas.bind(self._device)

    def store(self, noted: NDArray[np.bool_]) -> None:
        """Store those bricks of the only box that rays have come to.

        Raises
        ------
        BricksApartError
            They did not fit into one buffer; all are stored now.
        """
        (part,) = self.parts
        self._reached |= noted.reshape(part.offsets.shape)[tuple((self._members - part.box.begin_zyx).T)]
        if self._pool.fetch(self._members[self._reached]):
            self.waits = self._pool.holds_in_one(self._members)
            self.parts = self._made()
        if not self.waits:
            raise BricksApartError

    @property
    def reached(self) -> int:
        """Number of bricks that rays have come to, as far as that is known."""
        return int(self._reached.sum()) if self.waits else len(self._members)

    @property
    def occluded(self) -> int:
        """Number of bricks in front of which all rays have ended."""
        return len(self._members) - self.reached

    def _made(self) -> list[Part]:
        found = []
        for atlas, bricks in self._pool.parts(self._plan, self._members, self.waits):
            box = bounding_box(bricks)
            tables = atlas.tables(self._plan, box, bricks)
            for table in tables:
                table.setflags(write=False)  # they stay on the device
            found.append(Part(atlas, box, bricks, *tables))
        self._version = self._pool.version
        return found
