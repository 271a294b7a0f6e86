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
try:
    import vtk  # type: ignore[import-not-found]
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy  # type: ignore[import-not-found]
except ImportError:
    sys.exit("flow_peer.py: this Python has no VTK")


def vtk_array(values: Any, name: str, components: int = 3) -> Any:
    found = numpy_to_vtk(np.ascontiguousarray(values).reshape(-1, components), deep=True)
    found.SetName(name)
    return found


def lines(given: Found, out: str) -> Found:
    """Lines by vtkStreamTracer, forward only, from vectors (n, n, n, 3) over [-1, 1]³."""
    vtk.vtkSMPTools.Initialize(1)
    vectors, seeds, step = given["vectors"], given["seeds"], float(given["step"])
    image, places, start, tracer = vtk.vtkImageData(), vtk.vtkPoints(), vtk.vtkPolyData(), vtk.vtkStreamTracer()
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
    seconds, found = time.process_time() - began, tracer.GetOutput()
    points, cells = vtk_to_numpy(found.GetPoints().GetData()), found.GetLines()
    last = vtk_to_numpy(cells.GetConnectivityArray())[vtk_to_numpy(cells.GetOffsetsArray())[1:] - 1]
    ends = np.full((len(seeds), 3), np.nan)
    ends[vtk_to_numpy(found.GetCellData().GetArray("SeedIds"))] = points[last]
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

    began, points, count = time.process_time(), given["seeds"], len(given["seeds"])
    for _ in range(round(float(given["length"]) / step)):
        a = direction(points)
        b = direction(points + step / 2 * a)
        c = direction(points + step / 2 * b)
        d = direction(points + step * c)
        points = points + step / 6 * (a + 2 * b + 2 * c + d)
        count += int(np.isfinite(points[:, 0]).sum())
    seconds = time.process_time() - began
    np.savez(out, ends=points)
    return {"cpu_seconds": seconds, "points": count}


def lic(given: Found, out: str) -> Found:
    """Convolve a plane some times; the first round, which compiles, does not count."""
    window, convolution = vtk.vtkRenderWindow(), vtk.vtkImageDataLIC2D()
    window.SetOffScreenRendering(1)
    window.Render()
    if not convolution.SetContext(window):
        sys.exit("VTK has no OpenGL for this")
    images = [vtk.vtkImageData(), vtk.vtkImageData()]
    for port, image in enumerate(images):
        image.SetDimensions(given["noise"].shape[1], given["noise"].shape[0], 1)
        convolution.SetInputData(port, image)
    images[0].GetPointData().SetVectors(vtk_array(given["vectors"], "vectors"))
    images[1].GetPointData().SetScalars(vtk_array(given["noise"], "noise", 1))
    convolution.SetSteps(int(given["steps"]))
    convolution.SetStepSize(float(given["step"]))
    found = []
    for _ in range(int(given["rounds"]) + 1):
        convolution.Modified()
        began = time.process_time()
        convolution.Update()
        found.append(time.process_time() - began)
    return {"cpu_seconds": min(found[1:])}


def surface(given: Found, out: str) -> Found:
    """Frames of a sphere with the pattern, and without it: medians without the first one."""
    size, around, sphere = int(given["size"]), int(given["around"]), vtk.vtkSphereSource()
    sphere.SetRadius(0.8)
    sphere.SetThetaResolution(around)
    sphere.SetPhiResolution(around)
    sphere.Update()
    mesh = sphere.GetOutput()
    x, y, z = np.pi * vtk_to_numpy(mesh.GetPoints().GetData()).T.astype(float)
    a, b, c = 3**0.5, 2**0.5, 1.0
    flow = a * np.sin(z) + c * np.cos(y), b * np.sin(x) + a * np.cos(z), c * np.sin(y) + b * np.cos(x)
    mesh.GetPointData().SetVectors(vtk_array(np.stack(flow, axis=1), "U"))
    painted, plain = vtk.vtkSurfaceLICMapper(), vtk.vtkPolyDataMapper()
    painted.SetInputArrayToProcess(0, 0, 0, 0, "U")
    painted.GetLICInterface().SetNumberOfSteps(int(given["steps"]))
    painted.GetLICInterface().SetStepSize(float(given["step"]))
    medians = []
    for mapper in (painted, plain):
        mapper.SetInputData(mesh)
        actor, renderer, window = vtk.vtkActor(), vtk.vtkRenderer(), vtk.vtkRenderWindow()
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
            window.GetPixelData(0, 0, size - 1, size - 1, 1, vtk.vtkUnsignedCharArray(), 0)
            seconds.append(time.process_time() - began)
        medians.append(statistics.median(seconds[1:]))
    return {"cpu_seconds": medians}


if __name__ == "__main__":
    program, problem, output = sys.argv[1:]
    with np.load(problem) as file:
        found = dict(file)
    print(json.dumps({"vtk": lines, "numpy": numpy, "lic": lic, "surface": surface}[program](found, output)))
