"""VTK's GPU ray caster, or its dual depth peeling of meshes, on an orbit of one degree a frame; one JSON line.

    python vtk_orbit.py volume VOLUME.npy WIDTH HEIGHT FRAMES STEP SHADED    VOLUME: uint8 (z, y, x); SHADED: 0 or 1
    python vtk_orbit.py mesh MESHES.npz WIDTH HEIGHT FRAMES                  as of vtk_peeling.py, without a volume

`median_s` is that of drawing until the card is done, `with_readback_s` with the RGBA bytes on the host.
"""

import json
import statistics
import sys
import time

import numpy as np
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkImageData, vtkPiecewiseFunction, vtkPolyData
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkColorTransferFunction,
    vtkPolyDataMapper,
    vtkRenderer,
    vtkRenderWindow,
    vtkVolume,
    vtkVolumeProperty,
    vtkWindowToImageFilter,
)
from vtkmodules.vtkRenderingVolumeOpenGL2 import vtkOpenGLGPUVolumeRayCastMapper

EYE = np.array([1.3, 0.9, 1.6])


def add_volume(renderer, path, step, shaded):
    """Add a volume with the transfer function of `vtk_raycast_ratio.equivalent_scene`; return its centre and size."""
    voxels = np.load(path)
    image, opacity, colour = vtkImageData(), vtkPiecewiseFunction(), vtkColorTransferFunction()
    image.SetDimensions(*voxels.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(voxels.ravel(), deep=1))
    for value, alpha in ((0, 0.0), (60, 0.0), (120, 0.05), (255, 0.3)):
        opacity.AddPoint(value, alpha)
    colour.AddRGBPoint(0, 0.1, 0.2, 0.6)
    colour.AddRGBPoint(255, 1, 0.9, 0.4)
    look, mapper, volume = vtkVolumeProperty(), vtkOpenGLGPUVolumeRayCastMapper(), vtkVolume()
    look.SetInterpolationTypeToLinear()
    look.SetScalarOpacity(opacity)
    look.SetColor(colour)
    look.SetScalarOpacityUnitDistance(1.0)
    look.SetShade(shaded)
    mapper.SetInputData(image)
    mapper.SetAutoAdjustSampleDistances(0)
    mapper.SetSampleDistance(step)
    mapper.SetMaxMemoryInBytes(60 << 30)
    mapper.SetMaxMemoryFraction(0.9)
    volume.SetMapper(mapper)
    volume.SetProperty(look)
    renderer.AddVolume(volume)
    return (np.array(voxels.shape[::-1]) - 1) / 2, max(voxels.shape)


def add_meshes(renderer, path):
    """Add meshes, peeled if any is transparent; return the centre and the size of their bounds."""
    scene, count, corners = np.load(path), 0, []
    while f"vertices_{count}" in scene:
        points, cells, mesh = vtkPoints(), vtkCellArray(), vtkPolyData()
        points.SetData(numpy_to_vtk(scene[f"vertices_{count}"], deep=1))
        cells.SetData(3, numpy_to_vtkIdTypeArray(scene[f"triangles_{count}"].astype(np.int64).ravel(), deep=1))
        mesh.SetPoints(points)
        mesh.SetPolys(cells)
        mapper, actor = vtkPolyDataMapper(), vtkActor()
        mapper.SetInputData(mesh)
        actor.SetMapper(mapper)
        *rgb, alpha = scene[f"rgba_{count}"].tolist()
        actor.GetProperty().SetColor(*rgb)
        actor.GetProperty().SetOpacity(alpha)
        actor.GetProperty().LightingOff()
        renderer.AddActor(actor)
        corners += [scene[f"vertices_{count}"].min(axis=0), scene[f"vertices_{count}"].max(axis=0)]
        count += 1
    renderer.SetUseDepthPeeling(1)
    renderer.SetMaximumNumberOfPeels(10**6)
    renderer.SetOcclusionRatio(0.0)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return (low + high) / 2, float((high - low).max())


def main():
    """Draw the orbit and print its times."""
    kind, path, width, height, frames = sys.argv[1], sys.argv[2], *map(int, sys.argv[3:6])
    renderer, window = vtkRenderer(), vtkRenderWindow()
    renderer.SetBackground(0, 0, 0)
    if kind == "volume":
        centre, size = add_volume(renderer, path, float(sys.argv[6]), int(sys.argv[7]))
    else:
        centre, size = add_meshes(renderer, path)
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetAlphaBitPlanes(1)
    window.SetSize(width, height)
    window.AddRenderer(renderer)
    camera = renderer.GetActiveCamera()
    camera.SetFocalPoint(*centre)
    camera.SetPosition(*(centre + EYE * size))
    camera.SetViewUp(0, 1, 0)
    camera.SetViewAngle(30)
    drawn, read = [], []
    for _ in range(frames + 1):
        camera.Azimuth(1.0)
        renderer.ResetCameraClippingRange()
        begin = time.perf_counter()
        window.Render()
        window.WaitForCompletion()
        drawn.append(time.perf_counter() - begin)
        grab = vtkWindowToImageFilter()
        grab.SetInput(window)
        grab.ReadFrontBufferOff()
        grab.SetInputBufferTypeToRGBA()
        grab.ShouldRerenderOff()
        grab.Update()
        vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())
        read.append(time.perf_counter() - begin)
    names = [line for line in window.ReportCapabilities().split("\n") if "renderer string" in line]
    found = {"median_s": statistics.median(drawn[1:]), "with_readback_s": statistics.median(read[1:])}
    print(json.dumps(found | {"first_s": read[0], "renderer": names[0] if names else ""}), flush=True)


main()
