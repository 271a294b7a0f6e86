"""Fill and resolve schemes of the A-buffer: `python benchmarks/abuffer_schemes.py [--size N] [--rounds K] [--gl]`.

All sixteen combinations draw each scene in turn, K times, on one rank with bricks in memory. Of each the least CPU time
of all threads is printed: of the passes that store fragments, without the lists of tiles, and of drawing, which brings
fragments in order and composites them with the volumes; with OpenGL both together. Memory is that of stored
fragments. Static arrays are in the store itself for the fills "fixed" and "dynamic", and private for the others.

protein-like : two electron densities, a tube of 3,000 segments and 2,000 spheres
medical-like : a head CT, meshes of its bone and skin, 680,008 triangles
flow-like : 300 streamlines of 60 segments and 500 spheres in the same CT
worst case : 64 layers that fill the picture, in random order
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from time import process_time
from typing import Any, get_args

import numpy as np
from measuring import Row, context_of, opened, options, prepared, sample, show, timed, whole_pieces, write

from clusterviz.comm.placement import kernel_threads
from clusterviz.content.geometry.section import LinesSection, MeshSection, PointsSection
from clusterviz.data import read_geometry
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.fills import bytes_of, room_for
from clusterviz.render.abuffer.program import FindVariant
from clusterviz.render.caster import Caster
from clusterviz.render.cpu.arrays import Code, CpuArrays
from clusterviz.render.cpu.device import Cpu
from clusterviz.render.opengl import opengl_caster
from clusterviz.scene.values import Camera, Fill, ImageSettings, Resolve, Scene, Volume

FILLS, RESOLVES = get_args(Fill)[1:], get_args(Resolve)[1:]
SCHEMES = tuple(product(FILLS, RESOLVES))
FLIPPED = ((1, 0, 0, 0), (0, -1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
CT = {"clim": (0, 1200), "opacity": ((150, 0.0), (1200, 0.1)), "cmap": "bone"}
Parts = list[tuple[Any, Any]]


def walk(count: int, steps: int, begin: float, step: float, seed: int = 1) -> Lines:
    """Smooth random paths in the box [0, 1]³ that begin near its centre."""
    random = np.random.default_rng(seed)
    ways = np.cumsum(random.normal(0, 1, (count, steps, 3)), axis=1)
    ways /= np.linalg.norm(ways, axis=2, keepdims=True) + 1e-9
    points = random.normal(0.5, begin, (count, 1, 3)) + np.cumsum(step * ways, axis=1)
    folded = np.abs((points + 1) % 2 - 1)
    return Lines("l", folded.reshape(-1, 3).astype(np.float32), np.arange(count + 1) * steps)


def scaled(one: Any, sides: Any) -> Any:
    """Points or lines in a box of other sides."""
    name = "positions" if isinstance(one, Points) else "points"
    return replace(one, **{name: getattr(one, name) * np.array(sides, np.float32)})


def balls(count: int, radius: float, sides: Any) -> Points:
    """Spheres anywhere in a box."""
    places = np.random.default_rng(2).random((count, 3)) * sides
    return Points("p", places.astype(np.float32), {"radius": np.full(count, radius)})


def protein() -> Parts:
    """Two electron densities in one box, a tube and spheres."""
    found: Parts = []
    for name, colour, clim in (("ispg", "viridis", (0.1, 1.5)), ("1jzv", "magma", (0.5, 4.0))):
        _, voxels = opened(sample(name=name))
        spacing = tuple(100 / (n - 1) for n in voxels.shape[::-1])
        look = {"cmap": colour, "clim": clim, "opacity": ((clim[0], 0.0), (clim[1], 0.1)), "opacity_unit_distance": 2.0}
        found.append((Volume(path=name, **look), ArraySource(voxels, Grid(voxels.shape, spacing))))
    found.append((LinesSection(path="l", radius=0.7, opacity=0.5), scaled(walk(1, 3001, 0.1, 0.03), [100] * 3)))
    found.append((PointsSection(path="p", opacity=0.4, color="tomato"), balls(2000, 1.5, [100] * 3)))
    return found


def head() -> tuple[Any, Any]:
    """A head CT."""
    path = sample(name="cranium")
    return Volume(path=path, opacity_unit_distance=5.0, **CT), opened(path)[0]


def medical() -> Parts:
    """A head CT with its bone and skin."""
    found: Parts = [head()]
    for name, colour in (("cranium-bone", "ivory"), ("cranium-skin", "peachpuff")):
        path = sample(name=name)
        look = MeshSection(path=path, opacity=0.3, color=colour, transform=FLIPPED)
        found.append((look, read_geometry(path).mesh))
    return found


def flow() -> Parts:
    """Streamlines and spheres in a head CT."""
    sides = [244.0, 244.0, 160.5]
    lines = LinesSection(path="l", radius=0.8, opacity=0.4, color_by="direction")
    spheres = PointsSection(path="p", opacity=0.5, color="gold")
    return [head(), (lines, scaled(walk(300, 61, 0.15, 0.012), sides)), (spheres, balls(500, 3.0, sides))]


def worst() -> Parts:
    """Layers that fill the picture, in random order."""
    found: Parts = []
    for depth in np.random.default_rng(3).permutation(np.linspace(2, 8, 64)):
        corners = np.array([[-10, -10, depth], [20, -10, depth], [20, 20, depth], [-10, 20, depth]], np.float32)
        look = MeshSection(path="m", opacity=0.05, color=(depth / 8, 0.5, 1 - depth / 8), shade=False)
        found.append((look, Mesh("m", corners, np.array([[0, 1, 2], [0, 2, 3]]))))
    return found


SCENES = {"protein-like": protein, "medical-like": medical, "flow-like": flow, "worst case": worst}
ABOVE = {"camera": Camera(position=(5, 5, -20), focal_point=(5, 5, 0), view_up=(0, 1, 0), parallel_scale=4.0)}


def planned(name: str, size: int) -> tuple[Plan, dict[Any, Any]]:
    """The plan of a scene, and its bricks."""
    keys: dict[str, list[Any]] = {"volumes": [], "meshes": [], "lines": [], "points": []}
    given, kinds = [], {Volume: "volumes", MeshSection: "meshes", LinesSection: "lines", PointsSection: "points"}
    for look, one in SCENES[name]():
        kind = kinds[type(look)]
        keys[kind].append(look)
        given.append(one if kind == "volumes" else Geometry(**{"mesh" if kind == "meshes" else kind: one}))
    settings = ABOVE if name == "worst case" else {}
    image = ImageSettings(size=(size, size))
    return prepared(Scene(image=image, **settings, **{key: tuple(own) for key, own in keys.items()}), given)


class TimedArrays(CpuArrays):
    """Arrays of a CPU that measure its time in passes that find fragments, and in drawing."""

    passes = drawing = 0.0

    def call(self, program: Code, *given: Any) -> None:
        begin = process_time()
        super().call(program, *given)
        if isinstance(program.variant, FindVariant):
            self.passes += process_time() - begin
        else:
            self.drawing += process_time() - begin


def measured(name: str, asked: Any) -> Iterator[Row]:
    """Time all combinations, in turn; their pictures are equal."""
    plan, bricks = planned(name, asked.size)
    device, times = Cpu(), TimedArrays(kernel_threads())
    device.arrays = times
    caster = opengl_caster(context_of(), plan) if asked.gl else Caster(device, plan)
    caster.load(plan, bricks)
    least: dict[tuple[str, str], tuple[float, float]] = dict.fromkeys(SCHEMES, (np.inf, np.inf))
    picture, counts = None, np.zeros(0, np.int64)
    for _, (fill, resolve) in product(range(asked.rounds + 1), SCHEMES):
        chosen = replace(plan, content=replace(plan.content, fill=fill, resolve=resolve))
        if not caster.can_draw(chosen):
            caster.compile(chosen)
        caster.draw(chosen, whole_pieces(chosen))  # compiles what is left
        times.passes = times.drawing = 0.0
        run = timed(lambda chosen=chosen: caster.draw(chosen, whole_pieces(chosen))[0])
        seconds = (run.cpu, 0.0) if asked.gl else (times.passes, times.drawing)
        least[fill, resolve] = tuple(map(min, least[fill, resolve], seconds))  # type: ignore[assignment]
        picture = run.value.partial.rgba if picture is None else picture
        assert np.array_equal(run.value.partial.rgba, picture), (name, fill, resolve)
        counts = run.value.fragments
    for (fill, resolve), (passes, drawing) in least.items():
        base, each = bytes_of(fill, counts.size)
        row = {"scene": name, "fill": fill, "resolve": resolve, "passes": passes, "drawing": drawing}
        row |= {"bytes": (base + each * room_for(fill, counts.ravel())) / 2**20, "fragments": int(counts.sum())}
        yield row | {"most": int(counts.max()), "covered": int((counts > 0).sum())}


def main() -> None:
    """Print the tables."""
    gl = {"action": "store_true", "help": "OpenGL, whose first time is of all; default: the CPU ray caster"}
    only = {"choices": SCENES, "action": "append"}
    asked = options(__doc__, size=384, rounds=4, gl=gl, only=only)
    head = "scene | fragments | at most | pixels | fill | resolve | passes, ms | drawing, ms | MiB"
    cells = "{scene} | {fragments:,} | {most} | {covered:,} | {fill} | {resolve} | {passes!m:.0f} | {drawing!m:.0f} | "
    rows = (row for name in asked.only or SCENES for row in measured(name, asked))
    write(asked, rows=show(head, cells + "{bytes:.1f}", rows))


if __name__ == "__main__":
    main()
