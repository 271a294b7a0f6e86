"""How far rays may skip in a domain with several volumes or with geometry, as groups_of_domain.glsl reads it.

References
----------
D. Cohen, Z. Sheffer: Proximity clouds - an acceleration technique for 3D grid traversal, The Visual Computer 11, 1994.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.plan.plan import Plan
from clusterviz.render.cpu.empty_space import distances
from clusterviz.render.storage import GroupBox
from clusterviz.render.stored_brick import Ranges, visible_groups

HEADER = 8
"""Words in front of the groups."""
ALL = -1
"""Shift that says that all bricks are visible."""


def skips_in_box(
    plan: Plan, box: GroupBox, bricks: NDArray[np.int64], ranges: Sequence[Ranges], far: bool
) -> NDArray[np.int32]:
    """Return a header, and how far rays may skip from the groups around some bricks.

    Parameters
    ----------
    bricks : int64 (n, 3), indices (z, y, x)
    ranges : results of `ranges_of` for each
    far : rays may skip several groups at once, which takes longer to find; else one

    Returns
    -------
    table : int32 (8 + groups,): first group and number of groups along x, y, z, and `GroupBox.shift`, or `ALL` with
        grids, as where walks go is not known here; then 0 where something may be visible, else the groups from here
        that rays may skip along every axis, x fastest
    """
    header = np.zeros(HEADER, np.int32)
    header[6] = ALL if plan.content.cells else box.shift
    alike = defaultdict[Index, list[int]](list)
    for number, (low, _) in enumerate(ranges):
        if low.size:
            alike[low.shape[1:]].append(number)
    if header[6] == ALL or not alike:
        return header
    boxes = [box.of((z, y, x)) for z, y, x in bricks.tolist()]
    some = np.array([boxes[number] for numbers in alike.values() for number in numbers])
    first = some[:, 0].min(axis=0)
    shown = np.zeros(some[:, 1].max(axis=0) - first, bool)
    for numbers in alike.values():
        low, high = (np.stack([ranges[number][side] for number in numbers]) for side in (0, 1))
        for number, visible in zip(numbers, visible_groups((low, high), plan), strict=True):
            shown[tuple(slice(*ends) for ends in zip(*np.subtract(boxes[number], first), strict=True))] = visible
    header[:6] = *first[::-1], *shown.shape[::-1]
    return np.concatenate([header, (distances(shown) if far else ~shown).ravel().astype(np.int32, copy=False)])
