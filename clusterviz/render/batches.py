"""Batches: slabs of a ray whose positions and sum are computed together.

Both ray casters cut rays into them, so that empty-space skipping changes no bit of a picture
(docs/concepts/accuracy.md).
"""

from __future__ import annotations

import numpy as np

from clusterviz.plan.cut import Cut
from clusterviz.plan.plan import Plan

WIDEST_WINDOW = 128.0
"""Most voxels of a batch, as positions in it are float32."""


def slabs_in_window(most: float, longest: int) -> int:
    """Return the slabs of a batch: the largest power of two up to `most` and `longest`, and at least 1."""
    return 1 << int(np.log2(np.clip(most, 1, longest)))


def voxels_a_slab(plan: Plan, cut: Cut | None = None) -> float:
    """Return an upper bound on the voxels of a slab in any direction; with a cut, voxels of its volume."""
    axes = np.array([plan.view.right, plan.view.up, plan.view.forward])
    voxels = plan.march.step_world * float(np.sqrt((axes**2).sum()))
    return voxels if cut is None else voxels * float(np.linalg.norm(cut.index_from_domain[:, :3]))
