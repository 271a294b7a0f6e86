"""Windows: how many slabs of a ray are placed and summed together, wherever runs begin and however many there are.

Both casters cut rays into them, so that empty-space skipping changes no bit of a picture (docs/concepts/accuracy.md).
"""

from __future__ import annotations

import numpy as np

from clusterviz.plan.cut import Cut
from clusterviz.plan.plan import Plan

WIDEST_WINDOW = 128.0
"""Voxels: places in a window are float32."""


def slabs_in_window(most: float, longest: int) -> int:
    """Slabs of a window: a power of two, at most these and at most so many, whose sum is put behind what is kept."""
    return 1 << int(np.log2(np.clip(most, 1, longest)))


def voxels_a_slab(plan: Plan, cut: Cut | None = None) -> float:
    """Not less than the voxels of a slab in any direction; with a cut, those of its volume."""
    axes = np.array([plan.view.right, plan.view.up, plan.view.forward])
    voxels = plan.march.step_world * float(np.sqrt((axes**2).sum()))
    return voxels if cut is None else voxels * float(np.linalg.norm(cut.index_from_domain[:, :3]))
