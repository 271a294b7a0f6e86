"""Flows by VTK and NumPy; run by `flow_ratio.py`, with a Python that has VTK.

    python flow_peer.py PROGRAM PROBLEM.npz OUT.npz

PROGRAM is vtk or numpy for lines, whose ends are written by seed, lic for a plane by vtkImageDataLIC2D, or surface for
frames of a sphere with and without a pattern by vtkSurfaceLICMapper. Prints one line of JSON, with CPU seconds.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from typing import Any

import numpy as np

Found = dict[str, Any]


def vtk_array(values: Any, name: str, components: int = 3) -> Any:
    """Return an array of VTK."""
    from vtkmodules.util.numpy_support import numpy_to_vtk  # type: ignore[import-not-found]

    found = numpy_to_vtk(np.ascontiguousarray(values).reshape(-1, components), deep=True)
    found.SetName(name)
    return found


def vtk(given: Found, out: str) -> Found:
    """Lines by vtkStreamTracer, forward only, from vectors (n, n, n, 3) over [-1, 1]³."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints, vtkSMPTools  # type: ignore[import-not-found]
    from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPolyData  # type: ignore[import-not-found]
    from vtkmodules.vtkFiltersFlowPaths import vtkStreamTracer  # type: ignore[import-not-found]

    vtkSMPTools.Initialize(1)
    vectors, seeds, step = given["vectors"], given["seeds"], float(given["step"])
    image, places, start, tracer = vtkImageData(), vtkPoints(), vtkPolyData(), vtkStreamTracer()
    image.SetDimensions(*vectors.shape[2::-1])
    image.SetOrigin(-1, -1, -1)
    image.SetSpacing(*[float(given["spacing"])] * 3)
    image.GetPointData().SetVectors(vtk_array(vectors, "U"))
    places.SetData(vtk_array(seeds, "seeds"))
    start.SetPoints(places)
    tracer.SetInputData(image)
    tracer.SetSourceData(start)
    tracer.SetIntegrationDirectionToForward()
    tracer.SetComputeVorticity(False)
    tracer.SetIntegrationStepUnit(1)  # lengths
    tracer.SetInitialIntegrationStep(step)
    tracer.SetMaximumPropagation(float(given["length"]))
    tracer.SetMaximumNumberOfSteps(100_000)
    if str(given["method"]) == "rk4":
        tracer.SetIntegratorTypeToRungeKutta4()
    else:
        tracer.SetIntegratorTypeToRungeKutta45()
        tracer.SetMinimumIntegrationStep(step / 100)
        tracer.SetMaximumIntegrationStep(2 * step)
        tracer.SetMaximumError(float(given["tolerance"]))
    began = time.process_time()
    tracer.Update()
    seconds, lines = time.process_time() - began, tracer.GetOutput()
    points = vtk_to_numpy(lines.GetPoints().GetData())
    offsets = vtk_to_numpy(lines.GetLines().GetOffsetsArray())
    along = vtk_to_numpy(lines.GetLines().GetConnectivityArray())
    ends = np.full((len(seeds), 3), np.nan)
    ends[vtk_to_numpy(lines.GetCellData().GetArray("SeedIds"))] = points[along[offsets[1:] - 1]]
    np.savez(out, ends=ends)
    return {"cpu_seconds": seconds, "points": len(points)}


def numpy(given: Found, out: str) -> Found:
    """Lines by RK4 steps of equal length, of all seeds at once, in float64."""
    vectors, spacing, step = given["vectors"], float(given["spacing"]), float(given["step"])
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
    lines, points = [given["seeds"]], given["seeds"]
    for _ in range(round(float(given["length"]) / step)):
        a = direction(points)
        b = direction(points + step / 2 * a)
        c = direction(points + step / 2 * b)
        d = direction(points + step * c)
        points = points + step / 6 * (a + 2 * b + 2 * c + d)
        lines.append(points)
    whole = np.stack(lines)
    seconds = time.process_time() - began
    np.savez(out, ends=points)
    return {"cpu_seconds": seconds, "points": int(np.isfinite(whole[..., 0]).sum())}


def lic(given: Found, out: str) -> Found:
    """Convolve a plane some times; the first round, which compiles, does not count."""
    import vtkmodules.vtkRenderingOpenGL2  # type: ignore[import-not-found]  # noqa: F401
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkRenderingCore import vtkRenderWindow  # type: ignore[import-not-found]
    from vtkmodules.vtkRenderingLICOpenGL2 import vtkImageDataLIC2D  # type: ignore[import-not-found]

    window, convolution = vtkRenderWindow(), vtkImageDataLIC2D()
    window.SetOffScreenRendering(1)
    window.Render()
    if not convolution.SetContext(window):
        sys.exit("VTK has no OpenGL for this")
    for port, (name, components) in enumerate((("vectors", 3), ("noise", 1))):
        image, data = vtkImageData(), None
        image.SetDimensions(given[name].shape[1], given[name].shape[0], 1)
        data = image.GetPointData()
        (data.SetVectors if components == 3 else data.SetScalars)(vtk_array(given[name], name, components))
        convolution.SetInputData(port, image)
    convolution.SetSteps(int(given["steps"]))
    convolution.SetStepSize(float(given["step"]))
    found = []
    for _ in range(int(given["rounds"]) + 1):
        convolution.Modified()
        wall, cpu = time.perf_counter(), time.process_time()
        convolution.Update()
        found.append((time.process_time() - cpu, time.perf_counter() - wall))
    cpu, wall = min(found[1:])
    return {"cpu_seconds": cpu, "seconds": wall}


def surface(given: Found, out: str) -> Found:
    """Frames of a sphere with the pattern, and without it: medians without the first one."""
    import vtk as all_of_vtk  # type: ignore[import-not-found]
    from vtkmodules.util.numpy_support import vtk_to_numpy

    size, around = int(given["size"]), int(given["around"])
    sphere = all_of_vtk.vtkSphereSource()
    sphere.SetRadius(0.8)
    sphere.SetThetaResolution(around)
    sphere.SetPhiResolution(around)
    sphere.Update()
    mesh = sphere.GetOutput()
    x, y, z = np.pi * vtk_to_numpy(mesh.GetPoints().GetData()).T.astype(float)
    a, b, c = 3**0.5, 2**0.5, 1.0
    flow = a * np.sin(z) + c * np.cos(y), b * np.sin(x) + a * np.cos(z), c * np.sin(y) + b * np.cos(x)
    mesh.GetPointData().SetVectors(vtk_array(np.stack(flow, axis=1), "U"))
    painted, plain = all_of_vtk.vtkSurfaceLICMapper(), all_of_vtk.vtkPolyDataMapper()
    painted.SetInputArrayToProcess(0, 0, 0, 0, "U")
    painted.GetLICInterface().SetNumberOfSteps(int(given["steps"]))
    painted.GetLICInterface().SetStepSize(float(given["step"]))
    medians = []
    for mapper in (painted, plain):
        mapper.SetInputData(mesh)
        actor, renderer, window = all_of_vtk.vtkActor(), all_of_vtk.vtkRenderer(), all_of_vtk.vtkRenderWindow()
        actor.SetMapper(mapper)
        renderer.AddActor(actor)
        window.SetOffScreenRendering(1)
        window.SetSize(size, size)
        window.AddRenderer(renderer)
        camera, seconds = renderer.GetActiveCamera(), []
        camera.SetFocalPoint(0, 0, 0)
        camera.SetViewUp(0, 0, 1)
        camera.SetViewAngle(22)
        for eye in given["eyes"].tolist():
            began = time.process_time()
            camera.SetPosition(*eye)
            window.Render()
            window.GetPixelData(0, 0, size - 1, size - 1, 1, all_of_vtk.vtkUnsignedCharArray(), 0)
            seconds.append(time.process_time() - began)
        medians.append(statistics.median(seconds[1:]))
    return {"cpu_seconds": medians}


def main() -> None:
    """Solve a problem."""
    program, problem, output = sys.argv[1:]
    with np.load(problem) as file:
        given = dict(file)
    print(json.dumps({"vtk": vtk, "numpy": numpy, "lic": lic, "surface": surface}[program](given, output)))


if __name__ == "__main__":
    main()
