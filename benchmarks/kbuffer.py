"""K-buffers beside the exact walk: CPU time of a frame, wrong pixels and comparisons.

    python benchmarks/kbuffer.py [--size 512] [--rounds 5]

Scenes are disk_out_ref, and the head of `clusterviz samples ch2better`, taken at 36³ points and split into tetrahedra.
Frames of all ways alternate on one rank; a time is the least CPU time of drawing of all rounds, all threads, sorting
and lists included.
"""

from __future__ import annotations

import argparse
import itertools
import warnings

import numpy as np

from clusterviz.comm import LoopbackChannel
from clusterviz.content.grid.section import GridSection, KBuffer
from clusterviz.data import open_source, read_grid
from clusterviz.data.samples import fetch_sample
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene.values import Camera, ImageSettings, Scene

KINDS = ["exact", *(KBuffer(k=k, entries=own) for k in (2, 6, 12, 32) for own in ("sorted", "unsorted"))]
KINDS += [KBuffer(k=12, integration="table")]


def head(side: int = 36) -> UnstructuredGrid:
    """Return a volume as hexahedra."""
    source = open_source(fetch_sample("ch2better"))
    voxels = source.read((0, 0, 0), source.grid.shape_zyx).astype(np.float32)
    voxels = voxels[np.ix_(*(np.linspace(0, count - 1, side).round().astype(int) for count in voxels.shape))]
    k, j, i = np.indices(voxels.shape)
    number = np.arange(voxels.size).reshape(voxels.shape)
    first = number[:-1, :-1, :-1].ravel()
    corners = [number[z, y, x] for z, y, x in ((0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0))]
    corners += [number[1, y, x] for y, x in ((0, 0), (0, 1), (1, 1), (1, 0))]
    cells = first[:, None] + np.array(corners)
    points = np.stack([i, j, k], axis=-1).reshape(-1, 3).astype(np.float32)
    return UnstructuredGrid("head", points, {"hexahedron": cells}, {"f": voxels.ravel()})


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=5)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    for name, grid, array in (("disk_out_ref", read_grid(fetch_sample("disk-out")), "Temp"), ("head", head(), "f")):
        values = grid.point_arrays[array]
        low, high = np.percentile(values, [1, 99])
        centre, side = (grid.points.max(axis=0) + grid.points.min(axis=0)) / 2, np.ptp(grid.points, axis=0)
        opacity = ((float(low), 0.0), (float((low + high) / 2), 0.1), (float(high), 0.4))
        eye = centre + np.linalg.norm(side) * np.array([1.2, -1.1, 0.8])
        unit = float(np.linalg.norm(side) / 50)
        section = GridSection(path="g", array=array, opacity=opacity, opacity_unit_distance=unit)
        camera = Camera(position=tuple(eye.tolist()), focal_point=tuple(centre.tolist()), view_up=(0, 0, 1))
        image = ImageSettings(size=(asked.size, asked.size), background="transparent")
        scene = Scene(grids=(section,), camera=camera, image=image)
        least, last = dict[str, float](), {}
        with FrameLoop(scene, LoopbackChannel(), [grid], Options("cpu", overlap=False)) as loop:
            for _, kind in itertools.product(range(asked.rounds), KINDS):
                shown = loop.scene.grids[0].model_copy(update={"visibility": kind})
                frame = loop.scene.model_copy(update={"grids": (shown,)})
                loop.frame(frame)  # its tables
                drawn = loop.frame(frame)
                rank = drawn.statistics.per_rank[0]
                least[str(kind)] = min(least.get(str(kind), np.inf), rank.cpu_seconds)
                last[str(kind)] = np.asarray(drawn.image), rank.kbuffer
        print(f"{name}: {int((last['exact'][0][..., 3] > 0).sum()):,} pixels")
        for kind, (picture, counts) in last.items():
            apart = np.abs(picture - last["exact"][0]).max(axis=2)
            counted = str(vars(counts)) if counts else ""
            print(
                f"  {kind}: {1e3 * least[kind]:.0f} ms, {least[kind] / least['exact']:.2f} of exact, "
                f"largest difference {apart.max():.2g}, {int((apart > 1e-3).sum())} over 1e-3; {counted}"
            )


if __name__ == "__main__":
    main()
