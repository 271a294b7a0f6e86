"""Tetrahedra of bricks: the owner of each sample holds the tetrahedron around it, and costs are expected segments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from data.cells import lattice, mixed, one_cell, tetrahedra

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.content.grid.section import GridSection
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.frame.opening import Opened, open_content
from clusterviz.frame.run import Options, Run
from clusterviz.plan.cells import SEGMENT_COST
from clusterviz.plan.plan import Plan
from clusterviz.reference.rays import camera_rays
from clusterviz.render.abuffer.primitives import make_table
from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Scene, Volume

TURN = ((0.6, -0.8, 0, 3), (0.8, 0.6, 0, -2), (0, 0, -1.5, 1), (0, 0, 0, 1))
GRIDS = [lattice(3, 4, 5), mixed()]
NOTHING = UnstructuredGrid("nothing", np.zeros((0, 3)), {}, {"f": np.zeros(0)})
SECTIONS = [
    GridSection(path="a", transform=TURN, opacity=0.5),
    GridSection(path="b", array="kind", opacity=[[4, 0.2], [8, 0.9]], opacity_unit_distance=0.5),
]


def scene_of(*sections: Any, volumes: int = 0, brick: int = 64, step: float = 1.0) -> Scene:
    each = [Volume(path="a", clim=(0, 1), opacity=0.5) for _ in range(volumes)]
    quality, cluster, image = Quality(step=step), Cluster(brick=brick), ImageSettings(size=(12, 10))
    camera = Camera(position=(14, 11, -9), focal_point=(1, 1, 0), view_up=(0, 0, 1))
    return Scene(volumes=each, camera=camera, quality=quality, cluster=cluster, image=image, grids=sections)


def planned(scene: Scene, given: list[Any], channel: Channel | None = None) -> tuple[Scene, Opened, Plan]:
    scene, opened, _ = open_content(Run(channel or LoopbackChannel(), Options()), scene, given)
    assert opened
    return scene, opened, opened.plan(scene)


def visible(plan: Plan) -> list[tuple[int, ...]]:
    return sorted(tuple(index) for index in np.argwhere(plan.cost > 0).tolist())


@pytest.mark.cover
@pytest.mark.parametrize(("volumes", "brick", "step"), [(0, 64, 1.0), (0, 128, 40.0), (1, 2, 1.0)])
def test_the_owner_of_a_sample_holds_its_tetrahedron(volumes: int, brick: int, step: float) -> None:
    source = ArraySource(np.ones((9, 10, 11), np.float32), Grid((9, 10, 11), (0.4,) * 3, (-1, -2, -3)))
    scene = scene_of(*SECTIONS, volumes=volumes, brick=brick, step=step)
    scene, opened, plan = planned(scene, [source][:volumes] + GRIDS)
    domain, length = plan.content.domain, plan.march.step_world
    bricks = dict(opened.read(plan, set(visible(plan))))
    rays = camera_rays(scene.camera, scene.image.size)
    low, found = np.array(domain.origin), 0
    with np.errstate(divide="ignore"):
        walls = np.stack([low, low + domain.spacing * np.array(domain.extent)])[:, None]
        ends = (walls - rays.start) / rays.direction
    begin, end = np.maximum(ends.min(axis=0).max(axis=1), 0), ends.max(axis=0).min(axis=1)
    for ray in np.flatnonzero(begin < end):
        depths = np.random.default_rng(ray).uniform(begin[ray], end[ray], 40)
        middles = begin[ray] + (np.floor((depths - begin[ray]) / length) + 0.5) * length
        start, direction = rays.start[ray], rays.direction[ray]
        at, middle = (start + depth[:, None] * direction for depth in (depths, middles))
        owners = np.floor((middle - low) / domain.spacing / plan.layout.brick).astype(int)[:, ::-1]
        owners = np.clip(owners, 0, np.array(plan.layout.counts_zyx) - 1)
        for number, (section, grid) in enumerate(zip(SECTIONS, GRIDS, strict=True)):
            cut = opened_tetrahedra(section, grid)
            inside = (np.einsum("tij,pj->pti", cut, np.column_stack([at, np.ones(len(at))])) > 0).all(axis=2)
            for sample, tetrahedron in np.argwhere(inside):
                held = bricks[tuple(owners[sample])].members[number]
                assert held is not None
                assert tetrahedron in held.numbers
                found += 1
    assert found > 100


def opened_tetrahedra(section: GridSection, grid: Any) -> np.ndarray:
    """Barycentric coordinates of each tetrahedron from the world (m, 4, 4)."""
    cut = tetrahedra(grid)
    corners = np.concatenate([cut.points[cut.corners], np.ones((*cut.corners.shape, 1))], axis=2)
    placed = corners @ np.array(section.transform or np.eye(4)).T
    return np.linalg.inv(placed.transpose(0, 2, 1))


def test_costs_are_expected_segments_of_what_is_not_transparent() -> None:
    grid = lattice(3, 4, 5)
    _, opened, plan = planned(scene_of(GridSection(path="a", opacity=0.5), brick=1024), [grid])
    a, b, c, d = (tetrahedra(grid).points[corner] for corner in tetrahedra(grid).corners.T)
    faces = ((a, b, c), (a, b, d), (a, c, d), (b, c, d))
    areas = sum(np.linalg.norm(np.cross(q - p, r - p), axis=1).sum() / 2 for p, q, r in faces)
    expected = SEGMENT_COST * areas / 4 / plan.content.domain.spacing**2
    assert plan.cost.sum() == pytest.approx(expected, rel=1e-9)
    _, opened, plan = planned(scene_of(GridSection(path="a", opacity=0.5)), [grid])
    assert plan.cost.sum() == pytest.approx(expected, rel=0.05)  # shares are those of boxes
    _, opened, plan = planned(scene_of(GridSection(path="a", opacity=0.5), brick=16), [grid])
    everything = plan.cost > 0
    _, opened, plan = planned(scene_of(GridSection(path="a", opacity=[[9, 0], [10, 1]]), brick=16), [grid])
    hidden = everything & (plan.cost == 0)
    assert hidden.any()
    assert (plan.cost > 0).any()
    for index, brick in opened.read(plan, {tuple(each) for each in np.argwhere(everything).tolist()}):
        assert hidden[index] == (brick.members[0].values[brick.members[0].corners].max() <= 9)


@pytest.mark.parametrize("array", ["f", "kind"])
def test_memory_of_a_brick_is_that_of_its_arrays(array: str) -> None:
    _, opened, plan = planned(scene_of(GridSection(path="a", array=array, opacity=0.5), brick=1024), [mixed()])
    ((index, brick),) = opened.read(plan, set(visible(plan)))
    table = make_table(plan.content.layers, [brick.members])
    assert table.cells
    held = brick.members[0].nbytes + table.cells.words.nbytes + 32 * table.vertices
    held += sum(array.nbytes for array in (*table.positions, *table.radii))
    budget = MemoryBudget(1, on_cpu=True, by_opengl=False)
    empty = budget.brick_bytes(replace(plan, content=replace(plan.content, layers=())))
    assert budget.brick_bytes(plan)[index] - empty[index] == held


@pytest.mark.parametrize(("sides", "bricks", "times"), [((2, 3, 4), 3, 5.0), ((15, 20, 20), 8, 2.6)])
def test_bricks_are_as_large_as_a_few_cells(sides: tuple[int, ...], bricks: int, times: float) -> None:
    """But for few cells small enough to share; beside volumes they are as large as is asked for."""
    grid, section = lattice(*sides), GridSection(path="a", opacity=0.5)
    _, _, plan = planned(scene_of(section), [grid])
    (layer,) = plan.content.cells
    assert layer.in_bricks[0].sum() <= times * layer.count
    assert max(plan.layout.counts_zyx) == bricks
    source = ArraySource(np.ones((9, 10, 11), np.float32), Grid((9, 10, 11), (0.1,) * 3, (0, 0, 0)))
    assert planned(scene_of(section, volumes=1), [source, grid])[2].layout.brick == 64


@pytest.mark.parametrize("given", [GRIDS, [one_cell("tetra")], [NOTHING]], ids=["two", "one cell", "nothing"])
def test_ranks_find_the_same(given: list[Any]) -> None:
    def found(channel: Channel) -> Any:
        sections = SECTIONS if len(given) > 1 else [GridSection(path="a")]
        _, opened, plan = planned(scene_of(*sections), given, channel)
        first = dict(opened.read(plan, set(visible(plan)[channel.rank :: channel.size])))
        facts = [tuple(map(repr, vars(info).items())) for info in opened.infos]
        packed = {
            index: [part and [array.tobytes() for array in vars(part).values()] for part in brick.members]
            for index, brick in first.items()
        }
        return (facts, [layer.in_bricks.tolist() for layer in plan.content.cells], plan.cost.tolist()), packed

    ((facts, bricks),) = run_loopback(1, found)
    for ranks in (2, 5):
        each = run_loopback(ranks, found)
        assert all(one[0] == facts for one in each)
        assert {index: brick for one in each for index, brick in one[1].items()} == bricks
