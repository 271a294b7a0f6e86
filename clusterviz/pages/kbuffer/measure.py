"""Survey of k-buffers over views from all sides: entries that pixels need, wrong pixels, comparisons and time.

References
----------
As in `analysis.py`; 14 views as in section 5.2 of the first.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import LoopbackChannel
from clusterviz.content.grid.kind import GRID
from clusterviz.content.grid.section import Entries, KBuffer
from clusterviz.content.table import first_of
from clusterviz.data import read_grid
from clusterviz.data.faces import find_neighbours
from clusterviz.data.tetrahedra import make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.frame import FrameLoop, Options
from clusterviz.gl.devices import Device
from clusterviz.pages.kbuffer.analysis import KBufferNeeds, analyse, comparisons
from clusterviz.plan.domain import world_from_file
from clusterviz.report.counts import KBufferCounts, all_counts
from clusterviz.scene.camera import fitted_camera, point_along
from clusterviz.scene.values import Camera, Scene

DRAWN = (2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Entries of the buffers that draw."""
AXES = [tuple(row) for row in np.concatenate([np.eye(3), -np.eye(3)]).astype(int).tolist()]
DIRECTIONS = [*AXES, *product((1, -1), repeat=3)]
"""From the centre to the eye."""
ENTRIES: tuple[Entries, ...] = get_args(Entries)
TABLE = KBuffer(k=12, integration="table")


@dataclass(frozen=True, eq=False)
class View:
    """A view: its name, such as +x or +x-y+z, and what its pixels need."""

    name: str
    camera: Camera
    needs: KBufferNeeds


@dataclass(frozen=True)
class Drawing:
    """A way to draw all views."""

    k: int  # entries; 0: exact
    entries: str  # sorted or unsorted; "" of exact
    integration: str
    cpu_seconds: float  # CPU time of drawing, all threads, mean of the views
    seconds: float  # time of drawing, mean of the views
    counts: KBufferCounts | None = None  # of all views; None of exact
    by_formula: int = 0  # comparisons that the formula gives for the fragments that were drawn
    differing: int = 0  # pixels of all views that differ from exact by more than `DIFFERS`
    largest: float = 0.0  # difference of a pixel from exact


DIFFERS = 1e-3


@dataclass(frozen=True, eq=False)
class Report:
    """Contents of the page."""

    scene: Scene  # completed
    picture: NDArray[np.float32]  # float32 (h, w, 4), premultiplied, exact, of the first view
    renderer: str
    tetrahedra: int
    faces: int
    boundary: int
    views: tuple[View, ...]  # 14
    drawings: tuple[Drawing, ...]

    @property
    def wrong(self) -> dict[int, int]:
        """Wrong pixels of all views by k, from 2 to the first without any, or 32."""
        needed = np.concatenate([view.needs.needed.ravel() for view in self.views])
        last = min(32, max(2, int(needed.max())))
        return {k: int((needed > k).sum()) for k in range(2, last + 1)}


def measure(
    scene: Scene,
    device: Device = None,
    step: Callable[[str], None] = lambda name: None,
    given: UnstructuredGrid | None = None,
) -> Report:
    """Analyse and draw the grid of a scene that holds nothing else.

    `step`: called with the name of what is done next, as in `steps`. `given`: replaces the grid's file.
    """
    step("read")
    section = first_of(GRID, scene).model_copy(update={"visibility": "exact"})
    grid = given or read_grid(section.path, section.time)
    cells = make_tetrahedra(grid, section.array)
    matrix = world_from_file(section)[:3]
    points = cells.points.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
    faces = find_neighbours(cells.corners, len(points)).faces()
    size = scene.image.size
    scene = scene.model_copy(update={"grids": (section,)})
    views = list[View]()
    with (
        warnings.catch_warnings(),
        FrameLoop(scene, LoopbackChannel(), [grid], Options(device, keep_drawn=True, overlap=False)) as loop,
    ):
        warnings.filterwarnings("ignore", r"grids\[0\].visibility")
        scene = loop.scene
        step("analyse")
        for direction in DIRECTIONS:
            name = "".join(f"{'-+'[side > 0]}{axis}" for side, axis in zip(direction, "xyz", strict=True) if side)
            camera = _camera(scene, direction, points)
            views.append(View(name, camera, analyse(points, faces.corners, camera, size)))
        step("exact")
        drawings, exact = _draw(loop, scene, views, None, [])
        found = [drawings]
        for buffer in _buffers():
            step(_name(buffer))
            found.append(_draw(loop, scene, views, buffer, exact)[0])
        renderer = loop.frame(_seen(scene, views[0], None)).statistics.renderer
    boundary = int(faces.is_boundary.sum())
    return Report(
        scene, exact[0], renderer, len(cells.corners), len(faces.corners), boundary, tuple(views), tuple(found)
    )


def steps() -> list[str]:
    """Return the names of what `measure` does."""
    return ["read", "analyse", "exact", *map(_name, _buffers())]


def _buffers() -> list[KBuffer]:
    return [*(KBuffer(k=k, entries=entries) for k, entries in product(DRAWN, ENTRIES)), TABLE]


def _name(buffer: KBuffer) -> str:
    return f"k = {buffer.k}, {buffer.entries}" + ", table" * (buffer.integration == "table")


def _camera(scene: Scene, direction: tuple[int, ...], points: NDArray[np.float64]) -> Camera:
    """Return a camera that sees the sphere around a grid from a direction; its angle is the scene's."""
    x, y, z = map(float, direction)
    up = (0.0, 1.0, 0.0) if x == y == 0 else (0.0, 0.0, 1.0)
    corners = np.stack([points.min(axis=0), points.max(axis=0)])
    centre = tuple(corners.mean(axis=0).tolist())
    eye = point_along(centre, (x, y, z), 1.0)
    camera = Camera(position=eye, focal_point=centre, view_up=up, view_angle=scene.camera.view_angle, fit="orbit")
    if scene.camera.parallel_scale is not None:
        camera = camera.model_copy(update={"parallel_scale": 1.0})
    box = np.array(list(product(*corners.T)))
    return fitted_camera(camera, box, float(np.ptp(corners)), scene.image.size)


def _seen(scene: Scene, view: View, buffer: KBuffer | None) -> Scene:
    section = first_of(GRID, scene).model_copy(update={"visibility": buffer or "exact"})
    return scene.model_copy(update={"camera": view.camera, "grids": (section,)})


def _draw(
    loop: FrameLoop, scene: Scene, views: list[View], buffer: KBuffer | None, exact: list[NDArray[np.float32]]
) -> tuple[Drawing, list[NDArray[np.float32]]]:
    """Draw all views; return also their pictures."""
    loop.frame(_seen(scene, views[0], buffer))  # compiles
    rendered = [loop.frame(_seen(scene, view, buffer)) for view in views]
    ranks = [each.statistics.per_rank[0] for each in rendered]
    pictures = [np.asarray(each.image, np.float32) for each in rendered]
    cpu, seconds = (
        float(np.mean(each)) for each in zip(*((one.cpu_seconds, one.seconds["render"]) for one in ranks), strict=True)
    )
    found = Drawing(*((buffer.k, buffer.entries, buffer.integration) if buffer else (0, "", "exact")), cpu, seconds)
    if buffer is None:
        return found, pictures
    lists = [own.astype(np.int64) for one in rendered if one.drawn for own in one.drawn.fragments]
    formula = sum(int(comparisons(own, buffer.k, buffer.entries == "sorted").sum()) for own in lists)
    apart = [np.abs(own - right).max(axis=2) for own, right in zip(pictures, exact, strict=True)]
    differing, largest = sum(int((one > DIFFERS).sum()) for one in apart), max(float(one.max()) for one in apart)
    counts = all_counts(one.kbuffer for one in ranks)
    return replace(found, counts=counts, by_formula=formula, differing=differing, largest=largest), pictures
