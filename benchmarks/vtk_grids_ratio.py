"""Time, error and memory of unstructured grids against VTK's mappers.

    python benchmarks/vtk_grids_ratio.py --python PYTHON_WITH_VTK [--only NAME]… [--width 512] [--small 32] [--json F]

Rounds of `vtk_grids.py`, which draws with VTK, and of this program alternate on the same tetrahedra, camera and
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
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from clusterviz.comm import LoopbackChannel
from clusterviz.content.grid.section import GridSection
from clusterviz.data import open_source, read_grid
from clusterviz.data.samples import SAMPLES, Sample, fetch_sample
from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.frame import Options, Run, prepare
from clusterviz.reference import render_reference
from clusterviz.reference.cells import find_passages, place_cells
from clusterviz.reference.rays import camera_rays
from clusterviz.render.choice import make_caster
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
    data = fetch_sample("hyper").read_bytes()
    begin = data.index(b"\nend\n") + 5
    values = np.frombuffer(data, ">f4", 8000, begin).astype(np.float32)
    points = np.frombuffer(data, ">f4", 24000, begin + 32000).reshape(-1, 3).astype(np.float32)
    corners = np.frombuffer(data, ">i4", 4 * 34295, begin + 128000).reshape(-1, 4).astype(np.int64)
    return make_tetrahedra(UnstructuredGrid("hyper", points, {"tetra": corners}, {"f": values}))


def disk() -> Tetrahedra:
    """Temperature in a reactor, 7,472 hexahedra in 44,832 tetrahedra."""
    return make_tetrahedra(read_grid(str(fetch_sample("disk-out"))), "Temp")


def brain(side: int) -> Tetrahedra:
    """Brain MRI, sampled and split in 6 (side − 1)³ tetrahedra."""
    source = open_source(fetch_sample("ch2better"))
    voxels = np.asarray(source.read((0, 0, 0), source.grid.shape_zyx))
    picked = [np.linspace(0, size - 1, side).round().astype(int) for size in voxels.shape]
    values = voxels[np.ix_(*picked)].astype(np.float32)
    z, y, x = np.indices(values.shape)
    numbers = np.arange(values.size).reshape(values.shape)
    first = numbers[:-1, :-1, :-1].ravel()
    square = first[:, None] + [0, 1, 1 + side, side]
    cells = {"hexahedron": np.concatenate([square, square + side * side], axis=1)}
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    return make_tetrahedra(UnstructuredGrid("brain", points, cells, {"f": values.ravel()}))


SCENES: dict[str, tuple[Callable[[], Tetrahedra], tuple[float, ...]]] = {
    "hyper": (hyper, THIN),
    "disk": (disk, THIN),
    "brain": (lambda: brain(36), THIN),
    "opaque": (lambda: brain(36), OPAQUE),
    "large": (lambda: brain(70), THIN),
}
SLOW = ("raycast", "zsweep")


def arrays_of(tetrahedra: Tetrahedra, opacity: tuple[float, ...]) -> Arrays:
    """Return what vtk_grids.py reads: the grid, a transfer function, and a camera that sees all of it."""
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


def draw(path: str, width: int, out: str, frames: int) -> dict[str, Any]:
    """Draw the arrays of a file as vtk_grids.py does, and return the same numbers."""
    scene, grid = scene_of(dict(np.load(path)), width)
    before = memory()
    begun = perf_counter()
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, [grid])
    assert share.plan, "there are tetrahedra"
    caster = make_caster(share.plan, "cpu")
    caster.load(share.plan, bricks)
    seconds, cpu_seconds, drawn = list[float](), list[float](), []
    for _ in range(frames + 1):
        start, start_cpu = perf_counter(), process_time()
        drawn = caster.draw(share.plan, share.pieces)
        seconds.append(perf_counter() - start)
        cpu_seconds.append(process_time() - start_cpu)
    first = perf_counter() - begun - sum(seconds[1:])
    picture = np.zeros((width, width, 3), np.float32)
    for one in drawn:
        rect = one.partial.rect
        picture[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = one.partial.rgba[..., :3]
    np.save(out, picture)
    return {
        "median_s": statistics.median(seconds[1:] or seconds),
        "min_s": min(seconds[1:] or seconds),
        "cpu_s": min(cpu_seconds[1:] or cpu_seconds),
        "first_s": first,
        "bytes_a_tetrahedron": (memory() - before) / len(grid.cells["tetra"]),
    }


def memory() -> int:
    """Bytes of the process."""
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])


def run(command: list[Any]) -> dict[str, Any]:
    """Return the JSON line that a program prints."""
    printed = subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True).stdout
    found: dict[str, Any] = next(json.loads(line) for line in printed.splitlines() if line.startswith("{"))
    return found


def report_on(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Measure one scene and print a line for each program."""
    make, opacity = SCENES[name]
    given = arrays_of(make(), opacity)
    count = len(given["tetrahedra"])
    peers = [kind for kind in ("projected", *SLOW) if kind not in SLOW or count <= options.most]
    with tempfile.TemporaryDirectory() as temporary:
        path, picture = Path(temporary) / "scene.npz", Path(temporary) / "picture.npy"
        np.savez(path, **given)

        def measure(kind: str, width: int, frames: int) -> dict[str, Any]:
            if kind == "ours":
                return run([sys.executable, __file__, "--draw", path, width, picture, frames])
            return run([options.python, Path(__file__).with_name("vtk_grids.py"), path, kind, width, picture, frames])

        found: dict[str, Any] = {}
        for number in range(options.rounds):
            for kind in ("ours", *peers):
                if number and kind in SLOW:
                    continue
                each = measure(kind, options.width, 0 if kind in SLOW else options.frames)
                known = found.setdefault(kind, each | {"rounds": [], "cpu_rounds": []})
                known["rounds"].append(each["median_s"])
                known["cpu_rounds"].append(each["cpu_s"])
        if options.small and count <= options.most:
            scene, grid = scene_of(dict(np.load(path)), options.small)
            exact = render_reference(scene, [], [], cells=[place_cells(scene.grids[0], grid)])[..., :3]
            rays = camera_rays(scene.camera, scene.image.size)
            passages = len(find_passages(rays, make_tetrahedra(grid)).ray)
            found["ours"]["segments"] = int(passages * (options.width / options.small) ** 2)
            for kind in ("ours", *peers):
                measure(kind, options.small, 0)
                found[kind]["error"] = float(np.abs(np.load(picture) - exact).max())
    for kind, each in found.items():
        seconds, cpu = (each["median_s"], each["cpu_s"]) = statistics.median(each["rounds"]), min(each["cpu_rounds"])
        times = f"{1e3 * seconds:6.0f} ms, {1e3 * cpu:6.0f} ms of CPU, {count / seconds / 1e6:.2f} million tetrahedra/s"
        ours = found["ours"]
        more = f"{seconds / ours['median_s']:.1f} and {cpu / ours['cpu_s']:.1f} times ours"
        if kind == "ours":
            more = f"{1e9 * cpu / each['segments']:.1f} ns of CPU/segment" if "segments" in each else ""
        error = f", error {each['error']:.1e}" if "error" in each else ""
        size = f"{each['bytes_a_tetrahedron']:.0f} bytes/tetrahedron"
        print(f"{name:7}{count:8d} {kind:9} {times}, {more}{error}, {size}", flush=True)
    return {"scene": name, "tetrahedra": count, "load": os.getloadavg()[0], **found}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--python", default=os.environ.get("CLUSTERVIZ_PEER_PYTHON", sys.executable))
    parser.add_argument("--only", nargs="*", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--small", type=int, default=32, help="width of the pictures whose errors are told; 0: none")
    parser.add_argument("--most", type=int, default=1_000_000, help="tetrahedra of slow mappers and of the reference")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--draw", nargs=4, metavar=("SCENE", "WIDTH", "OUT", "FRAMES"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.draw:
        path, width, out, frames = options.draw
        print(json.dumps(draw(path, int(width), out, int(frames))))
        return
    found = [report_on(name, options) for name in options.only]
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
