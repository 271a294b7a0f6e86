"""VTK's casters and mappers on one scene: seconds a frame, and the picture. It needs a Python with VTK, no clusterviz.

    python vtk_peer.py SCENE.npz MAPPER WIDTHxHEIGHT FRAMES OUT.npy [orbit]

MAPPER draws the volume or grid: gpu (vtkOpenGLGPUVolumeRayCastMapper), cpu (vtkFixedPointVolumeRayCastMapper), raycast,
zsweep or projected (of unstructured grids; the first two by partial pre-integration). SCENE.npz holds

- vertices_N (n, 3), triangles_N (m, 3) and rgba_N (4,) of mesh N = 0, 1, …; surfaces are not lit, and peeled if one is
  transparent
- voxels (z, y, x), spacing, origin and step (world units) of a volume, and shade; or points (n, 3), tetrahedra (m, 4)
  and values (n,) of points or (m,) of tetrahedra
- value, opacity and rgb of the transfer function, and unit, its opacity unit distance
- position, focal_point, view_up and view_angle

OUT.npy is float32 (h, w, 3), over black, row 0 on top. With `orbit` the camera turns by a degree before each frame. One
JSON line is printed: `median_s`, `min_s` and `cpu_s` of the frames behind the first one with the picture on the host,
`first_s`, `drawn_s`, the median until the card is done, and `bytes`, what drawing added to the process.
"""

import json
import sys
import time

import numpy as np

try:
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
except ImportError:
    sys.exit("vtk_peer.py: this Python has no VTK")

GRIDS = {
    "raycast": "vtkUnstructuredGridVolumeRayCastMapper",
    "zsweep": "vtkUnstructuredGridVolumeZSweepMapper",
    "projected": "vtkProjectedTetrahedraMapper",
}


def memory():
    with open("/proc/self/statm") as status:
        return 4096 * int(status.read().split()[1])


def cells_of(corners):
    cells = vtk.vtkCellArray()
    cells.SetData(corners.shape[1], numpy_to_vtkIdTypeArray(corners.astype(np.int64).ravel(), deep=1))
    return cells


def points_of(positions):
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(positions), deep=1))
    return points


def add_meshes(renderer, scene):
    """Add all meshes; return whether one is transparent."""
    count, transparent = 0, False
    while f"vertices_{count}" in scene:
        mesh, mapper, actor = vtk.vtkPolyData(), vtk.vtkPolyDataMapper(), vtk.vtkActor()
        mesh.SetPoints(points_of(scene[f"vertices_{count}"]))
        mesh.SetPolys(cells_of(scene[f"triangles_{count}"]))
        mapper.SetInputData(mesh)
        actor.SetMapper(mapper)
        *rgb, alpha = scene[f"rgba_{count}"].tolist()
        actor.GetProperty().SetColor(*rgb)
        actor.GetProperty().SetOpacity(alpha)
        actor.GetProperty().LightingOff()
        renderer.AddActor(actor)
        count, transparent = count + 1, transparent or alpha < 1
    return transparent


def volume_mapper(scene, kind):
    voxels, image = scene["voxels"], vtk.vtkImageData()
    image.SetDimensions(*voxels.shape[::-1])
    image.SetSpacing(*scene["spacing"].tolist())
    image.SetOrigin(*scene["origin"].tolist())
    image.GetPointData().SetScalars(numpy_to_vtk(voxels.ravel(), deep=1))
    mapper = vtk.vtkOpenGLGPUVolumeRayCastMapper() if kind == "gpu" else vtk.vtkFixedPointVolumeRayCastMapper()
    mapper.SetInputData(image)
    mapper.SetAutoAdjustSampleDistances(0)
    mapper.SetSampleDistance(float(scene["step"]))
    if kind == "gpu":
        mapper.SetMaxMemoryInBytes(60 << 30)
        mapper.SetMaxMemoryFraction(0.9)
    else:
        mapper.SetImageSampleDistance(1.0)
    return mapper


def grid_mapper(scene, kind):
    grid, mapper = vtk.vtkUnstructuredGrid(), getattr(vtk, GRIDS[kind])()
    grid.SetPoints(points_of(scene["points"]))
    grid.SetCells(vtk.VTK_TETRA, cells_of(scene["tetrahedra"]))
    on_points = len(scene["values"]) == len(scene["points"])
    (grid.GetPointData() if on_points else grid.GetCellData()).SetScalars(numpy_to_vtk(scene["values"], deep=1))
    mapper.SetInputData(grid)
    if kind != "projected":
        mapper.SetAutoAdjustSampleDistances(0)
        mapper.SetImageSampleDistance(1.0)
        mapper.SetRayIntegrator(vtk.vtkUnstructuredGridPartialPreIntegration())
    return mapper


def property_of(scene):
    opacity, colour, look = vtk.vtkPiecewiseFunction(), vtk.vtkColorTransferFunction(), vtk.vtkVolumeProperty()
    for value, alpha in zip(scene["value"].tolist(), scene["opacity"].tolist()):  # noqa: B905
        opacity.AddPoint(value, alpha)
    colours = scene["colour_value"] if "colour_value" in scene else scene["value"]
    for value, rgb in zip(colours.tolist(), scene["rgb"].tolist()):  # noqa: B905
        colour.AddRGBPoint(value, *rgb)
    look.SetInterpolationTypeToLinear()
    look.SetScalarOpacity(opacity)
    look.SetColor(colour)
    look.SetScalarOpacityUnitDistance(float(scene["unit"]))
    look.SetShade(int(scene["shade"]) if "shade" in scene else 0)
    return look


def opened(scene, kind, width, height):
    """Return the window of a scene, and its camera."""
    renderer, window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
    renderer.SetBackground(0, 0, 0)
    has_volume = "voxels" in scene
    if add_meshes(renderer, scene):
        renderer.SetUseDepthPeeling(1)
        renderer.SetUseDepthPeelingForVolumes(has_volume)
        renderer.SetMaximumNumberOfPeels(10**6)  # none is left out
        renderer.SetOcclusionRatio(0.0)
    if has_volume or "points" in scene:
        volume = vtk.vtkVolume()
        volume.SetMapper(volume_mapper(scene, kind) if has_volume else grid_mapper(scene, kind))
        volume.SetProperty(property_of(scene))
        renderer.AddVolume(volume)
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetAlphaBitPlanes(1)
    window.SetSize(width, height)
    window.AddRenderer(renderer)
    camera = renderer.GetActiveCamera()
    camera.SetPosition(*scene["position"].tolist())
    camera.SetFocalPoint(*scene["focal_point"].tolist())
    camera.SetViewUp(*scene["view_up"].tolist())
    camera.SetViewAngle(float(scene["view_angle"]))
    renderer.ResetCameraClippingRange()
    return renderer, window, camera


def main():
    scene, kind, frames, out = np.load(sys.argv[1]), sys.argv[2], int(sys.argv[4]), sys.argv[5]
    width, height = map(int, sys.argv[3].split("x"))
    before = memory()
    renderer, window, camera = opened(scene, kind, width, height)
    seconds, drawn, cpu = [], [], []
    for _ in range(frames + 1):
        camera.Azimuth(float(len(sys.argv) > 6))
        renderer.ResetCameraClippingRange()
        camera.Modified()  # else the mappers keep their picture
        window.Modified()
        start, start_cpu, pixels = time.perf_counter(), time.process_time(), vtk.vtkUnsignedCharArray()
        window.Render()
        window.WaitForCompletion()
        drawn.append(time.perf_counter() - start)
        window.GetPixelData(0, 0, width - 1, height - 1, 0, pixels, 0)
        grab = vtk_to_numpy(pixels)
        seconds.append(time.perf_counter() - start)
        cpu.append(time.process_time() - start_cpu)
    np.save(out, grab.reshape(height, width, -1)[::-1, :, :3].astype(np.float32) / 255)
    names = [line for line in (window.ReportCapabilities() or "").split("\n") if "renderer string" in line]
    later = {"median_s": float(np.median(seconds[1:] or seconds)), "min_s": min(seconds[1:] or seconds)}
    later |= {"cpu_s": min(cpu[1:] or cpu), "drawn_s": float(np.median(drawn[1:] or drawn)), "first_s": seconds[0]}
    print(json.dumps(later | {"bytes": memory() - before, "renderer": names[0] if names else ""}), flush=True)


main()
