"""Slabs that are longer where a group of cells allows it (plan/adaptive_step.py): the twin of adaptive_step.glsl.

A run of longer slabs is one of ordinary slabs to a look: its midpoints lie farther apart, and a sample's opacity is
that of several. How long they may be stands in the table of skips, which knows every group.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.plan.adaptive_step import LONGEST
from clusterviz.render.cpu.fields.field import Spot
from clusterviz.render.cpu.transfer.classify import Class

ONCE = -2
"""In a table of skips: slabs may be doubled once; a number lower, once more."""


def with_doublings(
    skips: NDArray[np.int32], places: NDArray[np.intp], visible: NDArray[np.bool_], doublings: NDArray[np.uint8]
) -> NDArray[np.int32]:
    """A table of skips that says of visible groups how often their slabs may be doubled.

    Parameters
    ----------
    skips, places, visible : as of `skips.py`
    doublings : of the groups of stored bricks, (n, gz, gy, gx)
    """
    found, at = skips.copy(), tuple(places.T)
    longer = visible & (doublings > 0)
    found[at] = np.where(longer, ONCE + 1 - doublings.astype(np.int32), found[at])
    return found


class Stretch:
    """The stretches that a packet's rays take now."""

    def __init__(self, code: Code) -> None:
        self._code, self._doublings = code, Variable(code.same(I32, 0))

    def allowed(self, skip: Value) -> Value:
        """How often a table's entries let slabs be doubled."""
        return self._code.select(skip <= ONCE, ONCE + 1 - skip, 0)

    def take(self, slab_number: Value, slabs: Value, allowed: Value) -> Value:
        """Choose stretches for runs of slabs that begin with a number; how many slabs the runs then have.

        A stretch begins at a multiple of its length. Behind a shorter one there may be room for a longer one.
        """
        code, taken = self._code, allowed
        for _ in range(LONGEST):
            inside = (slab_number & ((code.same(I32, 1) << taken) - 1)).equals(0)
            fits = inside & ((slabs >> taken) > 0)
            taken = code.select((taken > 0) & ~fits, taken - 1, taken)
        self._doublings.set(taken)
        one = code.same(I32, 1) << taken
        return code.select(slabs > 0, code.select(taken.equals(allowed), (slabs >> taken) << taken, one), 0)

    def longer(self, spot: Spot, slab: Vector) -> tuple[Spot, Vector]:
        """The first midpoints of stretches, and from one midpoint to the next, from those of slabs."""
        code = self._code
        length = (code.same(I32, 1) << self._doublings.now).to(F32)
        along = 0.5 * (length - 1.0)
        x, y, z = (code.fma(along, by, at) for by, at in zip(slab, spot.beyond, strict=True))
        across, down, deep = (length * by for by in slab)
        begin = spot.begin / length if spot.begin else None
        return replace(spot, beyond=(x, y, z), begin=begin), (across, down, deep)

    def stretches(self, slabs: Value) -> Value:
        """How many stretches so many slabs are."""
        return slabs >> self._doublings.now

    def slabs(self, stretches: Value) -> Value:
        """How many slabs so many stretches are."""
        return stretches << self._doublings.now

    def of_stretches(self, slab: Class) -> Class:
        """What samples come to that stand for several slabs, from what they are for one."""
        opacity, doublings = slab.opacity, self._doublings.now
        for doubling in range(LONGEST):
            opacity = self._code.select(doublings > doubling, opacity * (2.0 - opacity), opacity)
        return Class(opacity, slab.colour)
