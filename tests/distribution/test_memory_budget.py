"""Memory of bricks: counted as ranks then use it, and too little refused before anything is loaded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.content.geometry.section import LinesSection, MeshSection, PointsSection
from clusterviz.data import files, primitives, read_geometry
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.distribution import memory_budget
from clusterviz.distribution.memory_budget import MemoryBudget, check_memory, memory_budget_of
from clusterviz.errors import InputError
from clusterviz.frame import FrameLoop, Options, Run, prepare
from clusterviz.partition import build_tree, interleave, owners_of
from clusterviz.render.abuffer.primitives import make_table
from clusterviz.render.content_bricks import store
from clusterviz.render.cpu.memory import Memory
from clusterviz.render.storage import slot_of
from clusterviz.report.machine import Memory as MachineMemory
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

RANKS = 2
BRICKS = 8  # 2 × 2 × 2, all shown, half of them a rank
SIDE = 8  # samples of a brick's sides


def scene_of(**settings: Any) -> Scene:
    settings = {"size": (16, 12), "brick": SIDE - 1, "opacity": 0.5, "clim": (0.0, 250.0)} | settings
    return with_settings(Scene(volumes=(Volume(path="array"),)), settings)


def volume(dtype: str) -> ArraySource:
    """Cells enough for two whole bricks along each axis."""
    side = 2 * (SIDE - 1) + 1
    return ArraySource(np.random.default_rng(2).integers(0, 250, (side, side, side)).astype(dtype))


def held(dtype: str, scene: Scene, devices: tuple[Any, ...]) -> list[int]:
    """Bytes of bricks that each rank says it has."""

    def job(channel: Channel) -> list[int]:
        with FrameLoop(scene, channel, volume(dtype), Options(device=devices[channel.rank])) as loop:
            return [rank.voxel_bytes for rank in loop.frame().statistics.per_rank]

    return run_loopback(RANKS, job)[0]


SORT_FIRST = {"mode": "sort-first", "tiling": "interleaved"}


@pytest.mark.gl
@pytest.mark.parametrize(
    ("dtype", "device", "keys"),
    [
        ("uint8", "cpu", {}),
        ("uint16", "cpu", {}),
        ("float32", "cpu", {}),
        ("uint8", "cpu", SORT_FIRST),
        ("uint8", 0, {}),
        ("uint16", 0, SORT_FIRST),
    ],
)
def test_a_limit_is_as_much_as_ranks_hold(dtype: str, device: Any, keys: dict[str, str]) -> None:
    """A byte less is refused; and a word a voxel is what the processor holds, whatever the voxels are."""
    found = max(held(dtype, scene_of(**keys), (device,) * RANKS))
    bricks = BRICKS if keys else BRICKS // RANKS
    if device == "cpu":
        assert found == bricks * 4 * (SIDE**3 + 1)
    else:
        assert found < bricks * 4 * SIDE**3
    if not keys:
        return
    assert max(held(dtype, scene_of(memory_limit=found, **keys), (device,) * RANKS)) == found
    with pytest.raises(InputError, match=f"found {found - 1} bytes a rank"):
        held(dtype, scene_of(memory_limit=found - 1, **keys), (device,) * RANKS)


@pytest.mark.gl
def test_bricks_count_as_they_lie_where_they_take_most() -> None:
    """Ranks that draw by other means agree on who holds what."""
    alike, other = (max(held("uint8", scene_of(**SORT_FIRST), devices)) for devices in (("cpu", "cpu"), (0, 0)))
    assert held("uint8", scene_of(memory_limit=alike, **SORT_FIRST), ("cpu", 0)) == [alike, other]
    for devices in (("cpu", 0), (0, "cpu")):
        with pytest.raises(InputError, match=f"found {alike - 1} bytes a rank"):
            held("uint8", scene_of(memory_limit=alike - 1, **SORT_FIRST), devices)


@pytest.mark.gl
def test_of_volumes_that_a_brick_does_not_meet_the_processor_holds_nothing() -> None:
    """And OpenGL the room for them."""
    away = Grid((9, 9, 9), origin=(20.0, 3.0, 2.0))
    sources = [volume("uint8"), ArraySource(np.full((9, 9, 9), 9.0, np.float32), away)]
    scene = scene_of().model_copy(update={"volumes": scene_of().volumes * 2})
    share, bricks = prepare(Run(LoopbackChannel(), Options(device="cpu")), scene, sources)
    plan = share.plan
    assert plan is not None
    content, slot = plan.content, slot_of(plan)
    memory, count = Memory(slot), len(bricks)
    memory.put(bricks, lambda _, brick: store(brick, content, slot))
    counted = MemoryBudget(1, on_cpu=True, by_opengl=False).brick_bytes(plan)
    assert counted.sum() == memory.bytes
    assert len(np.unique(counted[counted > 0])) > 1
    assert MemoryBudget(1).brick_bytes(plan).sum() == count * slot.bytes
    both = MemoryBudget(1, on_cpu=True).brick_bytes(plan)
    assert (both == np.maximum(counted, MemoryBudget(1).brick_bytes(plan))).all()


@pytest.mark.gl
def test_nobody_asks_what_draws_where_nothing_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clusterviz.distribution.memory_budget.prefers_cpu", lambda device: pytest.fail("asked"))

    def job(channel: Channel) -> MemoryBudget:
        return memory_budget_of(Run(channel, Options()), scene_of().cluster, shares_screen=False)

    assert run_loopback(RANKS, job) == [MemoryBudget()] * RANKS


def trees(sizes: np.ndarray, ranks: int) -> np.ndarray:
    return owners_of(build_tree(np.ones(sizes.shape), ranks)).sums(sizes)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(10, 400))
def test_the_ranks_that_are_named_do(seed: int, ranks: int, limit: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 6, 3))
    sizes = rng.integers(0, 10, shape)
    if trees(sizes, ranks).max() <= limit:
        check_memory(lambda n: trees(sizes, n), ranks, sizes, limit)
        return
    with pytest.raises(InputError) as refusal:
        check_memory(lambda n: trees(sizes, n), ranks, sizes, limit)
    if named := re.search(r"allowed (\d+) ranks", str(refusal.value)):
        assert int(named[1]) > ranks
        assert trees(sizes, int(named[1])).max() <= limit


def test_too_little_memory_names_what_would_do() -> None:
    sizes = np.full((2, 2, 2), 100)
    for limit, text in (
        (200, r"share of 2 ranks takes 400 bytes.*found 200 bytes.*allowed 4 ranks"),
        (99, "smaller bricks: one takes 100 bytes"),
    ):
        with pytest.raises(InputError, match=text):
            check_memory(lambda n: interleave(np.ones(sizes.shape), n).sums(sizes), 2, sizes, limit)


CORNERS = np.array([[0, 0, 0], [9, 0, 1], [2, 8, 0], [3, 3, 7]], np.float32)


def surfaces(**settings: Any) -> tuple[Scene, list[Any]]:
    """A lit mesh with a colour for each vertex, a line and points, all in one brick."""
    section: dict[str, Any] = {
        "meshes": (MeshSection(path="mesh", shading="smooth", scalars="v"),),
        "lines": (LinesSection(path="lines", radius=0.1),),
        "points": (PointsSection(path="points", radius=0.2),),
    }
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]], np.uint32)
    given = [
        Geometry(mesh=Mesh("mesh", CORNERS, faces, {"v": np.arange(4.0, dtype=np.float32)})),
        Geometry(lines=Lines("lines", CORNERS, np.array([0, 4]))),
        Geometry(points=Points("points", CORNERS)),
    ]
    return with_settings(Scene(**section), {"size": (16, 12), "brick": 1024} | settings), given


def test_primitives_count_as_they_are_held_and_as_they_are_drawn() -> None:
    scene, given = surfaces()
    run = Run(LoopbackChannel(), Options(device="cpu"))
    work, bricks = prepare(run, scene, given)
    assert work.plan
    ((index, brick),) = bricks.items()
    layers = work.plan.content.layers
    table = make_table(layers, [brick.members])
    found = sum(part.nbytes for part in brick.members if part)
    found += sum(array.nbytes for array in (*table.positions, *table.radii, table.corners))
    found += 32 * table.vertices + sum(4 * (part.normals.size + part.colours.size) for part in brick.members if part)
    counted = int(MemoryBudget(1, on_cpu=True, by_opengl=False).brick_bytes(work.plan)[index])
    # Triangles have no radii.
    assert found <= counted <= found + 4 * 4 + 64


def test_surfaces_beyond_the_free_memory_are_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, given = surfaces()
    monkeypatch.setattr(memory_budget, "memory", lambda: MachineMemory(4000, 1000))
    with pytest.raises(InputError, match=r"the memory that is free: .* takes \d+ bytes; found 800 bytes a rank"):
        prepare(Run(LoopbackChannel(), Options(device="cpu")), scene, given)
    with pytest.raises(InputError, match=r"cluster.memory_limit: .* found 900 bytes a rank"):
        prepare(Run(LoopbackChannel(), Options(device="cpu")), surfaces(memory_limit=900)[0], given)


def test_bricks_with_too_many_primitives_are_refused_while_they_are_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, given = surfaces(brick=2)
    monkeypatch.setattr(primitives, "memory", lambda: MachineMemory(4000, 1000))
    with pytest.raises(InputError, match=r"cluster.brick: primitives lie in too many bricks .* of 1000"):
        prepare(Run(LoopbackChannel(), Options(device="cpu")), scene, given)


def test_a_file_larger_than_the_free_memory_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert read_geometry(path).mesh
    monkeypatch.setattr(files, "memory", lambda: MachineMemory(4000, 20))
    with pytest.raises(InputError, match=r"mesh.obj: larger than the memory that is free; found 32 bytes"):
        read_geometry(path)
