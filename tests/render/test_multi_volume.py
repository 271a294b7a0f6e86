"""Several volumes in one picture: against the float64 reference, in any parts, and at no cost for one alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest
from render import scenes
from render.looks import PATHS
from render.scenes import Counted, Prepared, noise, rotation

from clusterviz.comm import LoopbackChannel
from clusterviz.data import override_grid
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import Options, Run, prepare
from clusterviz.partition import BrickBox, Piece, build_tree
from clusterviz.plan.plan import Plan
from clusterviz.reference import render_reference
from clusterviz.render import stored_brick
from clusterviz.render.content_bricks import pack_parts, store
from clusterviz.render.cpu import device as cpu_device
from clusterviz.render.cpu import memory
from clusterviz.render.cpu.memory import Memory, words_of
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.storage import slot_of
from clusterviz.render.stored_brick import Stored
from clusterviz.scene.values import Camera, Clip, Cluster, ImageSettings, Light, Quality, Scene, Volume
from clusterviz.spmd.width import WIDTHS

BOUND = 1e-6
FEW = 0.005
"""The share of pixels in which a ray may graze a surface of noise, where the last bit decides."""
NARROW = {"width": WIDTHS[-1]}
"""Kernels of narrow vectors compile sooner."""
Part = tuple[Volume, np.ndarray, Grid]
CAMERAS = {
    "outside": Camera(position=(60, 50, 40), focal_point=(10, 10, 15), view_up=(0, 0, 1)),
    "inside": Camera(position=(12, 10, 12), focal_point=(10, 10, 35), view_up=(0, 1, 0), view_angle=80),
    "parallel": Camera(position=(60, -50, 40), focal_point=(10, 10, 15), view_up=(0, 0, 1), parallel_scale=25),
    "along": Camera(position=(12, 11, -40), focal_point=(12, 11, 0), view_up=(0, 1, 0), parallel_scale=12),
    "on a face": Camera(position=(0, 0, -5), focal_point=(0, 0, 0), view_up=(0, 1, 0), parallel_scale=11.5),
}


def volume(low: float, high: float, green: float = 1.0, **keys: Any) -> Volume:
    """Transparent in its lowest part."""
    width = high - low
    points = ((low, 0.0), (low + 0.3 * width, 0.0), (low + 0.5 * width, 0.05), (high, 0.5))
    colours = ((low, 0.0, green, 1.0), (high, 1.0, 1.0 - green, 0.4))
    return Volume(path="a", clim=(low, high), opacity=points, cmap=colours, opacity_unit_distance=3.0, **keys)


def but(part: Part, **keys: Any) -> Part:
    """A part with other keys of the volume."""
    return (part[0].model_copy(update=keys), *part[1:])


def hollow() -> np.ndarray:
    voxels = noise((15, 12, 17))
    voxels[3:6, 4:8, 2:9] = np.nan
    return voxels


BYTES = (volume(20, 230), noise((19, 23, 26), np.uint8), Grid((19, 23, 26)))
TURNED = Grid((15, 12, 17), (1.3, 0.9, 1.1), (5, 4, 30), rotation((1, 2, 3), 40))
FLOATS = (volume(-0.8, 0.8, 0.0), hollow(), TURNED)
PAIR = BYTES, FLOATS
WORDS = (
    volume(-2e4, 2e4, 0.5, interpolation="nearest", shade=True),
    noise((9, 30, 10), np.int16),
    Grid((9, 30, 10), (2.0, 0.8, 1.5), (12, -4, 3), rotation((3, -1, 1), -70)),
)
SMOOTH = (volume(-0.8, 0.8, 0.2, interpolation="cubic", shade=True), *FLOATS[1:])
ROUNDED = but(BYTES, gradient="smooth", shade=True)
WITHIN = (
    volume(-0.8, 0.8, 0.2),
    noise((5, 6, 7)),
    Grid((5, 6, 7), (0.9, 0.7, 0.8), (8, 9, 7), rotation((0, 1, 2), 15)),
)
COARSE = (volume(20, 230, shade=True), noise((5, 6, 4), np.uint8), Grid((5, 6, 4), (9.0, 5.0, 6.0), (-3, -2, 1)))
STEEP = but(BYTES, gradient_opacity=((0.0, 0.0), (40.0, 0.7), (60.0, 0.2), (120.0, 1.0)))
OPAQUE, FAINT = but(BYTES, opacity=1.0, opacity_unit_distance=1e-30), but(FLOATS, opacity=1e-8)
SHIFTED = (*BYTES[:2], Grid((19, 23, 26), origin=(0.5, 0.5, 0.5)))  # midpoints lie on its faces
BESIDE = (*FLOATS[:2], Grid((15, 12, 17), origin=(0.5, 0.5, 0.5)))
SINGLE = (volume(0, 1), np.ones((1, 1, 1), np.float32), Grid((1, 1, 1), origin=(3, 3, 3)))
FLAT = (volume(0, 1), np.ones((1, 9, 9), np.float32), Grid((1, 9, 9), origin=(3, 3, 3)))
SHELLS = but(BYTES, isosurfaces=(100.0, (150.0, 0.5)), blending="isosurface", shade=True)
CORES = but(FLOATS, isosurfaces=((-0.2, 0.3), (0.1, 0.6)))
LIGHTS = {"lights": (Light(position=(30, 20, 60), focal_point=(5, 5, 5)), Light(type="headlight", intensity=0.5))}
NEAR = {"lights": (Light(position=(30, 20, 60), positional=True),)}
CUT = {"clip": Clip(planes=(((9, 9, 9), (0.2, 1, 1)),))}
JITTERED = {"quality": {"jitter": True}}
INTEGRATED = {"quality": {"classification": "pre-integrated"}}
BOTH = {"quality": {"classification": "pre-integrated", "jitter": True}}
Case = tuple[tuple[Part, ...], dict[str, Any], tuple[str, ...]]
BY_OPENGL: dict[str, Case] = {
    "bytes beside turned floats with holes": (PAIR, {}, ("outside", "inside", "parallel")),
    "three, lit, clipped": ((WORDS, SMOOTH, ROUNDED), LIGHTS | CUT, ("outside", "inside", "parallel")),
    "one within another": ((BYTES, WITHIN), {}, ("outside", "inside", "parallel")),
    "by gradients": ((STEEP, FLOATS, WORDS), LIGHTS, ("outside", "inside", "parallel")),
    "slices": (PAIR, {"quality": {"renderer": "slices"}} | CUT, ("outside",)),
    "jittered": (PAIR, JITTERED | CUT, ("outside", "inside", "parallel")),
    "coarse and fine": ((COARSE, WITHIN), NEAR, ("outside", "inside", "parallel")),
    "integrals beside nearest voxels": ((BYTES, FLOATS, WORDS), INTEGRATED, ("inside",)),
    "integrals, lit, clipped, jittered": ((STEEP, SMOOTH), BOTH | CUT, ("outside",)),
    "surfaces through each other": ((SHELLS, CORES, WORDS), LIGHTS | CUT, ("inside",)),
    "surfaces beside integrals": ((FLOATS, SHELLS), BOTH | CUT, ("parallel",)),
    "opaque and faint": ((OPAQUE, FAINT), {}, ("outside",)),
    "steps of 30 voxels": (PAIR, {"step": 30.0}, ("outside",)),
    "midpoints on faces": ((BYTES, SHIFTED), {"step": 1.0}, ("along",)),
    "rays in faces": ((BYTES, BYTES), {"step": 1.0}, ("on a face",)),
    "without thickness": ((SINGLE, FLAT, FLOATS), {}, ("outside",)),
    "looks": ((but(BYTES, shader=PATHS["octants"]), but(FLOATS, shader=PATHS["boundaries"]), BESIDE), {}, ("outside",)),
}
BY_CPU: dict[str, Case] = {
    "bytes beside turned floats with holes": (PAIR, {}, ("outside", "inside", "parallel")),
    "nearest, lit, clipped, jittered": ((WORDS, FLOATS), LIGHTS | JITTERED | CUT, ("outside",)),
    "integrals beside nearest voxels": ((WORDS, FLOATS), BOTH | CUT, ("outside", "inside")),
    "surfaces through each other": ((SHELLS, CORES, WORDS), LIGHTS | CUT, ("inside",)),
    "surfaces beside integrals": ((FLOATS, SHELLS), BOTH | CUT, ("parallel",)),
    "narrow: splines and gradients": ((SMOOTH, STEEP), NEAR, ("inside",)),
    "narrow: opaque and faint": ((OPAQUE, FAINT), {}, ("outside",)),
    "narrow: steps of 30 voxels": (PAIR, {"step": 30.0}, ("outside",)),
    "narrow: midpoints on faces": ((BYTES, BESIDE), {"step": 1.0}, ("along",)),
    "narrow: rays in faces": ((BYTES, BESIDE), {"step": 1.0}, ("on a face",)),
    "narrow: without thickness": ((BYTES, FLAT), {}, ("outside",)),
}
CASES = [
    *(pytest.param("gl", name, camera, marks=pytest.mark.gl) for name in BY_OPENGL for camera in BY_OPENGL[name][2]),
    *(pytest.param("cpu", name, camera) for name in BY_CPU for camera in BY_CPU[name][2]),
]
EACH = pytest.mark.parametrize("caster", [pytest.param("gl", marks=pytest.mark.gl), "cpu"])


@pytest.fixture
def where(request: pytest.FixtureRequest, caster: str) -> moderngl.Context | None:
    """The context, or None for the CPU."""
    return request.getfixturevalue("context") if caster == "gl" else None


def scene_of(parts: tuple[Part, ...], camera: str = "outside", brick: int = 16, **sections: Any) -> Scene:
    return Scene(
        volumes=tuple(part[0] for part in parts),
        camera=CAMERAS[camera],
        image=ImageSettings(size=(40, 30)),
        quality=Quality(step=sections.pop("step", 0.7), **sections.pop("quality", {})),
        cluster=Cluster(brick=brick),
        **sections,
    )


def prepared(scene: Scene, parts: tuple[Part, ...]) -> Prepared:
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, [ArraySource(part[1], part[2]) for part in parts])
    assert share.plan is not None
    return Prepared(share.plan, bricks)


def drawn(where: Any, scene: Scene, parts: tuple[Part, ...], leaves: int = 1, **limits: Any) -> tuple[np.ndarray, int]:
    """The picture, drawn in so many boxes, and the samples taken."""
    return scenes.drawn(where, prepared(scene, parts), leaves, **limits)


def expected(scene: Scene, parts: tuple[Part, ...]) -> np.ndarray:
    sources = [
        override_grid(ArraySource(voxels, grid), volume) for volume, voxels, grid in parts
    ]  # single layers are thick
    shown = [(each.grid, each.read((0, 0, 0), each.grid.shape_zyx)) for each in sources]
    return render_reference(scene, [grid for grid, _ in shown], [voxels for _, voxels in shown])


def wrong(found: np.ndarray, right: np.ndarray, bound: float = 1e-5) -> float:
    """The share of pixels that differ, of pictures that show something."""
    assert right[..., 3].max() > 0.3
    return float((np.abs(found - right).max(axis=-1) > bound).mean())


@pytest.mark.cover(
    "gl-integrals, lit, clipped, jittered-outside",
    "gl-surfaces through each other-inside",
    "gl-three, lit, clipped-outside",
    "cpu-surfaces through each other-inside",
    "gl-integrals beside nearest voxels-inside",
)
@pytest.mark.parametrize(("caster", "name", "camera"), CASES)
def test_pictures_are_the_reference(where: Any, caster: str, name: str, camera: str) -> None:
    parts, sections, _ = (BY_OPENGL if caster == "gl" else BY_CPU)[name]
    scene = scene_of(parts, camera, **sections)
    found, _ = drawn(where, scene, parts, **NARROW if "narrow" in name else {})
    surfaces = "surfaces" in name
    assert wrong(found, expected(scene, parts), 1e-5 if surfaces else BOUND) <= FEW * surfaces


@pytest.mark.cover("gl")
@EACH
def test_tables_of_two_dimensions(where: Any, caster: str, tmp_path: Path) -> None:
    """Two volumes with tables of their own: of colours, and of opacities."""
    parts: tuple[Part, ...] = ()
    for number, (part, entries) in enumerate(((BYTES, (4, 6, 4)), (FLOATS, (5, 3)))):
        path, clim = tmp_path / f"{number}.npy", part[0].clim
        np.save(path, np.random.default_rng(number).random(entries) * 0.8)
        keys = {"cmap": part[0].cmap, "clim": clim, "opacity_unit_distance": 6.0, "shade": caster == "gl"}
        table = {"path": str(path), "values": clim, "magnitudes": (0.02 * np.ptp(clim), 0.3 * np.ptp(clim))}
        parts = (*parts, (Volume(path="b", transfer_2d=table, **keys), *part[1:]))
    parts = (*parts, WORDS) if caster == "gl" else parts
    found, _ = drawn(where, scene := scene_of(parts), parts, **NARROW if caster == "cpu" else {})
    assert np.abs(found - expected(scene, parts)).max() <= BOUND


@pytest.mark.cover("coarse and fine-gl", "integrated-gl")
@EACH
@pytest.mark.parametrize(
    ("parts", "camera", "sections"),
    [
        (PAIR, "parallel", {"step": 2.0}),
        (PAIR, "inside", {"step": 2.0} | INTEGRATED),
        ((COARSE, WITHIN), "inside", NEAR),
    ],
    ids=["sampled", "integrated", "coarse and fine"],
)
def test_neither_parts_nor_bricks_nor_memory_change_the_picture(
    where: Any, parts: tuple[Part, ...], camera: str, sections: dict[str, Any]
) -> None:
    """Integrated slabs of two voxels reach a voxel beyond their bricks."""
    first, _ = drawn(where, scene_of(parts, camera, 64, **sections), parts)
    little = {"block_bytes": 1 << 17} if where else {}
    for brick, leaves in ((9, 5), (13, 3)):
        scene = scene_of(parts, camera, brick, **sections)
        (found, samples), (alone, taken) = drawn(where, scene, parts, leaves), drawn(where, scene, parts, **little)
        assert np.abs(found - first).max() <= BOUND, brick
        assert np.abs(alone - first).max() <= BOUND, brick
        assert samples == taken


@pytest.mark.long
@pytest.mark.gl
def test_neither_parts_nor_bricks_change_where_slabs_end(context: moderngl.Context) -> None:
    """Slabs of two voxels reach a voxel beyond their bricks, and no slab is longer."""
    parts, sections, _ = BY_OPENGL["surfaces beside integrals"]
    pictures = [
        drawn(context, scene_of(parts, "parallel", brick, step=step, **sections), parts, leaves)[0]
        for brick, leaves, step in ((64, 1, 30.0), (9, 5, 2.0))
    ]
    assert wrong(*pictures) <= FEW


@pytest.mark.gl
@pytest.mark.parametrize("name", ["bytes beside turned floats with holes", "surfaces beside integrals"])
def test_both_casters_draw_the_same_and_take_the_same_samples_but_few(context: moderngl.Context, name: str) -> None:
    """Whether anything is visible is asked where windows end, and by OpenGL 16 slabs behind a run's begin, too."""
    parts, sections, (*_, camera) = BY_CPU[name]
    scene = scene_of(parts, camera, **sections)
    (found, samples), (other, others) = (drawn(where, scene, parts) for where in (None, context))
    assert wrong(found, other, 2e-6) == 0
    assert abs(samples - others) <= 0.05 * others


@pytest.mark.gl
def test_a_volume_given_twice_is_one_of_twice_the_extinction(context: moderngl.Context) -> None:
    one, twice = (but(BYTES, opacity_unit_distance=unit) for unit in (1.5, 3.0))
    alone, _ = drawn(context, scene_of((one,)), (one,))
    mixed, _ = drawn(context, scene_of((twice, twice)), (twice, twice))
    assert np.abs(mixed - alone).max() <= BOUND


@pytest.mark.gl
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units_are_of_no_account(context: moderngl.Context, unit: float) -> None:
    def scaled(part: Part) -> Part:
        look, voxels, grid = but(part, opacity_unit_distance=3.0 * unit)
        spacing, origin = (tuple(unit * length for length in triple) for triple in (grid.spacing, grid.origin))
        return look, voxels, Grid(grid.shape_zyx, spacing, origin, grid.direction)

    near = CAMERAS["outside"]
    position, focal_point = (tuple(unit * x for x in point) for point in (near.position, near.focal_point))
    camera = near.model_copy(update={"position": position, "focal_point": focal_point})
    parts = scaled(BYTES), scaled(FLOATS)
    scene = scene_of(parts).model_copy(update={"camera": camera})
    first, _ = drawn(context, scene_of(PAIR), PAIR)
    assert np.abs(drawn(context, scene, parts)[0] - first).max() <= BOUND


@pytest.mark.long
@pytest.mark.gl
def test_volumes_apart_are_each_alone_where_rays_meet_one(context: moderngl.Context) -> None:
    """Rays along z, whose slabs begin at one plane for both."""
    parts = BYTES, (volume(20, 230, 0.3), noise((19, 10, 12), np.uint8), Grid((19, 10, 12), origin=(40.0, 3.0, 0.0)))
    camera = Camera(position=(25, 10, -40), focal_point=(25, 10, 0), view_up=(0, 1, 0), parallel_scale=24)
    scene = scene_of(parts, step=0.5).model_copy(update={"camera": camera})
    mixed, _ = drawn(context, scene, parts)
    alone = [drawn(context, scene.model_copy(update={"volumes": (part[0],)}), (part,))[0] for part in parts]
    assert min(picture[..., 3].max() for picture in alone) > 0.3
    assert np.abs(mixed - sum(alone)).max() <= BOUND


def blobs(**keys: Any) -> tuple[Part, Part]:
    """A small body in each of two volumes, around it nothing."""
    blob = np.exp(-sum((axis - 20.0) ** 2 for axis in np.indices((40, 40, 40))) / 12)
    turned = Grid(blob.shape, origin=(14, 9, 5), direction=TURNED.direction)
    return (
        (volume(0, 255), np.round(255 * blob).astype(np.uint8), Grid(blob.shape)),
        (volume(0.0, 1.0, **keys), blob.astype(np.float32), turned),
    )


@pytest.mark.cover("OpenGL, surfaces")
@pytest.mark.parametrize(
    ("caster", "brick", "sections", "keys"),
    [
        pytest.param("gl", 32, {}, {}, id="OpenGL", marks=pytest.mark.gl),
        pytest.param("gl", 32, INTEGRATED, {"isosurfaces": [[0.6, 0.5]]}, id="OpenGL, surfaces", marks=pytest.mark.gl),
        pytest.param("cpu", 19, {"step": 2.9}, {}, id="long steps"),
        pytest.param("cpu", 64, {"step": 0.37, "quality": {"early_termination": 0.3}}, {}, id="ends early"),
        pytest.param("cpu", 64, {"step": 0.37} | JITTERED, {}, id="jittered"),
        pytest.param("cpu", 64, {"step": 0.37} | CUT, {}, id="clipped"),
        pytest.param("cpu", 19, {"step": 0.37} | INTEGRATED, {}, id="integrated"),
    ],
)
def test_skipping_changes_no_bit(
    where: Any, caster: str, brick: int, sections: Any, keys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = blobs(**keys)
    scene = scene_of(parts, brick=brick, **sections)
    skipped, fewer = drawn(where, scene, parts)

    def visible(ranges: Any, _: Plan) -> np.ndarray:
        return np.ones((len(ranges[0]), *ranges[0].shape[2:]), bool)

    monkeypatch.setattr(cpu_device, "visible_groups", visible)
    monkeypatch.setattr(stored_brick, "_visible", lambda low, high, look, transfer: np.ones(low.shape, bool))
    every, samples = drawn(where, scene, parts)
    assert skipped.max() > 0.1
    assert fewer < (samples / 2 if caster == "gl" else samples)
    assert np.array_equal(skipped, every)


def test_a_ray_ends_with_the_slab_that_leaves_too_little_light() -> None:
    (every, samples), (found, fewer) = (
        drawn(None, scene_of(PAIR, quality={"early_termination": share}), PAIR) for share in (0, 0.5)
    )
    assert fewer < 0.95 * samples
    assert np.abs(found - every).max() <= 0.5


def test_neither_threads_nor_numbers_of_64_bits_change_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    results = []
    for threads, narrow in (("1", memory.NARROW), ("3", memory.NARROW), ("3", 0)):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        monkeypatch.setattr(memory, "NARROW", narrow)
        results.append(drawn(None, scene_of(PAIR, brick=9), PAIR, **NARROW))
    assert results[0][1] > 0
    for picture, samples in results[1:]:
        assert np.array_equal(picture, results[0][0])
        assert samples == results[0][1]


@pytest.mark.long
@pytest.mark.gl
def test_several_volumes_cost_one_program_and_no_further_buffer_of_voxels(context: moderngl.Context) -> None:
    made = []
    for parts in ((BYTES,), PAIR, (WORDS, SMOOTH, BYTES)):
        each = prepared(scene_of(parts), parts)
        counted = Counted(context)
        caster = opengl_caster(counted, each.plan)
        caster.load(each.plan, each.bricks)
        assert counted.made == {"programs": 1, "buffers": 1}
        counted.made.clear()
        caster.draw(each.plan, [Piece(0, build_tree(each.plan.cost, 1).leaves[0].trimmed)])
        made.append(counted.made["buffers"])
        caster.release()
    # One block for all volumes, and one for what lights those that are lit.
    assert (made[1], made[2]) == (made[0] + 1, made[0] + 2)


@pytest.mark.gl
def test_only_what_the_volumes_need_is_compiled(context: moderngl.Context) -> None:
    sources = {}
    for name, parts in (("one", (BYTES,)), ("two", PAIR), ("lit", (WORDS, BYTES))):
        plan = prepared(scene_of(parts), parts).plan
        caster = opengl_caster(context, plan)
        sources[name] = caster.variant_of(plan).source.names
        caster.release()
    assert not {"multi_volume.glsl", "volume_layer.glsl", "kept.glsl"} & set(sources["one"])
    assert sources["two"].count("volume_layer.glsl") == 2
    assert {"voxel_u8.glsl", "voxel_f32.glsl"} < set(sources["two"])
    assert not {"lights.glsl", "gradient.glsl", "composite.glsl", "samples.glsl"} & set(sources["two"])
    assert (sources["lit"].count("lights.glsl"), sources["lit"].count("unlit.glsl")) == (1, 1)


@pytest.fixture
def filled() -> tuple[Memory, dict[tuple[int, int, int], Stored]]:
    """The CPU's memory of the bricks of three volumes, and these."""
    parts = (BYTES, FLOATS, WORDS)
    each = prepared(scene_of(parts, brick=9), parts)
    slot = slot_of(each.plan)
    stored = {i: store(portions, each.plan.content, slot) for i, portions in each.bricks.items()}
    held = Memory(slot)
    held.put(dict(stored), lambda _, one: one)
    return held, stored


def test_bricks_are_read_back_as_they_came(filled: Any) -> None:
    held, stored = filled
    slot = held._slot
    assert held.bricks == set(stored)
    assert held.voxels == sum(one.voxels for one in stored.values())
    for index, found in held.stored(list(stored)):
        assert np.array_equal(pack_parts(found.parts, slot), pack_parts(stored[index].parts, slot))
        assert np.array_equal(found.low, stored[index].low, equal_nan=True)
        assert np.array_equal(found.high, stored[index].high, equal_nan=True)


def test_volumes_take_memory_only_in_bricks_that_they_meet(filled: Any) -> None:
    held, stored = filled
    indices = np.array(list(stored))
    table = held.table(BrickBox((0, 0, 0), tuple((indices.max(axis=0) + 1).tolist())), indices)
    assert (table.offsets >= 0).sum() == len(np.unique(table.offsets)) - 1 == len(stored)
    assert held.bytes == table.bytes < 4 * len(stored) * words_of(held._slot)


def test_bricks_that_are_given_up_leave_their_room_to_others(filled: Any) -> None:
    held, stored = filled
    before, some = held.bytes, list(stored)[::2]
    held.drop(some)
    assert held.bricks == set(stored) - set(some)
    held.put({index: stored[index] for index in some}, lambda _, one: one)
    assert held.bytes == before
