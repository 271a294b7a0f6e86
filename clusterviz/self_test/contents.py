"""Small data that the pictures of the self-test show, the same on every machine: integers and sums of products."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.scene.features import Content

SHAPE = (9, 11, 13)
"""Samples (z, y, x): nothing divides the numbers of cells."""
SIZE = (20, 14)
LOOK: dict[str, Any] = {
    "cmap": ((0.0, 1.0, 0.1, 0.0), (0.4, 0.2, 0.9, 0.3), (1.0, 0.0, 0.25, 1.0)),
    "opacity": ((0.0, 0.0), (0.25, 0.02), (0.5, 0.6), (0.7, 0.1), (1.0, 0.3)),
    "clim": (0.0, 1.0),
    "opacity_unit_distance": 4.0,
}
OPTICS = {
    "wavelengths": (450.0, 550.0, 650.0),
    "absorption": ((0.1, 0, 0, 0), (0.5, 0.1, 0.1, 0.02), (1.0, 0.4, 0.2, 0.1)),
    "scattering": ((0.1, 0, 0, 0), (1.0, 1.5, 1.0, 0.5)),
}
CAMERA = {
    "position": (24.0, 17.0, 15.0),
    "focal_point": (6.0, 5.0, 4.0),
    "view_up": (0.0, 0.1, 1.0),
    "view_angle": 36.0,
}
PICTURE = {"size": SIZE, "background": "black", "step": 0.9, "camera": CAMERA}
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
FACES = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
TABLE = Path(__file__).with_name("table.npy")
"""Opacities of three magnitudes and four values."""
BRICKS = {"brick": 6}
"""Of volumes, several; what has no voxels is cut by bricks that are far smaller."""
Given = tuple[list[Any], dict[str, Any]]
"""Sources of volumes, and settings with the rest."""


def field() -> NDArray[np.float32]:
    """Return a smooth field with some noise over [0, 1], float32 (z, y, x)."""
    z, y, x = (axis / (side - 1) for axis, side in zip(np.indices(SHAPE), SHAPE, strict=True))
    waves = 4 * x * (1 - x) * (0.4 + 0.6 * y) + z * (1 - y) * (0.3 + x)
    mixed = (np.arange(waves.size) * 2654435761 % 4096 / 4096).reshape(SHAPE)
    return np.asarray((waves + 0.2 * mixed) / 2.0, np.float32)


def _volume(voxels: NDArray[Any], **more: Any) -> Given:
    return [ArraySource(voxels)], BRICKS | LOOK | more


def _with_invalid() -> NDArray[np.float32]:
    voxels = field()
    voxels.flat[::37] = np.resize([np.nan, np.inf, -np.inf], voxels.flat[::37].size)
    voxels[:3, :4, 8:] = np.nan
    return voxels


def _bytes() -> Given:
    points = {name: [(255 * row[0], *row[1:]) for row in LOOK[name]] for name in ("cmap", "opacity")}
    return _volume(np.rint(255 * field()).astype(np.uint8), **points, clim=(0.0, 255.0))


def _several() -> Given:
    others = {f"volumes.1.{key}": value for key, value in LOOK.items()}
    return [ArraySource(field()), ArraySource(np.ascontiguousarray(field()[::-1, ::-1]))], BRICKS | LOOK | others


def _meshes() -> Given:
    parts = [
        {"path": _shell(radius), "opacity": opacity, "color": color, "specular": 0.4, "ambient": 0.2, "diffuse": 0.7}
        for radius, opacity, color in ((6.0, 0.4, "red"), (4.5, 0.5, "teal"), (3.0, 1.0, "white"))
    ]
    return [], {"meshes": parts}


def _shell(radius: float) -> Geometry:
    corners = (radius * OCTAHEDRON + (6.2, 4.9, 4.4)).astype(np.float32)
    return Geometry(mesh=Mesh("shell", corners, FACES))


def _mixture() -> Given:
    return [ArraySource(field())], BRICKS | LOOK | _meshes()[1]


def _lines() -> Given:
    t = np.linspace(0.0, 1.0, 9)
    path = np.stack([12 * t, 10 * (2 * t - 1) ** 2, 8 * t**2], axis=1).astype(np.float32)
    lines = Geometry(lines=Lines("path", path, np.array([0, len(path)])))
    return [], {"lines": [{"path": lines, "radius": 0.8, "opacity": 0.6, "color": "gold"}]}


def _points() -> Given:
    places = np.array([[x, y, z] for x in (1.0, 6.0, 11.0) for y in (2.0, 8.0) for z in (1.5, 6.5)], np.float32)
    points = Geometry(points=Points("dots", places))
    return [], {"points": [{"path": points, "radius": 1.6, "opacity": 0.7, "color": "orange"}]}


def _grid() -> Given:
    """Return tetrahedra between the corners of 2 × 2 × 2 cubes, six each around a diagonal."""
    number = np.arange(27).reshape(3, 3, 3)
    steps = [(1, 3, 9), (1, 9, 3), (3, 1, 9), (3, 9, 1), (9, 1, 3), (9, 3, 1)]
    begins = number[:2, :2, :2].ravel()
    cells = np.array([[n, n + a, n + a + b, n + a + b + c] for n in begins for a, b, c in steps])
    z, y, x = np.indices((3, 3, 3)).reshape(3, -1)
    points = np.stack([6.0 * x, 5.0 * y + 0.5 * (z == 1), 4.0 * z + 0.3 * x], axis=1)
    scalars = {"f": (x * 7 + y * 5 + z * 3) % 11 / 10}
    look = {key: LOOK[key] for key in ("cmap", "clim", "opacity", "opacity_unit_distance")}
    return [], {"grids": [{"path": UnstructuredGrid("cells", points, {"tetra": cells}, scalars), **look}]}


CONTENTS: dict[Content, Callable[[], Given]] = {
    "volume": lambda: _volume(field()),
    "bytes": _bytes,
    "invalid": lambda: _volume(_with_invalid()),
    "table": lambda: _volume(field(), opacity=None, transfer_2d={"path": str(TABLE)}),
    "optics": lambda: ([ArraySource(field())], BRICKS | {"optics": OPTICS}),
    "volumes": _several,
    "meshes": _meshes,
    "mixture": _mixture,
    "lines": _lines,
    "points": _points,
    "grid": _grid,
}
"""Data of scenes by what a picture shows."""
