"""OpenGL as the ray caster's device: bricks in GPU memory, and dispatches that are queued together.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError
from clusterviz.gl.context import LLVMPIPE_ITERATIONS, is_llvmpipe, is_software
from clusterviz.gl.device import Counts, Device, Program
from clusterviz.gl.reals import ENVIRONMENT, EXTENSION, chosen_reals, has_doubles
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox, Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.program import FindVariant
from clusterviz.render.abuffer.raster import Rasteriser
from clusterviz.render.abuffer.tiles import GPU_TILE
from clusterviz.render.brick_atlas import BrickPool, capacity
from clusterviz.render.brick_tables import BrickTables, waits_for_rays
from clusterviz.render.caster import Caster
from clusterviz.render.cells.table import walk_planes
from clusterviz.render.device import Rays
from clusterviz.render.frame_block import frame_block
from clusterviz.render.march import March
from clusterviz.render.packed_picture import PictureReader
from clusterviz.render.refraction import CarriedRays
from clusterviz.render.storage import Slot, slot_of
from clusterviz.render.variant import Variant, variant_of

ITERATIONS = (1 << 16, 3600)
"""Of the loops of a ray in a dispatch, on GPUs and on llvmpipe, which silently leaves all loops after 65535 in total:
sixteen lanes that diverge may take sixteen times the iterations that each of them counts."""
MOST_TABLES = 64
"""Pieces whose tables are kept from view to view."""


class OpenGL:
    """An OpenGL context that draws; see `render/device.py`.

    Parameters
    ----------
    context : a context that this thread has current, or that of a recording
    plan : the first plan to draw
    block_bytes : largest size of a GPU buffer, for tests
    limit_bytes : GPU memory beyond which no free slots are added; None: no limit
    band_pixels : larger pictures are drawn in bands; None: by the speed of the device
    packs : whether pictures are packed on the device before they are read; None: unless that is software
    raster : whether a rasteriser finds fragments; None: chosen by the device

    Attributes
    ----------
    reader : reads pictures back
    """

    lanes, list_tile, class_tile, redraws = 0, GPU_TILE, GPU_TILE, True

    def __init__(
        self,
        context: moderngl.Context,
        plan: Plan,
        block_bytes: int | None = None,
        limit_bytes: int | None = None,
        band_pixels: int | None = None,
        packs: bool | None = None,
        raster: bool | None = None,
    ) -> None:
        self._context, self.band_pixels = context, band_pixels
        packs = not is_software(self.renderer) if packs is None else packs
        self.arrays = Device(context, None if packs else False)
        self.reader, self._raster = PictureReader(self.arrays, packs), Rasteriser(self.arrays, raster)
        self.rasteriser: Rasteriser | None = self._raster
        self.counts: Counts | None = self.arrays.counts
        self.loop_limit = LLVMPIPE_ITERATIONS if is_llvmpipe(self.renderer) else 0
        self.most_bytes = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        slot = slot_of(plan)
        self._capacity = capacity(context, slot, block_bytes)
        self._most = None if limit_bytes is None else limit_bytes // slot.bytes
        self._tables = dict[bytes, BrickTables]()

    @property
    def renderer(self) -> str:
        """OpenGL's name of the device."""
        return str(self._context.info["GL_RENDERER"])

    @property
    def driver(self) -> str:
        """Versions of OpenGL and of its driver."""
        return str(self._context.info["GL_VERSION"])

    @property
    def choices(self) -> dict[str, str]:
        """What the device decides, by names, in a few words each."""
        packs, reals = self.reader.packs, chosen_reals(self._context)
        return {
            "pictures": "packed, as they are copied from a GPU"
            if packs
            else "whole, as they lie in memory of the host",
            "ownership": f"{reals}, as {'double precision is fast' if reals == 'double' else 'no float64 is fast'}",
            "fragments": self._raster.choice,
        }

    def make_pool(self, slot: Slot) -> BrickPool:
        """Return GPU memory for bricks."""
        return BrickPool(self._context, slot, self._capacity, self._most)

    def load(self, plan: Plan, pool: BrickPool, bricks: MutableMapping[Any, Any], stored: Callable[..., Any]) -> None:
        """Add bricks, which are uploaded when a ray comes to them if that may be never."""
        (pool.put_later if waits_for_rays(plan) else pool.put)(bricks, stored)

    def variant_of(self, plan: Plan, slot: Slot, tables: object = None) -> Variant:
        """Return the program that a plan needs on this context."""
        info, reals = self._context.info, chosen_reals(self._context)
        found = variant_of(plan, slot, int(info["GL_MAX_UNIFORM_BLOCK_SIZE"]), reals)
        if found.reals == "double" and not has_doubles(self._context):
            raise DeviceError(
                f"{info['GL_RENDERER']} has no double precision in shaders ({EXTENSION}), "
                f"which is needed by: {', '.join(found.needs_doubles) or ENVIRONMENT}"
            )
        return found

    def compile(self, variant: Variant | FindVariant) -> Program:
        """Return a program."""
        return self.arrays.compile(variant.source)

    def next_frame(self, plan: Plan, slot: Slot, pixel: str) -> None:
        """Begin a frame, whose pictures may have a format."""
        self.reader.next_frame(pixel)

    def tables(self, plan: Plan, pool: BrickPool, slot: Slot, piece: Piece) -> BrickTables:
        """Return the tables of a piece: those of an earlier view if they hold."""
        members = piece.members(plan.cost > 0)
        key, self._tables = members.tobytes(), {} if len(self._tables) > MOST_TABLES else self._tables
        known = self._tables.get(key)
        if known is None or not known.hold_for(plan):
            known = self._tables[key] = BrickTables(self.arrays, pool, plan, members)
        known.begin()
        return known

    def window(self, plan: Plan, part: Piece, rect: Rect) -> Rect:
        """Return the whole rectangle, whose pixels stay on the device."""
        return rect

    def frame(self, plan: Plan, box: BrickBox, rect: Rect, slot: Slot) -> NDArray[np.void]:
        """Return the block of the frame for a box of bricks."""
        block = frame_block(plan, box, rect, slot)
        block["optics"][0, 3] = ITERATIONS[is_llvmpipe(self.renderer)]
        return block

    def march(self, plan: Plan, rect: Rect, rays: Rays | None) -> March:
        """Return the rays of a rectangle, begun with what is known of them."""
        planes = rays.planes if rays else np.zeros(0, np.float32)
        march = March(self.reader, rect, planes, walk_planes(plan.content) * rect.pixels)
        if isinstance(rays, CarriedRays):
            march.go_on_from(rays.pixels)
        return march

    def forget_bricks(self) -> None:
        """Tables know themselves whether they hold."""

    def release(self) -> None:
        """Free all GPU resources, but for bricks and programs."""
        self._raster.release()
        self.reader.release()
        self.arrays.release()


def opengl_caster(context: moderngl.Context, plan: Plan, block_bytes: int | None = None, **settings: Any) -> Caster:
    """Return a ray caster of an OpenGL context; further settings as of `OpenGL`."""
    return Caster(OpenGL(context, plan, block_bytes, **settings), plan)
