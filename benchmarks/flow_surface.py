"""Surface LIC of a mesh beside VTK's: CPU seconds that the pattern adds to a frame. A part of `flow_ratio.py`.

A sphere of triangles in the ABC flow fills a picture of 800². Lines have 40 steps of half a pixel each way, RK4 here
and RK2 in VTK's mapper, which draws by OpenGL on the CPU where there is no GPU. Frames turn the camera; the first one
is left out. Seconds are the medians of frames with the pattern, and of frames without it.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Row, answer_of, beside, middle, show, timed

from clusterviz.comm import LoopbackChannel
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene import Scene

SIZE, STEPS, STEP_PIXELS, TRIANGLES_AROUND = 800, 40, 0.5, 96
EYES = [(-3.9 + 0.05 * n, -2.9, 1.9) for n in range(4)]


def sphere() -> Geometry:
    """Return a sphere of triangles."""
    n = TRIANGLES_AROUND
    polar, around = np.meshgrid(np.linspace(0, np.pi, n + 1), np.arange(n) * 2 * np.pi / n, indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    row, column = np.indices((n, n)).reshape(2, -1)
    a, b = row * n + column, row * n + (column + 1) % n
    # Half of the quadrilaterals at the poles has no area.
    faces = np.concatenate([np.stack([a, a + n, b + n], 1)[:-n], np.stack([a, b + n, b], 1)[n:]])
    return Geometry(mesh=Mesh("sphere", (0.8 * points.reshape(-1, 3)).astype(np.float32), faces))


def own() -> list[float]:
    """Return the seconds of frames with the pattern, and without it."""
    lic, mesh, found = {"length": 2 * STEPS * STEP_PIXELS, "step": STEP_PIXELS}, sphere(), []
    for flows in ([{"path": "field:abc:64", "show": "surface-lic", "lic": lic, "color_by": "color"}], []):
        keys: dict[str, Any] = {
            "volumes": [{"path": "field:constant:64", "opacity": 0.0, "clim": [0, 1]}],
            "meshes": [{"path": "sphere"}],
            "flows": flows,
            "camera": {"position": EYES[0], "focal_point": (0, 0, 0), "view_up": (0, 0, 1), "view_angle": 22},
            "image": {"size": [SIZE, SIZE]},
        }
        given: list[Any] = [None, mesh, *[None] * len(flows)]
        with FrameLoop(Scene.model_validate(keys), LoopbackChannel(), given, Options("cpu")) as loop:
            cameras = [loop.scene.camera.model_copy(update={"position": eye}) for eye in EYES]
            scenes = [loop.scene.model_copy(update={"camera": camera}) for camera in cameras]
            runs = [timed(lambda loop=loop, scene=scene: loop.frame(scene)) for scene in scenes]
        found.append(middle(runs[1:], "cpu"))
    return found


def measure_surface(asked: argparse.Namespace) -> list[Row]:
    """Compare what the pattern costs."""
    with tempfile.TemporaryDirectory() as folder:
        problem = Path(folder) / "problem.npz"
        np.savez(problem, size=SIZE, steps=STEPS, step=STEP_PIXELS, around=TRIANGLES_AROUND, eyes=np.array(EYES))
        theirs = answer_of([asked.peer_python, beside("flow_peer.py"), "surface", problem, "-"])["cpu_seconds"]
    found = {"clusterviz": own(), "vtk": theirs}
    rows: list[Row] = [
        {"program": program, "cpu_seconds": painted - plain, "plain": plain}
        for program, (painted, plain) in found.items()
    ]
    head, cells = "program | CPU s for the pattern | CPU s without", "{program} | {cpu_seconds:.2f} | {plain:.2f}"
    return show(head, cells, rows, "surface")


PARTS = {"surface": measure_surface}
