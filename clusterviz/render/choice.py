"""Choice of the ray caster of a rank: OpenGL if there is a GPU, else the CPU ray caster.

OpenGL on a software device runs on the same cores as the CPU ray caster and is several times slower: it executes every
branch and emulates every fetch.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.gl.devices import Device, egl_device, prefers_cpu
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import Slot, slot_of

if TYPE_CHECKING:
    from clusterviz.render.caster import Caster


def check_opengl(plan: Plan) -> None:
    """Check that OpenGL can draw the bricks of a plan.

    Raises
    ------
    InputError
        They have several sizes.
    """
    if plan.layout.edges_zyx is not None:
        raise InputError(
            "OpenGL draws bricks of one size only",
            where="cluster.largest_brick",
            found="bricks of several sizes",
            allowed="null; or the CPU (--device cpu)",
        )


def brick_bytes(plan: Plan, on_cpu: bool) -> NDArray[np.int64]:
    """Return the bytes of each brick in a renderer, int64 (bz, by, bx), whether it is visible or not.

    Parameters
    ----------
    on_cpu : in the CPU ray caster, which takes a word for a voxel; else in OpenGL's slots
    """
    slot = slot_of(plan)
    if not on_cpu:
        return slot.counted(plan.layout.counts_zyx, lambda slot: slot.bytes)
    if not slot.mixed:
        return slot.counted(plan.layout.counts_zyx, _slot_bytes)
    sizes = np.full(plan.cost.shape, 4 * slot.header_words * len(slot.parts), np.int64)
    for layer, part in zip(plan.content.volume_layers, slot.parts, strict=True):
        # A brick holds only samples of the volumes that it meets, and of its level.
        met = layer.cut.bricks_met()
        levels = np.zeros(met.shape, np.uint8) if layer.brick_levels is None else layer.brick_levels
        for level in np.unique(levels).tolist():
            own = replace(part, cells_zyx=layer.cut.at(level).most_cells_zyx)
            sizes += np.where(met & (levels == level), _slot_bytes(own), 0)
    return sizes


def _slot_bytes(slot: Slot) -> int:
    from clusterviz.render.cpu.memory import words_of

    return 4 * words_of(slot)


def make_caster(plan: Plan, device: Device = None, local_rank: int = 0) -> Caster:
    """Return a ray caster for one plan."""
    if prefers_cpu(device):
        from clusterviz.render.cpu.device import cpu_caster

        return cpu_caster(plan)
    from clusterviz.gl.context import open_context
    from clusterviz.render.opengl import opengl_caster

    return opengl_caster(open_context(local_rank, egl_device(device)), plan)
