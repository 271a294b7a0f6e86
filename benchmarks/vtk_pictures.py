"""A scene drawn by VTK's two ray casters: `python benchmarks/vtk_pictures.py SCENE.json OUT_PREFIX`.

It needs a Python that has VTK, and nothing of clusterviz. The scene is complete, of one .npy volume, control points for
colours and opacities, and a perspective camera. It writes `OUT_PREFIX_gpu.npy` and `OUT_PREFIX_cpu.npy`: bytes
(h, w, 3), over black, row 0 on top.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy


def property_of(volume: dict[str, Any]) -> Any:
    """VTK's transfer functions from a scene's control points."""
    opacity, colour, found = vtk.vtkPiecewiseFunction(), vtk.vtkColorTransferFunction(), vtk.vtkVolumeProperty()
    for value, alpha in volume["opacity"]:
        opacity.AddPoint(value, alpha)
    for point in volume["cmap"]:
        colour.AddRGBPoint(*point)
    found.SetInterpolationTypeToLinear()
    found.SetScalarOpacity(opacity)
    found.SetColor(colour)
    found.SetScalarOpacityUnitDistance(volume["opacity_unit_distance"])
    return found


def picture(scene: dict[str, Any], mapper: Any, image: Any) -> np.ndarray[Any, Any]:
    """One caster's picture."""
    mapper.SetInputData(image)
    mapper.SetAutoAdjustSampleDistances(0)
    mapper.SetSampleDistance(scene["quality"]["step"])
    if hasattr(mapper, "SetImageSampleDistance"):
        mapper.SetImageSampleDistance(1.0)
    shown, renderer, window = vtk.vtkVolume(), vtk.vtkRenderer(), vtk.vtkRenderWindow()
    shown.SetMapper(mapper)
    shown.SetProperty(property_of(scene["volumes"][0]))
    renderer.AddVolume(shown)
    renderer.SetBackground(0, 0, 0)
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(*scene["image"]["size"])
    window.AddRenderer(renderer)
    camera, wanted = renderer.GetActiveCamera(), scene["camera"]
    camera.SetFocalPoint(*wanted["focal_point"])
    camera.SetPosition(*wanted["position"])
    camera.SetViewUp(*wanted["view_up"])
    camera.SetViewAngle(wanted["view_angle"])
    renderer.ResetCameraClippingRange()
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.Update()
    width, height = scene["image"]["size"]
    return vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars()).reshape(height, width, -1)[::-1, :, :3]


def main() -> None:
    """Draw by both."""
    scene = json.loads(Path(sys.argv[1]).read_text())
    voxels = np.load(scene["volumes"][0]["path"])
    image = vtk.vtkImageData()
    image.SetDimensions(*voxels.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(voxels.ravel(), deep=1))
    casters = {"gpu": vtk.vtkOpenGLGPUVolumeRayCastMapper(), "cpu": vtk.vtkFixedPointVolumeRayCastMapper()}
    for name, mapper in casters.items():
        np.save(f"{sys.argv[2]}_{name}.npy", picture(scene, mapper, image))


if __name__ == "__main__":
    main()
