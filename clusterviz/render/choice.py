"""Choice of the ray caster of a rank: OpenGL if there is a GPU, else the CPU ray caster.

OpenGL on a software device runs on the same cores as the CPU ray caster and is several times slower: it executes every
branch and emulates every fetch.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError, InputError
from clusterviz.gl.devices import ENVIRONMENT, egl_devices
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import Slot, slot_of

if TYPE_CHECKING:
    from clusterviz.render.cpu.caster import VectorCaster
    from clusterviz.render.raycast import Raycaster

Device = int | Literal["cpu"] | None
"""Device to draw on, as a user sets it: an EGL device by its index, the CPU, or None for the best one."""


def prefers_cpu(device: Device = None, environment: Mapping[str, str] | None = None) -> bool:
    """Return True if a rank prefers the CPU ray caster to OpenGL.

    Parameters
    ----------
    device : the user's setting; if it is None and CLUSTERVIZ_EGL_DEVICE names a device, OpenGL draws on that
    environment : variables to read, this process's own by default
    """
    variables = os.environ if environment is None else environment
    if isinstance(device, int) or (device is None and variables.get(ENVIRONMENT, "").strip()):
        return False
    return device == "cpu" or not has_gpu()


def has_gpu() -> bool:
    """Return True if EGL lists hardware on this node."""
    try:
        return any(not device.software for device in egl_devices())
    except DeviceError:
        return False


def egl_device(device: Device) -> int | None:
    """Return the EGL device of a setting; EGL's default for the CPU."""
    return None if device == "cpu" else device


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
    if plan.content is None:
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


def make_caster(plan: Plan, device: Device = None, local_rank: int = 0) -> Raycaster | VectorCaster:
    """Return a ray caster for one plan."""
    from clusterviz.render.cpu.caster import VectorCaster

    if prefers_cpu(device):
        return VectorCaster(plan)
    from clusterviz.gl.context import open_context
    from clusterviz.render.raycast import Raycaster

    return Raycaster(open_context(local_rank, egl_device(device)), plan)
