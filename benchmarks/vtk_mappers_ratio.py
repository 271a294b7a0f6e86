"""Time, error and memory of meshes with volumes, and of unstructured grids, against VTK's mappers.

    python benchmarks/vtk_mappers_ratio.py --python PYTHON_WITH_VTK [--only NAME …] [--width 512] [--json F]

Rounds of `vtk_peer.py`, which draws with VTK, and of this program alternate on the same arrays, camera and step, each
in a process of its own. A frame is whole, from the camera to the picture in memory. VTK peels translucent meshes; its
ray cast and ZSweep of grids take seconds, so they draw one frame, in the first round, and none of more than `--most`
tetrahedra. Times are medians, and CPU times minima, of the frames behind the first one. Errors are those of pictures
of `--small` pixels a side from the float64 reference; VTK places samples of volumes elsewhere, so its error is that
from the reference at an eighth of the step, too, if that is smaller. Bytes are what a process takes for drawing beyond
the given arrays, its libraries and windows with it.
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
from measuring import (
    PEER_PYTHON,
    Row,
    answer_of,
    beside,
    loaded,
    opened,
    options,
    picked,
    picture_of,
    prepared,
    sample,
    show,
    timed,
    whole_pieces,
    write,
)

from clusterviz.comm import LoopbackChannel
from clusterviz.content.grid.section import GridSection
from clusterviz.data import read_geometry, read_grid
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.data.memory import ArraySource
from clusterviz.data.samples import SAMPLES, Sample
from clusterviz.data.source import Grid
from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.frame import render_frame
from clusterviz.reference import render_reference
from clusterviz.reference.cells import place_cells
from clusterviz.scene import Scene

Arrays = dict[str, Any]
Triangles = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]
VIEW = {"focal_point": [0, 0, 0], "view_up": [0, 0, 1], "view_angle": 30.0}
RAMP: Arrays = {
    "value": [0, 60, 120, 255],
    "opacity": [0, 0, 0.05, 0.3],
    "rgb": [[0.1, 0.2, 0.6], [0.3, 0.36, 0.55], [0.52, 0.53, 0.5], [1, 0.9, 0.4]],
    "unit": 1.0,
}
THIN, OPAQUE = (0.0, 0.1, 0.4), (0.0, 0.999, 0.999)  # opacity at the 1st and 99th percentile, and between them
SLOW = ("raycast", "zsweep")
HYPER = "usr/share/dx/samples/data/hyper.dx", "83b902ffbc3231bf3eaf0d786f3396264512676626185cab8a8edd72ba43259e"
# A format of its own, so that it is of use here alone.
SAMPLES["hyper"] = Sample("dxsamples", "deb", "IPL-1.0", *HYPER, "flow around a wing", "hyper.dx")


def peer(python: str, scene: Path, kind: str, size: tuple[int, int], frames: int, out: Path, *more: str) -> Row:
    return answer_of([python, beside("vtk_peer.py"), scene, kind, f"{size[0]}x{size[1]}", frames, out, *more])


def synthetic(size: int) -> Any:
    """uint8 (size, size, size): a ball of waves, about half of it visible."""
    axis, found = np.linspace(-1, 1, size, dtype=np.float32), np.empty((size,) * 3, np.uint8)
    y, x = axis[:, None], axis[None, :]
    for slice_, z in zip(found, axis, strict=True):
        r = np.sqrt(x * x + y * y + z * z)
        field = (0.55 + 0.45 * np.cos(9 * np.pi * r) * np.cos(5 * x) * np.cos(4 * y - z)) * np.exp(-((r / 0.9) ** 4))
        slice_[:] = np.rint(255 * field)
    return found


def sphere(radius: float, rings: int) -> Triangles:
    """Vertices and 4 · rings² triangles, those at the poles without area."""
    polar, around = np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)
    t, p = np.meshgrid(polar, around, indexing="ij")
    vertices = radius * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    ring, at = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    a, b = ring * 2 * rings + at, ring * 2 * rings + (at + 1) % (2 * rings)
    c, d = a + 2 * rings, b + 2 * rings
    triangles = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((a, c, b), (b, c, d))])
    return vertices.reshape(-1, 3).astype(np.float32), triangles


def with_meshes(position: list[float], *meshes: tuple[Triangles, tuple[float, ...]], **more: Any) -> Arrays:
    """Arrays of meshes with their colours and opacities, and of what else there is."""
    found = {"position": position, **VIEW, **more}
    for number, ((vertices, triangles), rgba) in enumerate(meshes):
        found |= {f"vertices_{number}": vertices, f"triangles_{number}": triangles, f"rgba_{number}": rgba}
    return found


def nested(opacity: float, volume: bool) -> Arrays:
    """Two spheres of 1.2 million triangles, in a ball of waves of 256³ voxels."""
    spacing = 220 / 255
    waves = (
        {"voxels": synthetic(256), "spacing": [spacing] * 3, "origin": [-110] * 3, "step": spacing} if volume else {}
    )
    shells = ((100, (1, 0.8, 0.6)), (90, (0.4, 0.8, 1)))
    meshes = [(sphere(radius, 388), (*rgb, opacity)) for radius, rgb in shells]
    return with_meshes([300, -400, 250], *meshes, **RAMP if volume else {}, **waves)


def cortex() -> Arrays:
    """The cortex of both hemispheres in a head MRI."""
    head, voxels = opened(sample())
    grid = head.grid
    sides = [read_geometry(sample(name=name)).mesh for name in ("pial-left", "pial-right")]
    meshes = [((one.vertices, one.triangles), (0.9, 0.6, 0.5, 0.4)) for one in sides]
    volume = {"voxels": voxels, "spacing": grid.spacing, "origin": grid.origin, "step": min(grid.spacing)}
    return with_meshes([330, 290, 200], *meshes, **RAMP, **volume) | {"focal_point": [0, -18, 4]}


def screens(count: int = 64) -> Arrays:
    """Squares that fill the picture, one behind the other."""
    meshes = []
    for number in range(count):
        x, y = 200.0, number - count / 2
        corners = np.array([[-x, y, -x], [x, y, -x], [x, y, x], [-x, y, x]], np.float32)
        rgb = np.sin(number * np.array([0.7, 1.1, 1.7])) / 2 + 0.5
        meshes.append(((corners, np.array([[0, 1, 2], [0, 2, 3]])), (*rgb.tolist(), 0.1)))
    return with_meshes([0, -400, 0], *meshes)


def hyper() -> Tetrahedra:
    """Flow around a wing, 34,295 tetrahedra of OpenDX."""
    data = Path(sample(name="hyper")).read_bytes()
    begin = data.index(b"\nend\n") + 5
    values = np.frombuffer(data, ">f4", 8000, begin).astype(np.float32)
    points = np.frombuffer(data, ">f4", 24000, begin + 32000).reshape(-1, 3).astype(np.float32)
    corners = np.frombuffer(data, ">i4", 4 * 34295, begin + 128000).reshape(-1, 4).astype(np.int64)
    return make_tetrahedra(UnstructuredGrid("hyper", points, {"tetra": corners}, {"f": values}))


def brain(side: int) -> Tetrahedra:
    """Brain MRI, sampled and split in 6 (side − 1)³ tetrahedra."""
    voxels = picked(opened(sample(name="ch2better"))[1], side, side, side).astype(np.float32)
    number = np.arange(voxels.size).reshape(voxels.shape)
    first = number[:-1, :-1, :-1].ravel()
    corners = [number[z, y, x] for z in (0, 1) for y, x in ((0, 0), (0, 1), (1, 1), (1, 0))]
    points = np.stack(np.indices(voxels.shape)[::-1], axis=-1).reshape(-1, 3).astype(np.float32)
    boxes = {"hexahedron": first[:, None] + np.array(corners)}
    return make_tetrahedra(UnstructuredGrid("head", points, boxes, {"f": voxels.ravel()}))


def cells(tetrahedra: Tetrahedra, opacity: tuple[float, ...] = THIN) -> Arrays:
    """Arrays of a grid, a transfer function, and a camera that sees all of it."""
    low, high = np.array(tetrahedra.bounds)
    centre, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    return {
        "points": tetrahedra.points,
        "tetrahedra": tetrahedra.corners,
        "values": tetrahedra.values,
        "value": np.linspace(*np.percentile(tetrahedra.values, [1, 99]), 3),
        "opacity": opacity,
        "rgb": [(0.1, 0.2, 0.6), (0.5, 0.5, 0.5), (1.0, 0.9, 0.4)],
        "unit": diagonal / 50,
        "position": centre + diagonal * np.array([1.2, -1.1, 0.8]),
        **VIEW,
        "focal_point": centre,
    }


SCENES: dict[str, Callable[[], Arrays]] = {
    "nested": lambda: nested(0.4, True),
    "meshes": lambda: nested(0.4, False),
    "opaque meshes": lambda: nested(1.0, False),
    "cortex": cortex,
    "screens": screens,
    "hyper": lambda: cells(hyper()),
    "disk": lambda: cells(make_tetrahedra(read_grid(sample(name="disk-out")), "Temp")),
    "brain": lambda: cells(brain(36)),
    "opaque brain": lambda: cells(brain(36), OPAQUE),
    "large brain": lambda: cells(brain(70)),
}


def scene_of(given: Arrays, width: int) -> tuple[Scene, list[Any]]:
    """The scene of the arrays, and what its sections show."""
    plain = {name: np.asarray(value).tolist() for name, value in given.items() if np.size(value) < 100}
    meshes, sections, shown = [], dict[str, Any](), list[Any]()
    while f"vertices_{len(meshes)}" in given:
        number = len(meshes)
        *rgb, alpha = plain[f"rgba_{number}"]
        shown.append(Geometry(mesh=Mesh("m", given[f"vertices_{number}"], given[f"triangles_{number}"])))
        meshes.append({"path": "m", "color": rgb, "opacity": alpha, "shade": False})
    if "value" in given:
        look = {
            "cmap": [[value, *rgb] for value, rgb in zip(plain["value"], plain["rgb"], strict=True)],
            "opacity": list(zip(plain["value"], plain["opacity"], strict=True)),
            "opacity_unit_distance": plain["unit"],
        }
    if "voxels" in given:
        sections["volumes"] = [{"path": "v", "clim": [0, 255], "shade": bool(given.get("shade")), **look}]
        spacing, origin = (tuple(plain[name]) for name in ("spacing", "origin"))
        shown.insert(0, ArraySource(given["voxels"], Grid(given["voxels"].shape, spacing, origin)))
    if "points" in given:
        tetra, values = {"tetra": given["tetrahedra"].astype(np.int64)}, given["values"]
        clim = float(values.min()), float(values.max())
        sections["grids"] = [GridSection(path="g", clim=clim, **look)]
        sections["quality"] = {"early_termination": 1 / 255 if max(plain["opacity"]) > 0.9 else 0.0}
        shown.append(UnstructuredGrid("g", given["points"], tetra, {"f": values}))
    camera = {name: plain[name] for name in ("position", *VIEW)}
    image = {"size": [width, width], "background": "black"}
    return Scene.model_validate({**sections, "meshes": meshes, "camera": camera, "image": image}), shown


def memory() -> int:
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])


def draw(path: str, width: int, frames: int, out: str) -> Row:
    """Draw the arrays of a file as vtk_peer.py does, and return the same numbers."""
    scene, shown = scene_of(dict(np.load(path)), width)
    before = memory()

    def begin() -> Any:
        plan, bricks = prepared(scene, shown)
        caster = loaded(plan, bricks, "cpu")
        return caster, plan, caster.draw(plan, whole_pieces(plan))

    first = timed(begin)
    caster, plan, drawn = first.value
    runs = [timed(lambda: caster.draw(plan, whole_pieces(plan))) for _ in range(frames)] or [first]
    np.save(out, picture_of((width, width), drawn)[..., :3])
    walls = [run.wall for run in runs]
    later = {"median_s": statistics.median(walls), "min_s": min(walls), "cpu_s": min(run.cpu for run in runs)}
    return later | {"first_s": first.wall, "bytes": memory() - before}


def references(given: Arrays, width: int) -> list[Any]:
    """The float64 pictures (h, w, 3), over black: at the step, and of volumes at an eighth of it."""
    scene, shown = scene_of(given, width)
    volumes = [one for one in shown if isinstance(one, ArraySource)]
    meshes = [one.mesh for one in shown if isinstance(one, Geometry)]
    grids = [one for one in shown if isinstance(one, UnstructuredGrid)]
    scene = render_frame(scene, LoopbackChannel(), shown).scene  # complete
    placed = [place_cells(section, grid) for section, grid in zip(scene.grids, grids, strict=True)]
    geometry = list(zip(scene.meshes, meshes, strict=True))
    voxels, boxes = [given.get("voxels")] * len(volumes), [one.grid for one in volumes]
    steps = (1.0, 0.125) if volumes else (1.0,)
    return [render_reference(scene, boxes, voxels, step, geometry=geometry, cells=placed)[..., :3] for step in steps]


def report_on(name: str, asked: argparse.Namespace) -> list[Row]:
    """Measure one scene: a row for each program."""
    given = SCENES[name]()
    count = len(given.get("tetrahedra", ()))
    peers = ["gpu"] if not count else ["projected", *(SLOW if count <= asked.most else ())]
    with tempfile.TemporaryDirectory() as temporary:
        path, picture = Path(temporary) / "scene.npz", Path(temporary) / "picture.npy"
        np.savez(path, **given)

        def measure(kind: str, width: int, frames: int) -> Row:
            if kind == "ours":
                return answer_of([sys.executable, __file__, "--draw", path, width, frames, picture])
            return peer(asked.python, path, kind, (width, width), frames, picture)

        rounds: dict[str, list[Row]] = {}
        for number in range(asked.rounds):
            for kind in ("ours", *peers):
                if not number or kind not in SLOW:
                    frames = 0 if kind in SLOW else asked.frames
                    rounds.setdefault(kind, []).append(measure(kind, asked.width, frames))
        exact = references(dict(np.load(path)), asked.small) if asked.small and count <= asked.most else []
        rows = []
        for kind, each in rounds.items():
            row: Row = {"scene": name, "program": kind, "bytes": each[0]["bytes"], "load": os.getloadavg()[0]}
            row |= {"s": statistics.median(one["median_s"] for one in each), "cpu": min(one["cpu_s"] for one in each)}
            if exact:
                measure(kind, asked.small, 0)
                row["error"] = min(float(np.abs(np.load(picture) - one).max()) for one in exact)
            rows.append(row | {"times": row["s"] / (rows or [row])[0]["s"]})
    return rows


def main() -> None:
    asked = options(
        __doc__,
        python=PEER_PYTHON,
        only={"nargs": "*", "default": list(SCENES), "choices": list(SCENES)},
        width=512,
        small={"type": int, "default": 64, "help": "width of the pictures whose errors are told; 0: none"},
        most={"type": int, "default": 1_000_000, "help": "tetrahedra of slow mappers and of the reference"},
        frames=5,
        rounds=3,
        draw={"nargs": 4, "help": argparse.SUPPRESS},
    )
    if asked.draw:
        path, width, frames, out = asked.draw
        print(json.dumps(draw(path, int(width), int(frames), out)))
        return
    head = "scene | program | ms | CPU ms | times ours | largest error | MB"
    shown = "{scene} | {program} | {s!m:.0f} | {cpu!m:.0f} | {times:.2f} | {error:.1e} | {bytes!M:.0f}"
    write(asked, rows=show(head, shown, (row for name in asked.only for row in report_on(name, asked))))


if __name__ == "__main__":
    main()
