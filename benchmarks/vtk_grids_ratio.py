"""Time, error and memory of unstructured grids against VTK's mappers.

    python benchmarks/vtk_grids_ratio.py --python PYTHON_WITH_VTK [--only NAME]… [--width 512] [--small 32] [--json F]

Rounds of `vtk_peer.py`, which draws with VTK, and of this program alternate on the same tetrahedra, camera and
transfer function, each in a process of its own. A frame is whole, from the camera to the picture in memory. VTK's ray
cast and ZSweep take seconds a frame, so they draw one frame, in the first round; of more than `--most` tetrahedra they
draw none. Errors are those of pictures at a smaller size from the float64 reference, whose segments
are told for the larger size. Bytes are what a process takes for
drawing beyond the given arrays, its libraries and windows with it.
Times are medians, and CPU times minima, of the frames behind the first one.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from kbuffer import boxes
from measuring import (
    PEER_PYTHON,
    Row,
    answer_of,
    loaded,
    opened,
    options,
    picked,
    picture_of,
    prepared,
    sample,
    timed,
    whole_pieces,
    write,
)
from vtk_raycast_ratio import peer

from clusterviz.content.grid.section import GridSection
from clusterviz.data import read_grid
from clusterviz.data.samples import SAMPLES, Sample
from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.reference import render_reference
from clusterviz.reference.cells import find_passages, place_cells
from clusterviz.reference.rays import camera_rays
from clusterviz.scene import Scene
from clusterviz.scene.values import Camera, ImageSettings, Quality

Arrays = dict[str, Any]
THIN, OPAQUE = (0.0, 0.1, 0.4), (0.0, 0.999, 0.999)  # opacity at the 1st and 99th percentile, and between them
SAMPLES["hyper"] = Sample(  # a format of its own, so that it is of use here alone
    "dxsamples",
    "deb",
    "",
    "usr/share/dx/samples/data/hyper.dx",
    "83b902ffbc3231bf3eaf0d786f3396264512676626185cab8a8edd72ba43259e",
    "IPL-1.0",
    "flow around a wing, 34,295 tetrahedra",
    "hyper.dx",
)


def hyper() -> Tetrahedra:
    """Flow around a wing, 34,295 tetrahedra of OpenDX."""
    data = Path(sample(name="hyper")).read_bytes()
    begin = data.index(b"\nend\n") + 5
    values = np.frombuffer(data, ">f4", 8000, begin).astype(np.float32)
    points = np.frombuffer(data, ">f4", 24000, begin + 32000).reshape(-1, 3).astype(np.float32)
    corners = np.frombuffer(data, ">i4", 4 * 34295, begin + 128000).reshape(-1, 4).astype(np.int64)
    return make_tetrahedra(UnstructuredGrid("hyper", points, {"tetra": corners}, {"f": values}))


def disk() -> Tetrahedra:
    """Temperature in a reactor, 7,472 hexahedra in 44,832 tetrahedra."""
    return make_tetrahedra(read_grid(sample(name="disk-out")), "Temp")


def brain(side: int) -> Tetrahedra:
    """Brain MRI, sampled and split in 6 (side − 1)³ tetrahedra."""
    return make_tetrahedra(boxes(picked(opened(sample(name="ch2better"))[1], side, side, side).astype(np.float32)))


SCENES: dict[str, tuple[Callable[[], Tetrahedra], tuple[float, ...]]] = {
    "hyper": (hyper, THIN),
    "disk": (disk, THIN),
    "brain": (lambda: brain(36), THIN),
    "opaque": (lambda: brain(36), OPAQUE),
    "large": (lambda: brain(70), THIN),
}
SLOW = ("raycast", "zsweep")


def arrays_of(tetrahedra: Tetrahedra, opacity: tuple[float, ...]) -> Arrays:
    """Return what vtk_peer.py reads: the grid, a transfer function, and a camera that sees all of it."""
    low, high = np.array(tetrahedra.bounds)
    centre, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    first, last = np.percentile(tetrahedra.values, [1, 99])
    return {
        "points": tetrahedra.points,
        "tetrahedra": tetrahedra.corners,
        "values": tetrahedra.values,
        "value": np.linspace(first, last, 3),
        "opacity": opacity,
        "rgb": [(0.1, 0.2, 0.6), (0.5, 0.5, 0.5), (1.0, 0.9, 0.4)],
        "unit": diagonal / 50,
        "position": centre + diagonal * np.array([1.2, -1.1, 0.8]),
        "focal_point": centre,
        "view_up": (0.0, 0.0, 1.0),
        "view_angle": 30.0,
    }


def scene_of(given: Arrays, width: int) -> tuple[Scene, UnstructuredGrid]:
    """Return the scene of the arrays, and its grid."""
    grid = UnstructuredGrid(
        "g", given["points"], {"tetra": given["tetrahedra"].astype(np.int64)}, {"f": given["values"]}
    )
    values, opacity = given["value"].tolist(), given["opacity"].tolist()
    section = GridSection(
        path="g",
        clim=(float(given["values"].min()), float(given["values"].max())),
        cmap=tuple((value, *rgb) for value, rgb in zip(values, given["rgb"].tolist(), strict=True)),
        opacity=tuple(zip(values, opacity, strict=True)),
        opacity_unit_distance=float(given["unit"]),
    )
    camera = {name: given[name].tolist() for name in ("position", "focal_point", "view_up", "view_angle")}
    return Scene(
        grids=(section,),
        camera=Camera(**camera),
        image=ImageSettings(size=(width, width), background="black"),
        quality=Quality(early_termination=1 / 255 if max(opacity) > 0.9 else 0.0),
    ), grid


def draw(path: str, width: int, frames: int, out: str) -> Row:
    """Draw the arrays of a file as vtk_peer.py does, and return the same numbers."""
    scene, grid = scene_of(dict(np.load(path)), width)
    before = memory()

    def begin() -> Any:
        plan, bricks = prepared(scene, [grid])
        caster = loaded(plan, bricks, "cpu")
        return caster, plan, caster.draw(plan, whole_pieces(plan))

    first = timed(begin)
    caster, plan, drawn = first.value
    runs = [timed(lambda: caster.draw(plan, whole_pieces(plan))) for _ in range(frames)] or [first]
    np.save(out, picture_of((width, width), drawn)[..., :3])
    walls = [run.wall for run in runs]
    later = {"median_s": statistics.median(walls), "min_s": min(walls), "cpu_s": min(run.cpu for run in runs)}
    return later | {"first_s": first.wall, "bytes": memory() - before}


def memory() -> int:
    """Bytes of the process."""
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])


def report_on(name: str, asked: argparse.Namespace) -> dict[str, Any]:
    """Measure one scene and print a line for each program."""
    make, opacity = SCENES[name]
    given = arrays_of(make(), opacity)
    count = len(given["tetrahedra"])
    peers = [kind for kind in ("projected", *SLOW) if kind not in SLOW or count <= asked.most]
    with tempfile.TemporaryDirectory() as temporary:
        path, picture = Path(temporary) / "scene.npz", Path(temporary) / "picture.npy"
        np.savez(path, **given)

        def measure(kind: str, width: int, frames: int) -> Row:
            if kind == "ours":
                return answer_of([sys.executable, __file__, "--draw", path, width, frames, picture])
            return peer(asked.python, path, kind, (width, width), frames, picture)

        found: dict[str, Any] = {}
        for number in range(asked.rounds):
            for kind in ("ours", *peers):
                if number and kind in SLOW:
                    continue
                each = measure(kind, asked.width, 0 if kind in SLOW else asked.frames)
                known = found.setdefault(kind, each | {"rounds": [], "cpu_rounds": []})
                known["rounds"].append(each["median_s"])
                known["cpu_rounds"].append(each["cpu_s"])
        if asked.small and count <= asked.most:
            scene, grid = scene_of(dict(np.load(path)), asked.small)
            exact = render_reference(scene, [], [], cells=[place_cells(scene.grids[0], grid)])[..., :3]
            rays = camera_rays(scene.camera, scene.image.size)
            passages = len(find_passages(rays, make_tetrahedra(grid)).ray)
            found["ours"]["segments"] = int(passages * (asked.width / asked.small) ** 2)
            for kind in ("ours", *peers):
                measure(kind, asked.small, 0)
                found[kind]["error"] = float(np.abs(np.load(picture) - exact).max())
    for kind, each in found.items():
        seconds, cpu = (each["median_s"], each["cpu_s"]) = statistics.median(each["rounds"]), min(each["cpu_rounds"])
        times = f"{1e3 * seconds:6.0f} ms, {1e3 * cpu:6.0f} ms of CPU, {count / seconds / 1e6:.2f} million tetrahedra/s"
        ours = found["ours"]
        more = f"{seconds / ours['median_s']:.1f} and {cpu / ours['cpu_s']:.1f} times ours"
        if kind == "ours":
            more = f"{1e9 * cpu / each['segments']:.1f} ns of CPU/segment" if "segments" in each else ""
        error = f", error {each['error']:.1e}" if "error" in each else ""
        size = f"{each['bytes'] / count:.0f} bytes/tetrahedron"
        print(f"{name:7}{count:8d} {kind:9} {times}, {more}{error}, {size}", flush=True)
    return {"scene": name, "tetrahedra": count, "load": os.getloadavg()[0], **found}


def main() -> None:
    """Run the benchmark."""
    asked = options(
        __doc__,
        python=PEER_PYTHON,
        only={"nargs": "*", "default": list(SCENES), "choices": list(SCENES)},
        width=512,
        small={"type": int, "default": 32, "help": "width of the pictures whose errors are told; 0: none"},
        most={"type": int, "default": 1_000_000, "help": "tetrahedra of slow mappers and of the reference"},
        frames=5,
        rounds=2,
        draw={"nargs": 4, "help": argparse.SUPPRESS},
    )
    if asked.draw:
        path, width, frames, out = asked.draw
        print(json.dumps(draw(path, int(width), int(frames), out)))
        return
    write(asked, rows=[report_on(name, asked) for name in asked.only])


if __name__ == "__main__":
    main()
