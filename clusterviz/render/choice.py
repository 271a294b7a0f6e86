"""Which ray caster draws on a rank: OpenGL where there is a GPU, else the processor by itself, where it can.

OpenGL on a software device runs on the same cores as the processor's own caster, and several times slower: it executes
every branch and takes every fetch apart.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from clusterviz.errors import DeviceError
from clusterviz.gl.devices import ENVIRONMENT, egl_devices
from clusterviz.plan.plan import Plan

if TYPE_CHECKING:
    from clusterviz.render.cpu.caster import VectorCaster
    from clusterviz.render.raycast import Raycaster

Device = int | Literal["cpu"] | None
"""What a user asks to draw on: an EGL device by its index, the processor, or what is best."""


def prefers_processor(device: Device = None, environment: Mapping[str, str] | None = None) -> bool:
    """Whether a rank draws without OpenGL what it can.

    Parameters
    ----------
    device : as the user said; where that is None and CLUSTERVIZ_EGL_DEVICE names a device, OpenGL draws on it
    environment : variables to read, this process's own by default
    """
    variables = os.environ if environment is None else environment
    if isinstance(device, int) or (device is None and variables.get(ENVIRONMENT, "").strip()):
        return False
    return device == "cpu" or not has_gpu()


def on_processor(plan: Plan, device: Device = None, environment: Mapping[str, str] | None = None) -> bool:
    """Whether a rank draws a plan without OpenGL."""
    from clusterviz.render.cpu.kernel import can_draw

    return can_draw(plan) and prefers_processor(device, environment)


def has_gpu() -> bool:
    """Whether EGL lists hardware on this node."""
    try:
        return any(not device.software for device in egl_devices())
    except DeviceError:
        return False


def egl_device(device: Device) -> int | None:
    """The EGL device that is asked for; where the processor is, but cannot draw the scene, what EGL has."""
    return None if device == "cpu" else device


def make_caster(plan: Plan, device: Device = None, local_rank: int = 0) -> Raycaster | VectorCaster:
    """The ray caster of a rank that needs no other one afterwards."""
    from clusterviz.render.cpu.caster import VectorCaster

    if on_processor(plan, device):
        return VectorCaster(plan)
    from clusterviz.gl.context import open_context
    from clusterviz.render.raycast import Raycaster

    return Raycaster(open_context(local_rank, egl_device(device)), plan)
