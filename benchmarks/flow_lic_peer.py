"""Line integral convolution of a plane by vtkImageDataLIC2D; run by `flow.py`, with a Python that has VTK.

    python flow_lic_peer.py PROBLEM.npz

Prints one line of JSON: the least CPU seconds of some rounds, and their seconds. The first round, which compiles, does
not count.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np


def image(values: Any, components: int) -> Any:
    """Return vectors or scalars on a grid of pixels."""
    from vtkmodules.util.numpy_support import numpy_to_vtk  # type: ignore[import-not-found]
    from vtkmodules.vtkCommonDataModel import vtkImageData  # type: ignore[import-not-found]

    found, array = vtkImageData(), numpy_to_vtk(values.reshape(-1, components), deep=True)
    found.SetDimensions(values.shape[1], values.shape[0], 1)
    array.SetName("values")
    data = found.GetPointData()
    (data.SetVectors if components == 3 else data.SetScalars)(array)
    return found


def main() -> None:
    """Convolve some times."""
    import vtkmodules.vtkRenderingOpenGL2  # type: ignore[import-not-found]  # noqa: F401
    from vtkmodules.vtkRenderingCore import vtkRenderWindow  # type: ignore[import-not-found]
    from vtkmodules.vtkRenderingLICOpenGL2 import vtkImageDataLIC2D  # type: ignore[import-not-found]

    with np.load(sys.argv[1]) as file:
        vectors, noise, rounds = image(file["vectors"], 3), image(file["noise"], 1), int(file["rounds"])
        steps, step = int(file["steps"]), float(file["step"])
    window, lic = vtkRenderWindow(), vtkImageDataLIC2D()
    window.SetOffScreenRendering(1)
    window.Render()
    if not lic.SetContext(window):
        sys.exit("VTK has no OpenGL for this")
    lic.SetInputData(0, vectors)
    lic.SetInputData(1, noise)
    lic.SetSteps(steps)
    lic.SetStepSize(step)
    found = []
    for _ in range(rounds + 1):
        lic.Modified()
        wall, cpu = time.perf_counter(), time.process_time()
        lic.Update()
        found.append((time.process_time() - cpu, time.perf_counter() - wall))
    cpu, wall = min(found[1:])
    print(json.dumps({"cpu_seconds": cpu, "seconds": wall}))


if __name__ == "__main__":
    main()
