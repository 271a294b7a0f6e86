"""A brick as every ray caster can take it, and as it travels from rank to rank: encoded, and its groups known."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.encoding import Encoding
from clusterviz.plan.plan import Plan
from clusterviz.render.empty_space import group_ranges
from clusterviz.render.field_curvature import group_curvature
from clusterviz.render.storage import Slot, slot_of


@dataclass(frozen=True, eq=False)
class Stored:
    """A brick.

    Attributes
    ----------
    samples : uint8, uint16 or float32 (z, y, x), as `Encoding.encode` made them, no more than a slot has; of several
        volumes the words of the slot
    low, high : smallest and largest finite sample of its groups of cells, of the voxels' type, `slot.groups_zyx`
    voxels : samples that it was made of
    bend : of its groups of cells, see `bends.py`; None where slabs are not stretched
    """

    samples: NDArray[Any]
    low: NDArray[Any]
    high: NDArray[Any]
    voxels: int
    bend: NDArray[np.float32] | None = None


def store(voxels: NDArray[Any], encoding: Encoding, slot: Slot) -> Stored:
    """Make a brick's samples (z, y, x) ready for a caster."""
    low, high = group_ranges(voxels, slot)
    bend = group_curvature(voxels, slot) if slot.stretched else None
    return Stored(encoding.encode(voxels), low, high, voxels.size, bend)


def stamp_of(plan: Plan) -> int:
    """A number for how a plan's bricks are stored: bricks of another one are of no use to it."""
    encodings = [part.encoding for part in plan.multi_volume.volume_layers] if plan.multi_volume else [plan.encoding]
    # Integers are stored as they are, whatever the encoding makes of them later.
    stored = slot_of(plan), [encoding if encoding.kind == "f32" else None for encoding in encodings]
    return zlib.crc32(repr(stored).encode())
