"""What a thread knows of the packets of its tile between their turns: vectors in memory that fits a core's cache.

All rays of a tile go on together, a few slabs at a time, so that voxels are fetched from far away once for all of them.
"""

from __future__ import annotations

from typing import Any

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import BYTES, F32, F64, I32, I64, Value, Vector
from clusterviz.render.cpu.marching.rays import Rays

LOOK_VECTORS = 8
NEVER = (1 << 31) - 1  # a slab that no ray has
BLOCKS = {16: (4, 4), 8: (4, 2), 4: (2, 2)}
"""Lanes of a packet: its pixels across and down."""
Layout = tuple[tuple[str, Any, int], ...]
"""Names, elements, and how many vectors there are of each."""
_LAYOUT: Layout = (
    ("first", F64, 3),
    ("slab", F64, 3),
    ("last", F64, 3),
    ("slabs", I32, 1),
    ("last_share", F32, 1),
    ("at", I32, 1),  # the slab to go on with
    ("behind", I32, 1),  # that and what follows is not this draw's
    ("ends", I32, 1),  # 1: the last slab is kept by the clipping planes
    ("done", I32, 1),  # 1: nothing behind can matter; and outside of the picture
    ("samples", I32, 1),  # taken so far
    ("look", F32, LOOK_VECTORS),
)
STARTED: Layout = (
    ("entry", I32, 1),  # the first slab that is this draw's
    ("start", I32, 1),  # the one that it starts with, or would start with
    ("hit", I32, 1),  # the first one that adds something
    ("checked", I32, 1),  # 1: it starts with the first one all the same
    ("missed", F32, 1),  # opacity before `start`
)
"""Where rays may start where the last frame says."""


class State:
    """The packets of a tile.

    Parameters
    ----------
    packets : how many
    more : what else is known of each
    """

    def __init__(self, code: Code, packets: int, more: Layout = ()) -> None:
        self._code, self._offsets = code, {}
        offset = 0
        for name, element, vectors in (*_LAYOUT, *more):
            self._offsets[name] = (offset, element)
            offset += vectors * BYTES[element] * code.lanes
        self._bytes = offset
        self._place = code.scratch(packets * offset)

    def packet(self, number: Value) -> Packet:
        """One packet's."""
        return Packet(self._code, self._place + number.to(I64) * self._bytes, self._offsets)


class Packet:
    """One packet's vectors."""

    def __init__(self, code: Code, address: Value, offsets: dict[str, tuple[int, Any]]) -> None:
        self._code, self._address, self._offsets = code, address, offsets

    def get(self, name: str, number: int = 0) -> Value:
        """A vector; of several, one."""
        element, address = self._at(name, number)
        return self._code.load(element, address, self._code.lanes)

    def set(self, name: str, value: Value, number: int = 0) -> None:
        """Keep a vector."""
        self._code.store(value, self._at(name, number)[1])

    def mask(self, name: str) -> Value:
        """A vector of ones and zeros as a mask."""
        return self.get(name) > 0

    @property
    def rays(self) -> Rays:
        """The packet's rays."""
        first, slab, last = (self._triple(name) for name in ("first", "slab", "last"))
        return Rays(first, slab, last, self.get("slabs"), self.get("last_share"))

    @property
    def blend_mode(self) -> list[Variable]:
        """What the look keeps, in variables."""
        return [Variable(self.get("look", vector)) for vector in range(LOOK_VECTORS)]

    def keep_look(self, kept: list[Variable]) -> None:
        """Write what the look keeps."""
        for vector, variable in enumerate(kept):
            self.set("look", variable.now, vector)

    def keep_rays(self, rays: Rays) -> None:
        """Write rays."""
        for name in ("first", "slab", "last"):
            for axis, value in enumerate(getattr(rays, name)):
                self.set(name, value, axis)
        self.set("slabs", rays.slabs)
        self.set("last_share", rays.last_share)

    def _triple(self, name: str) -> Vector:
        x, y, z = (self.get(name, axis) for axis in range(3))
        return x, y, z

    def _at(self, name: str, number: int) -> tuple[Any, Value]:
        offset, element = self._offsets[name]
        return element, self._address + (offset + number * BYTES[element] * self._code.lanes)
