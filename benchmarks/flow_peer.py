"""Lines of `flow.py`'s vectors by other programs; run by it, with a Python that has VTK.

    python flow_peer.py PROBLEM.npz PROGRAM OUT.npz     PROGRAM: vtk or numpy

Prints one line of JSON: CPU seconds, and points of lines. Writes the ends of the lines, by seed.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

Found = tuple[float, int, Any]


def vtk(vectors: Any, spacing: float, seeds: Any, step: float, length: float, method: str, tolerance: float) -> Found:
    """Lines by vtkStreamTracer, forward only, from vectors (n, n, n, 3) over [-1, 1]³."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy  # type: ignore[import-not-found]
    from vtkmodules.vtkCommonCore import vtkPoints, vtkSMPTools  # type: ignore[import-not-found]
    from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPolyData  # type: ignore[import-not-found]
    from vtkmodules.vtkFiltersFlowPaths import vtkStreamTracer  # type: ignore[import-not-found]

    vtkSMPTools.Initialize(1)
    image, places, start = vtkImageData(), vtkPoints(), vtkPolyData()
    image.SetDimensions(*vectors.shape[2::-1])
    image.SetOrigin(-1, -1, -1)
    image.SetSpacing(spacing, spacing, spacing)
    array = numpy_to_vtk(vectors.reshape(-1, 3), deep=True)
    array.SetName("U")
    image.GetPointData().SetVectors(array)
    places.SetData(numpy_to_vtk(seeds, deep=True))
    start.SetPoints(places)
    tracer = vtkStreamTracer()
    tracer.SetInputData(image)
    tracer.SetSourceData(start)
    tracer.SetIntegrationDirectionToForward()
    tracer.SetComputeVorticity(False)
    tracer.SetIntegrationStepUnit(1)  # lengths
    tracer.SetInitialIntegrationStep(step)
    tracer.SetMaximumPropagation(length)
    tracer.SetMaximumNumberOfSteps(100_000)
    if method == "rk4":
        tracer.SetIntegratorTypeToRungeKutta4()
    else:
        tracer.SetIntegratorTypeToRungeKutta45()
        tracer.SetMinimumIntegrationStep(step / 100)
        tracer.SetMaximumIntegrationStep(2 * step)
        tracer.SetMaximumError(tolerance)
    began = time.process_time()
    tracer.Update()
    seconds = time.process_time() - began
    lines = tracer.GetOutput()
    points = vtk_to_numpy(lines.GetPoints().GetData())
    offsets = vtk_to_numpy(lines.GetLines().GetOffsetsArray())
    along = vtk_to_numpy(lines.GetLines().GetConnectivityArray())
    ends = np.full((len(seeds), 3), np.nan)
    ends[vtk_to_numpy(lines.GetCellData().GetArray("SeedIds"))] = points[along[offsets[1:] - 1]]
    return seconds, len(points), ends


def numpy(vectors: Any, spacing: float, seeds: Any, step: float, length: float, method: str, tolerance: float) -> Found:
    """Lines by RK4 steps of equal length, of all seeds at once, in float64."""
    last = vectors.shape[0] - 1

    def direction(points: Any) -> Any:
        at = (points + 1) / spacing
        inside = ((at >= 0) & (at <= last)).all(axis=1)
        low = np.clip(at.astype(int), 0, last - 1)
        (u, v, w), (i, j, k) = (at - low).T[..., None], low.T
        x = [[vectors[k + c, j + b, i] * (1 - u) + vectors[k + c, j + b, i + 1] * u for b in (0, 1)] for c in (0, 1)]
        y = [x[c][0] * (1 - v) + x[c][1] * v for c in (0, 1)]
        found = y[0] * (1 - w) + y[1] * w
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        found[~inside] = np.nan
        return found

    began = time.process_time()
    lines, points = [seeds], seeds
    for _ in range(round(length / step)):
        a = direction(points)
        b = direction(points + step / 2 * a)
        c = direction(points + step / 2 * b)
        d = direction(points + step * c)
        points = points + step / 6 * (a + 2 * b + 2 * c + d)
        lines.append(points)
    whole = np.stack(lines)
    seconds = time.process_time() - began
    return seconds, int(np.isfinite(whole[..., 0]).sum()), points


def main() -> None:
    """Trace the lines of a problem."""
    problem, program, output = sys.argv[1:]
    with np.load(problem) as file:
        numbers = [file["vectors"], float(file["spacing"]), file["seeds"], float(file["step"]), float(file["length"])]
        method, tolerance = str(file["method"]), float(file["tolerance"])
    seconds, points, ends = {"vtk": vtk, "numpy": numpy}[program](*numbers, method, tolerance)
    np.savez(output, ends=ends)
    print(json.dumps({"cpu_seconds": seconds, "points": points}))


if __name__ == "__main__":
    main()
