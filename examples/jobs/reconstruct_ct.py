"""Cone-beam CT: a volume from X-ray views, on all devices of all ranks, and its picture.

    mpirun -n 4 python examples/jobs/reconstruct_ct.py scan.tif --geometry scan.yaml -o head.zarr --picture head.png

The views are a TIFF stack, or any other volume (views, rows, columns); the geometry is a YAML or JSON file:

    source_to_axis: 500.0        # world units, as all lengths
    source_to_detector: 800.0
    detector: [512, 512]         # rows and columns
    pixel_size: 0.4
    angles: {begin: 0, end: 360, count: 400}
    unattenuated: 60000          # only if the views are intensities, not line integrals

Without views, a phantom is scanned first: the renderer's additive pictures are its line integrals.
"""

import argparse

import numpy as np
from cone_beam import WINDOWS, ConeBeam, reconstruct
from mpi4py import MPI

import clusterviz
from clusterviz import jobs
from clusterviz.comm import agree
from clusterviz.data import open_source
from clusterviz.errors import ClustervizError

LOOK = {  # of the phantom: cut open, as all within its skull has nearly the same value
    "clip": {"planes": [[(0, 0, 0), (0, 0, -1)]]},
    "cmap": "gray",
    "clim": (0.1, 0.4),
    "opacity": [[0.03, 0], [0.08, 0.6]],
    "shade": True,
    "position": (1.2, -2.4, 4.5),
    "focal_point": (0, 0, -0.2),
    "view_up": (0, 0, 1),
    "background": "black",
    "size": (640, 480),
}


def circle_around(phantom, count, pixels):
    """Return the geometry of a full circle around the origin, which has a cube about it in all views."""
    radius = np.linalg.norm(phantom.grid.corners, axis=1).max()
    return ConeBeam(
        source_to_axis=4 * radius,
        source_to_detector=6 * radius,
        detector=(pixels, pixels),
        pixel_size=2 * 6 * radius / 15**0.5 / (pixels - 1),  # sin(angle) is 1/4, so tan(angle) is 1/√15
        angles={"begin": 0, "end": 360, "count": count},
    )


def scan(cluster, phantom, geometry):
    """Return the line integrals of a volume with values in 0 … 1, a distributed array (views, rows, columns).

    Each rank draws views of its own, so that their bits do not depend on the number of ranks.
    """
    views = cluster.array(geometry.shape, np.float32, (1, *geometry.detector), name="views")
    voxels = phantom.read((0, 0, 0), phantom.grid.shape_zyx)
    height, length = geometry.detector[0] * geometry.pixel_size[1], 2 * geometry.source_to_axis

    @jobs.job(reads=views.box, devices="all")
    def draw_view(index):
        picture = clusterviz.render(
            voxels,
            grid=phantom.grid,
            comm=MPI.COMM_SELF,
            blending="additive",  # the integral of value · opacity along the ray, over opacity_unit_distance
            cmap="gray",
            clim=(0, 1),
            opacity=1.0,
            opacity_unit_distance=length,
            step=0.5,
            position=tuple(geometry.rays(index[0])[0]),
            focal_point=(0, 0, 0),
            view_up=(0, 0, 1),
            view_angle=2 * np.degrees(np.arctan(height / 2 / geometry.source_to_detector)),
            size=geometry.detector[::-1],
        )
        views[index[0]] = picture[..., 0] * np.float32(length)

    cluster.run(draw_view, views.blocks)
    return views.as_source()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views", nargs="?", help="file of views; default: those of a phantom")
    parser.add_argument("--geometry", help="YAML or JSON file")
    parser.add_argument(
        "--window", choices=WINDOWS, default="ram-lak", help="of the ramp filter; the first is sharpest"
    )
    parser.add_argument("--phantom", default="field:shepp-logan:64", help="volume about the origin, values in 0 … 1")
    parser.add_argument("--count", type=int, default=120, help="views of the phantom")
    parser.add_argument("--pixels", type=int, default=96, help="of a view of the phantom, a side")
    parser.add_argument("-o", "--output", help="NAME.zarr or NAME.npy")
    parser.add_argument("--picture", help="NAME.png")
    given = parser.parse_args()
    if (given.views is None) != (given.geometry is None):
        parser.error("give views and their --geometry, or neither")
    try:
        with jobs.cluster() as cluster:
            views, geometry = given.views, given.geometry
            if views is None:
                with agree(cluster.channel, None, "phantom"):
                    phantom = open_source(given.phantom)
                    geometry = circle_around(phantom, given.count, given.pixels)
                views = scan(cluster, phantom, geometry)
            volume, grid = reconstruct(cluster, views, geometry, window=given.window)
            if given.output:
                volume.save(given.output, grid)
            if given.picture:
                picture = clusterviz.render(volume.as_source(grid), **({} if given.views else LOOK))
                if cluster.rank == 0:
                    picture.save(given.picture)
    except ClustervizError as error:
        parser.exit(error.exit_status, f"{parser.prog}: {error}\n")


if __name__ == "__main__":
    main()
