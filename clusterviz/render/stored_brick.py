"""Encoded brick, with the ranges of its groups of cells, as ray casters load it and ranks send it."""

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
    """Encoded brick.

    Attributes
    ----------
    samples : uint8, uint16 or float32 (z, y, x), encoded by `Encoding.encode`, at most as many as a slot has; the words
        of the slot with several volumes
    low, high : smallest and largest finite sample of its groups of cells, of the voxels' type, `slot.groups_zyx`
    voxels : number of samples before encoding
    bend : result of `group_curvature`; None without an adaptive step
    """

    samples: NDArray[Any]
    low: NDArray[Any]
    high: NDArray[Any]
    voxels: int
    bend: NDArray[np.float32] | None = None


def store(voxels: NDArray[Any], encoding: Encoding, slot: Slot) -> Stored:
    """Encode a brick's samples (z, y, x)."""
    low, high = group_ranges(voxels, slot)
    bend = group_curvature(voxels, slot) if slot.stretched else None
    return Stored(encoding.encode(voxels), low, high, voxels.size, bend)


def stamp_of(plan: Plan) -> int:
    """Return a checksum of the format in which a plan's bricks are stored; bricks of another format do not suit it."""
    encodings = [part.encoding for part in plan.multi_volume.volume_layers] if plan.multi_volume else [plan.encoding]
    # Integers are stored unchanged, with any encoding.
    stored = slot_of(plan), [encoding if encoding.kind == "f32" else None for encoding in encodings]
    return zlib.crc32(repr(stored).encode())
