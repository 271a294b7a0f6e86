"""Primitives of bricks: each fragment's owner holds its primitive, with what colours and lights it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.content.geometry.section import LinesSection, MeshSection, PointsSection, as_sections
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame.opening import Opened, open_content
from clusterviz.frame.run import Options, Run
from clusterviz.reference.fragments import place
from clusterviz.reference.intersections import intersect
from clusterviz.reference.rays import camera_rays
from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Scene, Volume

RNG = np.random.default_rng(15)
TURN = ((0.6, -0.8, 0, 3), (0.8, 0.6, 0, -2), (0, 0, 1.5, 1), (0, 0, 0, 1))
CAMERA = Camera(position=(50, 35, 40), focal_point=(8, 8, 8), view_up=(0, 0, 1))


def mesh(count: int = 60, size: float = 3.0, dtype: Any = np.float32) -> Mesh:
    """Random triangles, of which some are large, thin or shared at a vertex."""
    vertices = RNG.random((count, 3)) * 20 + RNG.normal(size=(count, 3)) * size
    triangles = np.stack([np.arange(count), np.arange(count) - 1, RNG.integers(0, count, count)], axis=1) % count
    named = {"heat": np.arange(count, dtype=np.float64), "RGB": RNG.integers(0, 256, (count, 3)).astype(np.uint8)}
    return Mesh("m", vertices.astype(dtype), triangles, named, {"label": np.arange(count, dtype=np.int16)})


def lines(count: int = 5) -> Lines:
    points = np.cumsum(RNG.normal(size=(8 * count, 3)), axis=0) + 8
    points[9] = points[10]  # without length
    return Lines("l", points, np.arange(count + 1) * 8)


def points(count: int = 40) -> Points:
    return Points("p", RNG.random((count, 3)) * 18, {"radius": RNG.random(count), "size": RNG.random(count)})


def opened(scene: Scene, given: list[Any]) -> tuple[Scene, Opened]:
    completed, found, bricks = open_content(Run(LoopbackChannel(), Options()), scene, given)
    assert found
    assert not bricks
    return completed, found


def scene_of(*sections: Any, volumes: int = 0, brick: int = 4, step: float = 1.0) -> Scene:
    each = [Volume(path="a", clim=(0, 1), opacity=0.5) for _ in range(volumes)]
    quality, cluster, image = Quality(step=step), Cluster(brick=brick), ImageSettings(size=(24, 20))
    return Scene(volumes=each, camera=CAMERA, quality=quality, cluster=cluster, image=image, **as_sections(sections))


@pytest.mark.cover
@pytest.mark.parametrize("volumes", [0, 1, 2])
@pytest.mark.parametrize("step", [0.4, 1.0, 5.0])
def test_the_owner_of_a_fragment_holds_its_primitive(volumes: int, step: float) -> None:
    sections = [
        MeshSection(path="m", transform=TURN),
        MeshSection(path="n"),
        LinesSection(path="l", radius=0.3),
        PointsSection(path="p"),
    ]
    content: list[Any] = [mesh(), mesh(12, 30.0, np.float64), lines(), points()]
    grids = [Grid((9, 10, 11)), Grid((7, 6, 8), (0.7, 1.1, 0.9), (5, -3, 2))][:volumes]
    sources = [ArraySource(np.ones(grid.shape_zyx, np.float32), grid) for grid in grids]
    given = [Geometry(**{kind: part}) for kind, part in zip(("mesh", "mesh", "lines", "points"), content, strict=True)]
    scene, several = opened(scene_of(*sections, volumes=volumes, step=step), [*sources, *given])
    plan = several.plan(scene)
    domain, layout = plan.content.domain, plan.layout
    every = {tuple(index) for index in np.argwhere(plan.cost > 0).tolist()}
    bricks = dict(several.read(plan, every))
    rays, length, owned = camera_rays(scene.camera, scene.image.size), plan.march.step_world, 0
    for number, (section, part) in enumerate(zip(scene.geometry, content, strict=True)):
        placed = place(section, part)
        hits = intersect(rays, placed.primitives)
        assert len(hits.t)
        start, direction = rays.start[hits.ray], rays.direction[hits.ray]
        low = np.array(domain.origin)
        with np.errstate(divide="ignore"):
            ends = np.stack(
                [(low - start) / direction, (low + domain.spacing * np.array(domain.extent) - start) / direction]
            )
        begin = np.maximum(ends.min(axis=0).max(axis=1), 0)
        assert (hits.t > begin).all()
        assert (hits.t < ends.max(axis=0).min(axis=1)).all()
        middle = begin + (np.floor((hits.t - begin) / length) + 0.5) * length
        owner = np.floor((start + middle[:, None] * direction - low) / domain.spacing / layout.brick).astype(int)
        # The last slab may end behind the domain; its middle is then that of what is inside.
        owner = np.clip(owner[:, ::-1], 0, np.array(layout.counts_zyx) - 1)
        for index, primitive in zip(owner.tolist(), hits.primitive.tolist(), strict=True):
            held = bricks[tuple(index)].members[number]
            assert held is not None
            assert (placed.cells[primitive] if isinstance(section, MeshSection) else primitive) in held.numbers
            owned += 1
        layer = plan.content.geometry[number]
        assert layer.count == len(placed.primitives.low)
        assert layer.in_bricks[0].sum() == sum(
            len(brick.members[number].numbers) for brick in bricks.values() if brick.members[number]
        )
    assert owned > 500


def test_ranks_share_the_work_and_find_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices = np.array(mesh(400).vertices)
    vertices[7] = np.nan
    heat = {"heat": np.where(np.arange(400) == 300, np.inf, np.arange(400.0))}
    parts: list[Any] = [Mesh("m", vertices, mesh(400).triangles, heat), lines(), points()]
    given = [Geometry(**{kind: part}) for kind, part in zip(("mesh", "lines", "points"), parts, strict=True)]
    sections = [MeshSection(path="m", scalars="heat", transform=TURN), LinesSection(path="l"), PointsSection(path="p")]
    looked: list[tuple[int, int]] = []
    drawable_in = Mesh.drawable_in
    monkeypatch.setattr(Mesh, "drawable_in", lambda *each: (looked.append(each[1:]), drawable_in(*each))[1])

    def found(channel: Channel) -> tuple[Any, ...]:
        run = Run(channel, Options())
        scene, several, _ = open_content(run, scene_of(*sections), given)
        assert several
        plan = several.plan(scene)
        every = sorted(tuple(index) for index in np.argwhere(plan.cost > 0).tolist())
        first = dict(several.read(plan, set(every[channel.rank :: channel.size])))
        # One rank lacks bricks later.
        last = dict(several.read(plan, set(every[:9]) if channel.rank == channel.size - 1 else set()))
        facts = [tuple(map(repr, vars(info).items())) for info in several.infos]
        return facts, [layer.in_bricks.tolist() for layer in plan.content.geometry], first, last

    def packed(bricks: Any) -> dict[Any, Any]:
        return {i: [part and [a.tobytes() for a in vars(part).values()] for part in one.members] for i, one in bricks}

    (facts, counts, first, last), *_ = run_loopback(1, found)
    assert packed(last.items()).items() <= packed(first.items()).items()
    assert looked == [(0, 400)]
    for ranks in (2, 5):
        looked.clear()
        each = run_loopback(ranks, found)
        assert sorted(looked) == sorted([(400 * r // ranks, 400 * (r + 1) // ranks) for r in range(ranks)])
        assert all(one[:2] == (facts, counts) for one in each)
        assert packed(item for one in each for item in one[2].items()) == packed(first.items())
        assert packed(each[-1][3].items()) == packed(last.items())
