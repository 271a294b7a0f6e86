"""Choice of the CPU where the driver of OpenGL is known to draw a scene wrong.

`clusterviz doctor --gl` finds that out and keeps it. Without what it has kept, nothing is known, and nothing is asked.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from math import prod

from clusterviz.errors import DataWarning, DeviceError
from clusterviz.frame.opening import Opened
from clusterviz.frame.run import Run
from clusterviz.gl.devices import ENVIRONMENT, egl_device, prefers_cpu
from clusterviz.gl.driver_record import driver_of, known_wrong
from clusterviz.scene.features import features_of
from clusterviz.scene.values import Scene


def with_right_device(run: Run, scene: Scene, opened: Opened | None, step: str) -> Run:
    """Return the run, on the CPU if a rank's driver is known to draw a scene wrong; collective.

    Before its content is opened, a scene is as the user has given it, and nothing is known of its voxels. Progress and
    failures name `step`.

    Raises
    ------
    DeviceError
        There is such a driver, and the user has chosen its device.
    """
    with run.collective(step):
        local_rank = run.channel.placement().local_rank
    with run.local(step):
        found = _found(run, scene, opened, local_rank)
    with run.collective(step):
        every = [each for each in run.channel.allgather(found) if each]
    if not every:
        return run
    text = every[0]
    asked = os.environ.get(ENVIRONMENT, "").strip()
    with run.local(step):
        if isinstance(run.options.device, int) or asked:
            raise DeviceError(f"{text}; allowed --device cpu, another device, or another driver: then test that again")
    if run.channel.rank == 0:
        warnings.warn(f"{text}; the CPU draws instead", DataWarning, stacklevel=4)
    return Run(run.channel, replace(run.options, device="cpu"), run.frame, run.clock)


def _found(run: Run, scene: Scene, opened: Opened | None, local_rank: int) -> str:
    """Return what this rank's driver is known to draw wrong of a scene, in one text; "" if nothing."""
    device = run.options.device

    def driver() -> str:
        if prefers_cpu(device):
            return ""
        from clusterviz.gl.context import open_context

        context = open_context(local_rank, egl_device(device))
        name = driver_of(context.info)
        context.release()
        return name

    volumes = opened.volumes if opened else ()
    has_invalid = any(each.summary.histogram.sum() < prod(each.grid.shape_zyx) for each in volumes)
    name, wrong = known_wrong(features_of(scene, has_invalid), driver)
    each = "; ".join(f"{feature} ({text})" for feature, text in wrong.items())
    return f"{name} draws wrong, as `clusterviz doctor --gl` has found: {each}" if wrong else ""
