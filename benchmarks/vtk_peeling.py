"""VTK's dual depth peeling of meshes with a volume: seconds a frame, and the picture.

    python vtk_peeling.py SCENE.npz WIDTH OUT.npy [FRAMES]

SCENE.npz holds vertices_N (n, 3), triangles_N (m, 3) and rgba_N (4,) of mesh N = 0, 1, …; voxels (z, y, x), spacing,
origin and step (world units) of a volume, with value, opacity and rgb of its transfer function and unit, its opacity
unit distance, or none of these; and position, focal_point, view_up and view_angle. Surfaces are not lit. One JSON
line is printed; OUT.npy is float32 (h, w, 3), over black, row 0 on top.
"""

import json
import sys
import time

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

scene, width, out = np.load(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
frames = int(sys.argv[4]) if len(sys.argv) > 4 else 5
renderer = vtk.vtkRenderer()
renderer.SetBackground(0, 0, 0)
opaque, count = True, 0
while f"vertices_{count}" in scene:
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(scene[f"vertices_{count}"], deep=1))
    triangles = scene[f"triangles_{count}"].astype(np.int64)
    cells = vtk.vtkCellArray()
    cells.SetData(3, numpy_to_vtkIdTypeArray(triangles.ravel(), deep=1))
    mesh = vtk.vtkPolyData()
    mesh.SetPoints(points)
    mesh.SetPolys(cells)
    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputData(mesh)
    actor = vtk.vtkActor()
    actor.SetMapper(mapper)
    *rgb, alpha = scene[f"rgba_{count}"].tolist()
    actor.GetProperty().SetColor(*rgb)
    actor.GetProperty().SetOpacity(alpha)
    actor.GetProperty().LightingOff()
    opaque &= alpha == 1.0
    renderer.AddActor(actor)
    count += 1
if "voxels" in scene:
    voxels = scene["voxels"]
    image = vtk.vtkImageData()
    image.SetDimensions(*voxels.shape[::-1])
    image.SetSpacing(*scene["spacing"].tolist())
    image.SetOrigin(*scene["origin"].tolist())
    image.GetPointData().SetScalars(numpy_to_vtk(voxels.ravel(), deep=1))
    opacity, colour = vtk.vtkPiecewiseFunction(), vtk.vtkColorTransferFunction()
    for value, alpha, rgb in zip(scene["value"], scene["opacity"], scene["rgb"], strict=True):
        opacity.AddPoint(value, alpha)
        colour.AddRGBPoint(value, *rgb)
    look = vtk.vtkVolumeProperty()
    look.SetInterpolationTypeToLinear()
    look.SetScalarOpacity(opacity)
    look.SetColor(colour)
    look.SetScalarOpacityUnitDistance(float(scene["unit"]))
    mapper = vtk.vtkOpenGLGPUVolumeRayCastMapper()
    mapper.SetInputData(image)
    mapper.SetAutoAdjustSampleDistances(0)
    mapper.SetSampleDistance(float(scene["step"]))
    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(look)
    renderer.AddVolume(volume)
window = vtk.vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetMultiSamples(0)
window.SetAlphaBitPlanes(1)
window.SetSize(width, width)
window.AddRenderer(renderer)
if not opaque:
    renderer.SetUseDepthPeeling(1)
    renderer.SetUseDepthPeelingForVolumes("voxels" in scene)
    renderer.SetMaximumNumberOfPeels(10**6)  # none is left out
    renderer.SetOcclusionRatio(0.0)
camera = renderer.GetActiveCamera()
camera.SetPosition(*scene["position"].tolist())
camera.SetFocalPoint(*scene["focal_point"].tolist())
camera.SetViewUp(*scene["view_up"].tolist())
camera.SetViewAngle(float(scene["view_angle"]))
renderer.ResetCameraClippingRange()
grab, seconds = np.zeros(0), []
for _ in range(frames + 1):
    window.Modified()
    start = time.perf_counter()
    window.Render()
    pixels = vtk.vtkUnsignedCharArray()
    window.GetPixelData(0, 0, width - 1, width - 1, 0, pixels, 0)
    grab = vtk_to_numpy(pixels)
    seconds.append(time.perf_counter() - start)
picture = grab.reshape(width, width, -1)[::-1, :, :3].astype(np.float32) / 255
np.save(out, picture)
drawn = window.ReportCapabilities() or ""
name = next((line.split(":", 1)[1].strip() for line in drawn.splitlines() if "renderer string" in line), "")
print(
    json.dumps(
        {"peer": "vtk-peeling", "median_s": float(np.median(seconds[1:])), "min_s": min(seconds[1:]), "renderer": name}
    )
)
