"""Time and error of meshes with a volume against VTK's dual depth peeling.

    python benchmarks/vtk_peeling_ratio.py --python PYTHON_WITH_VTK [--only NAME]… [--width 512] [--json F]

Runs of `vtk_peer.py`, which draws with VTK, and of `clusterviz bench raycast` alternate, on the same meshes, volume,
camera and step. Errors are those of both pictures at a smaller size from the float64 reference, which meets every
triangle exactly. VTK places its samples elsewhere, so its error is that from the reference at an eighth of the step,
too, if that is smaller.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from measuring import CLUSTERVIZ, PEER_PYTHON, Row, opened, options, output_of, sample, write
from vtk_raycast_ratio import peer, synthetic

from clusterviz.comm import LoopbackChannel
from clusterviz.data import read_geometry
from clusterviz.data.geometry import Mesh
from clusterviz.data.source import Grid
from clusterviz.frame import render_frame
from clusterviz.reference import render_reference
from clusterviz.scene import Scene, load_scene

Arrays = dict[str, Any]
VIEW = {"focal_point": [0, 0, 0], "view_up": [0, 0, 1], "view_angle": 30.0}
RAMP: Arrays = {
    "value": [0, 60, 120, 255],
    "opacity": [0, 0, 0.05, 0.3],
    "rgb": [[0.1, 0.2, 0.6], [0.3, 0.36, 0.55], [0.52, 0.53, 0.5], [1, 0.9, 0.4]],
    "unit": 1.0,
}
Triangles = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]


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


def nested(opacity: float, volume: bool) -> Arrays:
    """Two spheres of 1.2 million triangles, in a ball of waves of 256³ voxels."""
    found: Arrays = {"position": [300, -400, 250], **VIEW}
    for number, (radius, rgb) in enumerate(((100, (1, 0.8, 0.6)), (90, (0.4, 0.8, 1)))):
        found |= _mesh(number, sphere(radius, 388), (*rgb, opacity))
    spacing = 220 / 255
    if volume:
        found |= RAMP | {"voxels": synthetic(256), "spacing": [spacing] * 3, "origin": [-110] * 3, "step": spacing}
    return found


def cortex() -> Arrays:
    """The cortex of both hemispheres in a head MRI."""
    found: Arrays = {"position": [330, 290, 200], **VIEW, "focal_point": [0, -18, 4]}
    for number, name in enumerate(("pial-left", "pial-right")):
        mesh = read_geometry(sample(name=name)).mesh
        found |= _mesh(number, (mesh.vertices, mesh.triangles), (0.9, 0.6, 0.5, 0.4))
    head, voxels = opened(sample())
    grid = head.grid
    return found | RAMP | {"voxels": voxels, "spacing": grid.spacing, "origin": grid.origin, "step": min(grid.spacing)}


def screens(count: int = 64) -> Arrays:
    """Squares that fill the picture, one behind the other."""
    found: Arrays = {"position": [0, -400, 0], **VIEW}
    for number in range(count):
        x, y = 200.0, number - count / 2
        corners = np.array([[-x, y, -x], [x, y, -x], [x, y, x], [-x, y, x]], np.float32)
        rgb = np.sin(number * np.array([0.7, 1.1, 1.7])) / 2 + 0.5
        found |= _mesh(number, (corners, np.array([[0, 1, 2], [0, 2, 3]])), (*rgb.tolist(), 0.1))
    return found


def _mesh(number: int, mesh: Triangles, rgba: tuple[float, ...]) -> Arrays:
    return {f"vertices_{number}": mesh[0], f"triangles_{number}": mesh[1], f"rgba_{number}": rgba}


SCENES: dict[str, Callable[[], Arrays]] = {
    "nested": lambda: nested(0.4, True),
    "meshes": lambda: nested(0.4, False),
    "opaque": lambda: nested(1.0, False),
    "cortex": cortex,
    "screens": screens,
}


def write_scene(given: Arrays, folder: Path, width: int) -> Path:
    """Write the scene, its meshes and its volume; return the path."""
    meshes, volumes, number = [], [], 0
    while f"vertices_{number}" in given:
        path, (*rgb, alpha) = folder / f"mesh_{number}.ply", given[f"rgba_{number}"]
        write_ply(path, given[f"vertices_{number}"], given[f"triangles_{number}"])
        meshes.append({"path": str(path), "color": rgb, "opacity": alpha, "shade": False})
        number += 1
    if "voxels" in given:
        np.save(folder / "voxels.npy", given["voxels"])
        colours = [[value, *rgb] for value, rgb in zip(given["value"], given["rgb"], strict=True)]
        points = list(zip(given["value"], given["opacity"], strict=True))
        volumes.append(
            {"path": str(folder / "voxels.npy"), "spacing": list(given["spacing"]), "origin": list(given["origin"])}
            | {"cmap": colours, "clim": [0, 255], "opacity": points, "opacity_unit_distance": given["unit"]}
        )
    camera = {name: given[name] for name in ("position", *VIEW)}
    scene = {"volumes": volumes, "meshes": meshes, "camera": camera}
    scene |= {"image": {"size": [width, width], "background": "black"}}
    (path := folder / "scene.json").write_text(json.dumps(scene, default=lambda array: np.asarray(array).tolist()))
    return path


def write_ply(path: Path, vertices: np.ndarray[Any, Any], triangles: np.ndarray[Any, Any]) -> None:
    """Write a binary PLY file."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    path.write_bytes(header.encode() + np.asarray(vertices, "<f4").tobytes() + faces.tobytes())


def errors(given: Arrays, folder: Path, asked: argparse.Namespace) -> dict[str, float]:
    """Largest error of both pictures from the reference, at a small size."""
    rendered = render_frame(load_scene(write_scene(given, folder, asked.small)), LoopbackChannel())
    peer(asked.python, folder / "scene.npz", "gpu", (asked.small, asked.small), 1, folder / "peer.npy")
    theirs, ours = np.load(folder / "peer.npy"), np.asarray(rendered.image)[..., :3]
    exact, fine = (reference(rendered.scene, given, step) for step in (1.0, 0.125))
    far = [np.abs(theirs - each).max(axis=2) for each in (exact, fine)]
    return {
        "ours": float(np.abs(ours - exact).max()),
        "vtk": min(float(each.max()) for each in far),
        "vtk_rms": min(float(np.sqrt((each**2).mean())) for each in far),
    }


def reference(scene: Scene, given: Arrays, step: float) -> np.ndarray[Any, Any]:
    """Return the float64 picture (h, w, 3), over black."""
    geometry = [
        (section, Mesh(section.path, np.asarray(given[f"vertices_{n}"]), np.asarray(given[f"triangles_{n}"])))
        for n, section in enumerate(scene.meshes)
    ]
    grids, voxels = [], []
    if "voxels" in given:
        voxels.append(given["voxels"])
        grids.append(Grid(voxels[0].shape, tuple(given["spacing"]), tuple(given["origin"])))
    found: np.ndarray[Any, Any] = render_reference(scene, grids, voxels, step, geometry=geometry)[..., :3]
    return found


def report_on(name: str, asked: argparse.Namespace) -> Row:
    """Measure one scene and print a line."""
    given, rounds, size = SCENES[name](), [], (asked.width, asked.width)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        np.savez(folder / "scene.npz", **given)
        found = {"scene": name, **errors(given, folder, asked)} if asked.small else {"scene": name}
        path = write_scene(given, folder, asked.width)
        for _ in range(asked.rounds):
            theirs = peer(asked.python, folder / "scene.npz", "gpu", size, asked.frames, folder / "peer.npy")
            report = folder / "report.json"
            output_of([*CLUSTERVIZ, "bench", "raycast", path, "--frames", asked.frames, "--json", report])
            rounds.append((theirs["median_s"], json.loads(report.read_text())["median_s"]))
    peer_s, own_s = (statistics.median(each) for each in zip(*rounds, strict=True))
    ratios = [theirs / own for theirs, own in rounds]
    found |= {"peer_s": peer_s, "median_s": own_s, "times_faster": ratios, "load": os.getloadavg()[0]}
    told = "".join(f", {key} {found[key]:.1e}" for key in ("ours", "vtk", "vtk_rms") if key in found)
    faster = statistics.median(ratios)
    print(f"{name:8} VTK {1e3 * peer_s:.0f} ms, ours {1e3 * own_s:.0f} ms, {faster:.2f} times faster{told}", flush=True)
    return found


def main() -> None:
    """Run the benchmark."""
    asked = options(
        __doc__,
        python=PEER_PYTHON,
        only={"nargs": "*", "default": list(SCENES), "choices": list(SCENES)},
        width=512,
        small={"type": int, "default": 96, "help": "width of the pictures whose errors are told; 0: none"},
        frames=5,
        rounds=3,
    )
    write(asked, rows=[report_on(name, asked) for name in asked.only])


if __name__ == "__main__":
    main()
