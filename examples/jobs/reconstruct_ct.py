"""Cone-beam CT: a volume from X-ray views, on all devices of all ranks.

    mpirun -n 4 python examples/jobs/reconstruct_ct.py scan.tif --geometry scan.yaml -o scan.ome.zarr
    clusterviz render scan.ome.zarr -o scan.png

The views are a TIFF stack, or an array .npy (views, rows, columns); the geometry is a YAML or JSON file with the keys
of `clusterviz.jobs.reconstruction.ConeBeam`. Without views, a phantom is scanned first by the renderer itself, whose
additive pictures are line integrals. They are written beside the result, as files that a scanner could have made.
"""

import argparse
from pathlib import Path

import numpy as np
import tifffile

import clusterviz
from clusterviz import jobs
from clusterviz.data import open_source
from clusterviz.jobs.reconstruction import ConeBeam, load_geometry, reconstruct
from clusterviz.scene.yaml_text import write_yaml


def scan(volume, views, pixels):
    """Return the geometry of a circle around a volume, and on rank 0 its views, float32 (views, pixels, pixels)."""
    corners = open_source(volume).grid.corners
    centre, radius = corners.mean(axis=0), np.ptp(corners, axis=0).max() * 3**0.5 / 2
    geometry = ConeBeam(
        source_to_axis=4 * radius,
        source_to_detector=6 * radius,
        detector=(pixels, pixels),
        pixel_size=2 * 1.05 * 6 / 15**0.5 * radius / pixels,  # the sphere around the volume is in all views
        angles={"begin": 0, "end": 360, "count": views},
    )
    height = geometry.pixel_size[1] * pixels
    view_angle = 2 * np.degrees(np.arctan(height / 2 / geometry.source_to_detector))
    found = []
    for angle in np.radians(geometry.angles):
        towards = np.array([np.cos(angle), np.sin(angle), 0.0])
        picture = clusterviz.render(
            volume,
            blending="additive",  # the integral of opacity × value in clim, over opacity_unit_distance
            cmap="gray",
            clim=(0, 1),
            opacity=1.0,
            opacity_unit_distance=2 * radius,
            position=tuple(centre + geometry.source_to_axis * towards),
            focal_point=tuple(centre),
            view_up=(0, 0, 1),
            view_angle=view_angle,
            size=(pixels, pixels),
            step=0.5,
        )
        if picture is not None:
            found.append(np.asarray(picture)[..., 0] * np.float32(2 * radius))
    return geometry, np.array(found)


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("views", nargs="?", help="TIFF stack or .npy; default: those of a phantom")
parser.add_argument("--geometry", help="YAML or JSON file")
parser.add_argument("-o", "--output", default="reconstruction.ome.zarr", help="OME-Zarr store")
parser.add_argument("--window", default="ram-lak", help="ram-lak, shepp-logan or hann")
parser.add_argument(
    "--phantom", default="field:shepp-logan:96", help="volume to scan, with values in 0 … 1 about the origin"
)
parser.add_argument("--count", type=int, default=180, help="views of the phantom")
parser.add_argument("--pixels", type=int, default=128, help="of the detector, a side")
arguments = parser.parse_args()

with jobs.cluster() as cluster:
    if arguments.views is None:
        geometry, pictures = scan(arguments.phantom, arguments.count, arguments.pixels)
        arguments.views, arguments.geometry = (Path(arguments.output).with_suffix(s) for s in (".views.tif", ".yaml"))
        if cluster.rank == 0:
            tifffile.imwrite(arguments.views, pictures)
            arguments.geometry.write_text(write_yaml(geometry.model_dump(mode="json", exclude_none=True)))
        cluster.channel.barrier()
    volume, grid = reconstruct(
        cluster, open_source(arguments.views), load_geometry(arguments.geometry), window=arguments.window
    )
    volume.save(arguments.output, grid)
