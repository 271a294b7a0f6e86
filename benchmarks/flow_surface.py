"""Surface LIC of a mesh beside VTK's: CPU seconds that the pattern adds to a frame. A part of `flow_ratio.py`.

A sphere of triangles in the ABC flow fills a picture of 800². Lines have 40 steps of half a pixel each way, RK4 here
and RK2 in VTK's mapper, which draws by OpenGL on the CPU where there is no GPU. Frames turn the camera; the first one
is left out. Seconds are the medians of frames with the pattern, and of frames without it.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

SIZE, STEPS, STEP_PIXELS, TRIANGLES_AROUND = 800, 40, 0.5, 96
EYES = [(-3.9 + 0.05 * n, -2.9, 1.9) for n in range(4)]
Draw = Callable[[tuple[float, float, float]], object]


def seconds_of(draw: Draw) -> float:
    """Return the median CPU seconds of frames, of all threads."""
    found = []
    for eye in EYES:
        began = time.process_time()
        draw(eye)
        found.append(time.process_time() - began)
    return statistics.median(found[1:])


def own() -> list[float]:
    """Return the seconds of frames with the pattern, and without it."""
    import numpy as np

    from clusterviz.comm import LoopbackChannel
    from clusterviz.data.geometry import Geometry, Mesh
    from clusterviz.frame import FrameLoop, Options
    from clusterviz.scene import Scene

    n = TRIANGLES_AROUND
    polar, around = np.meshgrid(np.linspace(0, np.pi, n + 1), np.arange(n) * 2 * np.pi / n, indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    row, column = np.indices((n, n)).reshape(2, -1)
    a, b = row * n + column, row * n + (column + 1) % n
    # Half of the quadrilaterals at the poles has no area.
    faces = np.concatenate([np.stack([a, a + n, b + n], 1)[:-n], np.stack([a, b + n, b], 1)[n:]])
    mesh = Geometry(mesh=Mesh("sphere", (0.8 * points.reshape(-1, 3)).astype(np.float32), faces))
    lic = {"length": 2 * STEPS * STEP_PIXELS, "step": STEP_PIXELS}
    found = []
    for flows in ([{"path": "field:abc:64", "show": "surface-lic", "lic": lic, "color_by": "color"}], []):
        scene = Scene(
            volumes=[{"path": "field:constant:64", "opacity": 0.0, "clim": [0, 1]}],
            meshes=[{"path": "sphere"}],
            flows=flows,
            camera={"position": EYES[0], "focal_point": (0, 0, 0), "view_up": (0, 0, 1), "view_angle": 22},
            image={"size": [SIZE, SIZE]},
        )
        given: list[Any] = [None, mesh, *[None] * len(flows)]
        with FrameLoop(scene, LoopbackChannel(), given, Options("cpu")) as loop:

            def draw(eye: tuple[float, float, float], loop: FrameLoop = loop) -> object:
                camera = loop.scene.camera.model_copy(update={"position": eye})
                return loop.frame(loop.scene.model_copy(update={"camera": camera}))

            found.append(seconds_of(draw))
    return found


def peer() -> list[float]:
    """Return the seconds of VTK's frames."""
    import numpy as np
    import vtk  # type: ignore[import-not-found]
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy  # type: ignore[import-not-found]

    sphere = vtk.vtkSphereSource()
    sphere.SetRadius(0.8)
    sphere.SetThetaResolution(TRIANGLES_AROUND)
    sphere.SetPhiResolution(TRIANGLES_AROUND)
    sphere.Update()
    mesh = sphere.GetOutput()
    x, y, z = np.pi * vtk_to_numpy(mesh.GetPoints().GetData()).T.astype(float)
    a, b, c = 3**0.5, 2**0.5, 1.0
    flow = a * np.sin(z) + c * np.cos(y), b * np.sin(x) + a * np.cos(z), c * np.sin(y) + b * np.cos(x)
    vectors = numpy_to_vtk(np.stack(flow, axis=1), deep=1)
    vectors.SetName("U")
    mesh.GetPointData().SetVectors(vectors)
    lic, plain = vtk.vtkSurfaceLICMapper(), vtk.vtkPolyDataMapper()
    lic.SetInputArrayToProcess(0, 0, 0, 0, "U")
    lic.GetLICInterface().SetNumberOfSteps(STEPS)
    lic.GetLICInterface().SetStepSize(STEP_PIXELS)
    found = []
    for mapper in (lic, plain):
        mapper.SetInputData(mesh)
        actor, renderer, window = vtk.vtkActor(), vtk.vtkRenderer(), vtk.vtkRenderWindow()
        actor.SetMapper(mapper)
        renderer.AddActor(actor)
        window.SetOffScreenRendering(1)
        window.SetSize(SIZE, SIZE)
        window.AddRenderer(renderer)
        camera = renderer.GetActiveCamera()
        camera.SetFocalPoint(0, 0, 0)
        camera.SetViewUp(0, 0, 1)
        camera.SetViewAngle(22)

        def draw(eye: tuple[float, float, float], camera: Any = camera, window: Any = window) -> object:
            camera.SetPosition(*eye)
            window.Render()
            return window.GetPixelData(0, 0, SIZE - 1, SIZE - 1, 1, vtk.vtkUnsignedCharArray(), 0)

        found.append(seconds_of(draw))
    return found


def measure_surface(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Compare what the pattern costs."""
    printed = subprocess.run([options.peer_python, __file__], check=True, capture_output=True, text=True).stdout
    rows = []
    for program, (painted, plain) in {"clusterviz": own(), "vtk": json.loads(printed.splitlines()[-1])}.items():
        seconds = painted - plain
        rows.append({"part": "surface", "program": program, "cpu_seconds": seconds, "plain_cpu_seconds": plain})
        print(f"surface {program:11} {seconds:.2f} s of CPU time for the pattern, {plain:.2f} s without", flush=True)
    return rows


PARTS = {"surface": measure_surface}

if __name__ == "__main__":
    json.dump(peer(), sys.stdout)
