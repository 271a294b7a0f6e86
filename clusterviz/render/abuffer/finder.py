"""Fragments of a rectangle of pixels, found by the rasteriser of a device, or with tile lists."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.device import Device
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.fills import Pools, with_fill
from clusterviz.render.abuffer.fragments import Fragments
from clusterviz.render.abuffer.on_gl import bind_fragments, compile_passes, list_primitives
from clusterviz.render.abuffer.primitives import PrimitiveTable, TableCache
from clusterviz.render.abuffer.program import FindVariant, find_variants
from clusterviz.render.abuffer.raster import Rasteriser
from clusterviz.render.abuffer.tiles import TileLists
from clusterviz.render.brick_tables import Part

Tiles = dict[BrickBox, TileLists]
"""Tile lists of the boxes of a piece, which are narrowed when it is drawn again."""


class FragmentFinder:
    """Programs that find fragments, and what they know of earlier draws.

    Parameters
    ----------
    device : with the primitives
    plan : the first plan to draw
    raster : whether a rasteriser finds fragments, where it serves; None: chosen by the device
    """

    def __init__(self, device: Device, plan: Plan, raster: bool | None = None) -> None:
        self._device, self._raster = device, Rasteriser(device, raster)
        self._passes: dict[FindVariant, moderngl.ComputeShader] = {}
        self.compile(plan)
        self.forget()
        self.forget_bricks()

    @property
    def choice(self) -> str:
        """How fragments are found where a scene leaves it to the device, and why."""
        return "rasteriser, as there is a GPU" if self._raster.is_used else "tile lists, as no GPU rasterises"

    def compile(self, plan: Plan) -> None:
        """Compile the programs of a plan in place of those of another."""
        old, self._passes = self._passes, compile_passes(self._device.context, plan)
        for program in old.values():
            program.release()

    def can_draw(self, plan: Plan) -> bool:
        """Return True if there are the programs of a plan."""
        return all(variant in self._passes for variant in find_variants(plan))

    def forget(self) -> None:
        """Forget how many fragments there were."""
        self._pools = Pools()

    def forget_bricks(self) -> None:
        """Forget the primitives, as bricks have changed."""
        self._primitives = TableCache()

    def with_fill(self, plan: Plan) -> Plan:
        """Return a plan whose fill scheme is chosen."""
        return with_fill(plan, self._pools)

    def table(self, plan: Plan, part: Part) -> PrimitiveTable:
        """Return the primitives and tetrahedra of a box of bricks, of a plan with layers of them."""
        found = self._primitives.table(plan.content.layers, part.bricks, part.atlas.members)
        assert found, "there are layers"
        return found

    def find(
        self,
        plan: Plan,
        table: PrimitiveTable,
        rect: Rect,
        tiles: Tiles,
        box: BrickBox,
        limits: NDArray[np.float32] | None,
        *,
        waits: bool,
    ) -> Fragments:
        """Find the fragments of a box, and bind them for drawing; the blocks of the frame and of clipping are bound.

        Parameters
        ----------
        tiles, box : of the piece, written; and the key of the box
        limits : depths behind which nothing is stored; None: there are none
        waits : whether all have to be there when this returns; else `Fragments.are_all` may ask for another try

        Raises
        ------
        ManyFragmentsError
            The rectangle should be divided.
        DeviceError
            There is no memory, or llvmpipe would leave out primitives or fragments.
        """
        if self._raster.serves(plan, rect):
            return self._raster.find(plan, table, rect, waits=waits)
        tiles[box] = list_primitives(self._device.context, plan, table, rect, limits, tiles.get(box))
        return bind_fragments(self._device, self._passes, plan, table, tiles[box], rect, self._pools)

    def release(self) -> None:
        """Free the programs."""
        for program in self._passes.values():
            program.release()
        self._raster.release()
