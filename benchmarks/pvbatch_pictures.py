"""ParaView's volume rendering of its Wavelet or a file: `pvbatch benchmarks/pvbatch_pictures.py ORDER.json OUT_PREFIX`.

It runs under ParaView's own Python and needs nothing of clusterviz. The order holds `file`, or `size` (samples a side),
`scene` (complete, of clusterviz), `frames` (positions of the camera) and `samples`. pvbatch runs it on rank 0 alone. It
prints the seconds of each frame as JSON, and writes the last frame as `OUT_PREFIX.png`; where `samples` is true, the
volume too, as `OUT_PREFIX.npy`, float32 (z, y, x).
"""

import json
import sys
import time

import numpy as np
from paraview.simple import (
    ColorBy,
    CreateRenderView,
    GetColorTransferFunction,
    GetOpacityTransferFunction,
    OpenDataFile,
    Render,
    SaveScreenshot,
    Show,
    Wavelet,
    _DisableFirstRenderCameraReset,
    servermanager,
)
from vtk.util.numpy_support import vtk_to_numpy

with open(sys.argv[1]) as file:
    order = json.load(file)
scene, prefix = order["scene"], sys.argv[2]
volume, width_height = scene["volumes"][0], scene["image"]["size"]
if "file" in order:
    source = OpenDataFile(order["file"])
else:
    size = order["size"]
    source = Wavelet(WholeExtent=[-size // 2, size // 2 - 1] * 3)
source.UpdatePipeline()
name = source.PointData.GetArray(0).Name
if order.get("samples"):
    samples = vtk_to_numpy(servermanager.Fetch(source).GetPointData().GetArray(name))
    np.save(prefix + ".npy", samples.reshape(size, size, size))
_DisableFirstRenderCameraReset()
view = CreateRenderView()
view.UseColorPaletteForBackground = 0
view.Background = [0, 0, 0]
view.OrientationAxesVisibility = 0
view.ViewSize = width_height
display = Show(source, view)
display.SetRepresentationType("Volume")
ColorBy(display, ("POINTS", name))
colours, opacity = GetColorTransferFunction(name), GetOpacityTransferFunction(name)
colours.ColorSpace = "RGB"
colours.RGBPoints = [number for point in volume["cmap"] for number in point]
opacity.Points = [number for point in volume["opacity"] for number in (*point, 0.5, 0.0)]
display.ScalarOpacityUnitDistance = volume["opacity_unit_distance"]
if "file" in order:
    # Mesa's OpenGL refuses large textures: the picture is then black.
    display.VolumeRenderingMode = "Ray Cast Only"
display.SetScalarBarVisibility(view, False)
view.CameraFocalPoint = scene["camera"]["focal_point"]
view.CameraViewUp = scene["camera"]["view_up"]
view.CameraViewAngle = scene["camera"]["view_angle"]
seconds = []
for position in order["frames"]:
    view.CameraPosition = position
    start = time.time()
    Render(view)
    seconds.append(time.time() - start)
SaveScreenshot(prefix + ".png", view, ImageResolution=width_height)
print(json.dumps({"seconds": seconds}))
