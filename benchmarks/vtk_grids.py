"""VTK's mappers of unstructured grids: seconds a frame, and the picture.

    python vtk_grids.py SCENE.npz MAPPER WIDTH OUT.npy [FRAMES]

MAPPER is raycast (vtkUnstructuredGridVolumeRayCastMapper, with its partial pre-integration), zsweep
(vtkUnstructuredGridVolumeZSweepMapper) or projected (vtkProjectedTetrahedraMapper). SCENE.npz holds points (n, 3),
tetrahedra (m, 4), and values (n,) of points or (m,) of tetrahedra; value, opacity and rgb of the transfer function and
unit, its opacity unit distance; and position, focal_point, view_up and view_angle. One JSON line is printed; OUT.npy is
float32 (h, w, 3), over black, row 0 on top. If FRAMES is 0, times are those of the first frame.
"""

import json
import sys
import time

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

MAPPERS = {
    "raycast": vtk.vtkUnstructuredGridVolumeRayCastMapper,
    "zsweep": vtk.vtkUnstructuredGridVolumeZSweepMapper,
    "projected": vtk.vtkProjectedTetrahedraMapper,
}
scene, kind, width, out = np.load(sys.argv[1]), sys.argv[2], int(sys.argv[3]), sys.argv[4]
frames = int(sys.argv[5]) if len(sys.argv) > 5 else 5


def memory():
    """Bytes of the process."""
    with open("/proc/self/statm") as status:
        return 4096 * int(status.read().split()[1])


points = vtk.vtkPoints()
points.SetData(numpy_to_vtk(np.ascontiguousarray(scene["points"]), deep=1))
tetrahedra = scene["tetrahedra"].astype(np.int64)
cells = vtk.vtkCellArray()
cells.SetData(4, numpy_to_vtkIdTypeArray(tetrahedra.ravel(), deep=1))
grid = vtk.vtkUnstructuredGrid()
grid.SetPoints(points)
grid.SetCells(vtk.VTK_TETRA, cells)
values = numpy_to_vtk(scene["values"], deep=1)
on_points = len(scene["values"]) == len(scene["points"])
(grid.GetPointData() if on_points else grid.GetCellData()).SetScalars(values)
opacity, colour = vtk.vtkPiecewiseFunction(), vtk.vtkColorTransferFunction()
for value, alpha, rgb in zip(scene["value"].tolist(), scene["opacity"].tolist(), scene["rgb"].tolist(), strict=True):
    opacity.AddPoint(value, alpha)
    colour.AddRGBPoint(value, *rgb)
look = vtk.vtkVolumeProperty()
look.SetInterpolationTypeToLinear()
look.ShadeOff()
look.SetScalarOpacity(opacity)
look.SetColor(colour)
look.SetScalarOpacityUnitDistance(float(scene["unit"]))
before = memory()
mapper = MAPPERS[kind]()
mapper.SetInputData(grid)
if kind != "projected":
    mapper.SetAutoAdjustSampleDistances(0)
    mapper.SetImageSampleDistance(1.0)
    mapper.SetRayIntegrator(vtk.vtkUnstructuredGridPartialPreIntegration())
volume = vtk.vtkVolume()
volume.SetMapper(mapper)
volume.SetProperty(look)
renderer = vtk.vtkRenderer()
renderer.SetBackground(0, 0, 0)
renderer.AddVolume(volume)
window = vtk.vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetMultiSamples(0)
window.SetSize(width, width)
window.AddRenderer(renderer)
camera = renderer.GetActiveCamera()
camera.SetPosition(*scene["position"].tolist())
camera.SetFocalPoint(*scene["focal_point"].tolist())
camera.SetViewUp(*scene["view_up"].tolist())
camera.SetViewAngle(float(scene["view_angle"]))
renderer.ResetCameraClippingRange()
grab, seconds, cpu_seconds = np.zeros(0), [], []
for _ in range(frames + 1):
    camera.Modified()  # else the mappers keep their picture
    window.Modified()
    start, start_cpu = time.perf_counter(), time.process_time()
    window.Render()
    pixels = vtk.vtkUnsignedCharArray()
    window.GetPixelData(0, 0, width - 1, width - 1, 0, pixels, 0)
    grab = vtk_to_numpy(pixels)
    seconds.append(time.perf_counter() - start)
    cpu_seconds.append(time.process_time() - start_cpu)
np.save(out, grab.reshape(width, width, -1)[::-1, :, :3].astype(np.float32) / 255)
print(
    json.dumps(
        {
            "peer": f"vtk-{kind}",
            "tetrahedra": len(tetrahedra),
            "median_s": float(np.median(seconds[1:] or seconds)),
            "min_s": min(seconds[1:] or seconds),
            "cpu_s": min(cpu_seconds[1:] or cpu_seconds),
            "first_s": seconds[0],
            "bytes_a_tetrahedron": (memory() - before) / max(1, len(tetrahedra)),
            "threads": vtk.vtkMultiThreader.GetGlobalDefaultNumberOfThreads(),
        }
    )
)
