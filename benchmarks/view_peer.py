"""PyVista's plotter in a browser by trame, drawn on the server: the peer of `view_ratio.py`; needs pyvista and trame.

python view_peer.py VOLUME.npy PORT SHADE MAPPER      serves on 127.0.0.1, until it is ended
"""

import sys

import numpy as np
import pyvista as pv
from trame.app import get_server
from trame.ui.vuetify3 import VAppLayout
from trame_pyvista.ui import plotter_ui


def plotter(samples, shade, mapper):
    """The volume with the transfer function and the camera of `view_ratio.py`."""
    pv.OFF_SCREEN = True
    grid = pv.ImageData(dimensions=samples.shape[::-1])
    grid.point_data["values"] = samples.ravel()
    shown = pv.Plotter(off_screen=True, window_size=(800, 600))
    shown.set_background("black")
    options = {"clim": (0, 255), "shade": shade, "mapper": mapper, "opacity_unit_distance": 1.0}
    volume = shown.add_volume(grid, show_scalar_bar=False, **options)
    opacity, colour = volume.prop.GetScalarOpacity(), volume.prop.GetRGBTransferFunction()
    opacity.RemoveAllPoints()
    colour.RemoveAllPoints()
    for value, amount in ((0, 0.0), (60, 0.0), (120, 0.05), (255, 0.3)):
        opacity.AddPoint(value, amount)
    colour.AddRGBPoint(0, 0.1, 0.2, 0.6)
    colour.AddRGBPoint(255, 1.0, 0.9, 0.4)
    centre = (np.array(samples.shape[::-1]) - 1) / 2
    shown.camera.position = tuple(centre + np.array([1.3, 0.9, 1.6]) * max(samples.shape))
    shown.camera.focal_point = tuple(centre)
    shown.camera.up = (0, 1, 0)
    return shown


def main():
    path, port, shade, mapper = sys.argv[1:]
    shown = plotter(np.load(path), shade == "true", mapper)
    server = get_server("peer", client_type="vue3")
    with VAppLayout(server):
        plotter_ui(shown, mode="server", add_menu=False, server=server, style="width: 100vw; height: 100vh")
    server.start(port=int(port), host="127.0.0.1", open_browser=False, show_connection_info=False, timeout=0)


if __name__ == "__main__":
    main()
