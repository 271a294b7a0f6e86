"""K-buffers beside the exact walk: CPU time of a frame, wrong pixels and comparisons.

    python benchmarks/kbuffer.py [--size 512] [--rounds 5]

Scenes are disk_out_ref, and the head of `clusterviz samples ch2better`, taken at 36³ points and split into tetrahedra.
Frames of all ways alternate on one rank; a time is the least CPU time of drawing of all rounds, all threads, sorting
and lists included.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from measuring import Row, opened, options, picked, sample, show, write

from clusterviz.comm import LoopbackChannel
from clusterviz.content.grid.section import GridSection, KBuffer
from clusterviz.data import read_grid
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene.values import Camera, ImageSettings, Scene

KINDS = ["exact", *(KBuffer(k=k, entries=own) for k in (2, 6, 12, 32) for own in ("sorted", "unsorted"))]
KINDS += [KBuffer(k=12, integration="table")]


def boxes(voxels: Any) -> UnstructuredGrid:
    """A volume as hexahedra, with its index as position."""
    number = np.arange(voxels.size).reshape(voxels.shape)
    first = number[:-1, :-1, :-1].ravel()
    corners = [number[z, y, x] for z in (0, 1) for y, x in ((0, 0), (0, 1), (1, 1), (1, 0))]
    points = np.stack(np.indices(voxels.shape)[::-1], axis=-1).reshape(-1, 3).astype(np.float32)
    return UnstructuredGrid("head", points, {"hexahedron": first[:, None] + np.array(corners)}, {"f": voxels.ravel()})


def scene_of(grid: UnstructuredGrid, array: str, size: int) -> Scene:
    """A grid, seen whole."""
    low, high = np.percentile(grid.point_arrays[array], [1, 99])
    centre, side = (grid.points.max(axis=0) + grid.points.min(axis=0)) / 2, np.ptp(grid.points, axis=0)
    diagonal = float(np.linalg.norm(side))
    opacity = ((float(low), 0.0), (float((low + high) / 2), 0.1), (float(high), 0.4))
    section = GridSection(path="g", array=array, opacity=opacity, opacity_unit_distance=diagonal / 50)
    eye = centre + diagonal * np.array([1.2, -1.1, 0.8])
    camera = Camera(position=tuple(eye.tolist()), focal_point=tuple(centre.tolist()), view_up=(0, 0, 1))
    return Scene(grids=(section,), camera=camera, image=ImageSettings(size=(size, size), background="transparent"))


def measured(name: str, grid: UnstructuredGrid, array: str, asked: Any) -> Iterator[Row]:
    """Draw by all kinds in turn."""
    least, last = dict[str, float](), {}
    scene = scene_of(grid, array, asked.size)
    with FrameLoop(scene, LoopbackChannel(), [grid], Options("cpu", overlap=False)) as loop:
        for _, kind in itertools.product(range(asked.rounds), KINDS):
            shown = loop.scene.grids[0].model_copy(update={"visibility": kind})
            frame = loop.scene.model_copy(update={"grids": (shown,)})
            loop.frame(frame)  # its tables
            drawn = loop.frame(frame)
            rank = drawn.statistics.per_rank[0]
            least[str(kind)] = min(least.get(str(kind), np.inf), rank.cpu_seconds)
            last[str(kind)] = np.asarray(drawn.image), rank.kbuffer
    exact = last["exact"][0]
    for kind, (picture, counts) in last.items():
        apart = np.abs(picture - exact).max(axis=2)
        row = {"scene": name, "kind": kind, "s": least[kind], "ratio": least[kind] / least["exact"]}
        row |= {"max": apart.max(), "over": int((apart > 1e-3).sum()), "pixels": int((exact[..., 3] > 0).sum())}
        yield row | (vars(counts) if counts else {})


def main() -> None:
    """Measure, and print a table."""
    asked = options(__doc__, size=512, rounds=5)
    warnings.simplefilter("ignore")
    head = boxes(picked(opened(sample(name="ch2better"))[1], 36, 36, 36).astype(np.float32))
    grids = (("disk_out_ref", read_grid(sample(name="disk-out")), "Temp"), ("head", head, "f"))
    rows = (row for each in grids for row in measured(*each, asked))
    title = "scene | pixels | kind | ms | of exact | largest difference | over 1e-3 | wrong | fragments | comparisons"
    cells = "{scene} | {pixels:,} | {kind} | {s!m:.0f} | {ratio:.2f} | {max:.2g} | {over} | "
    write(asked, rows=show(title, cells + "{wrong_pixels} | {fragments} | {comparisons}", rows))


if __name__ == "__main__":
    main()
