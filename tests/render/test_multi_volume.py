"""Several volumes in one picture: against the float64 reference, in any parts, and at no cost for one alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import moderngl
import numpy as np
import pytest
from render.scenes import noise, rotation, whole
from render.test_costs import Counted

from clusterviz.comm import LoopbackChannel
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import Options, Run, prepare
from clusterviz.partition import Piece, build_tree, leaf_pieces
from clusterviz.plan.plan import Plan
from clusterviz.reference import over, render_reference
from clusterviz.render import stored_brick
from clusterviz.render.raycast import Raycaster
from clusterviz.scene.values import Camera, Clip, Cluster, ImageSettings, Light, Quality, Scene, Volume

pytestmark = pytest.mark.gl

BOUND = 1e-6
Part = tuple[Volume, np.ndarray, Grid]
CAMERAS = {
    "outside": Camera(position=(60, 50, 40), focal_point=(10, 10, 15), view_up=(0, 0, 1)),
    "inside": Camera(position=(12, 10, 12), focal_point=(10, 10, 35), view_up=(0, 1, 0), view_angle=80),
    "parallel": Camera(position=(60, -50, 40), focal_point=(10, 10, 15), view_up=(0, 0, 1), parallel_scale=25),
}


def volume(low: float, high: float, green: float = 1.0, **keys: Any) -> Volume:
    """Transparent in its lowest part."""
    width = high - low
    points = ((low, 0.0), (low + 0.3 * width, 0.0), (low + 0.5 * width, 0.05), (high, 0.5))
    colours = ((low, 0.0, green, 1.0), (high, 1.0, 1.0 - green, 0.4))
    return Volume(path="a", clim=(low, high), opacity=points, cmap=colours, opacity_unit_distance=3.0, **keys)


def hollow() -> np.ndarray:
    voxels = noise((15, 12, 17))
    voxels[3:6, 4:8, 2:9] = np.nan
    return voxels


BYTES = (volume(20, 230), noise((19, 23, 26), np.uint8), Grid((19, 23, 26)))
TURNED = Grid((15, 12, 17), (1.3, 0.9, 1.1), (5, 4, 30), rotation((1, 2, 3), 40))
FLOATS = (volume(-0.8, 0.8, 0.0), hollow(), TURNED)
WORDS = (
    volume(-2e4, 2e4, 0.5, interpolation="nearest", shade=True),
    noise((9, 30, 10), np.int16),
    Grid((9, 30, 10), (2.0, 0.8, 1.5), (12, -4, 3), rotation((3, -1, 1), -70)),
)
SMOOTH = (volume(-0.8, 0.8, 0.2, interpolation="cubic", shade=True), *FLOATS[1:])
ROUNDED = (BYTES[0].model_copy(update={"gradient": "smooth", "shade": True}), *BYTES[1:])
WITHIN = (
    volume(-0.8, 0.8, 0.2),
    noise((5, 6, 7)),
    Grid((5, 6, 7), (0.9, 0.7, 0.8), (8, 9, 7), rotation((0, 1, 2), 15)),
)
COARSE = (volume(20, 230, shade=True), noise((5, 6, 4), np.uint8), Grid((5, 6, 4), (9.0, 5.0, 6.0), (-3, -2, 1)))
STEEP = (
    BYTES[0].model_copy(update={"gradient_opacity": ((0.0, 0.0), (40.0, 0.7), (60.0, 0.2), (120.0, 1.0))}),
    *BYTES[1:],
)
LIGHTS = (Light(position=(30, 20, 60), focal_point=(5, 5, 5)), Light(type="headlight", intensity=0.5))
SCENES: dict[str, tuple[tuple[Part, ...], dict[str, Any]]] = {
    "bytes beside turned floats with holes": ((BYTES, FLOATS), {}),
    "three, lit, clipped": (
        (WORDS, SMOOTH, ROUNDED),
        {"lights": LIGHTS, "clip": Clip(planes=(((5, 5, 5), (1, 1, 0.5)),))},
    ),
    "one within another": ((BYTES, WITHIN), {}),
    "by gradients": ((STEEP, FLOATS, WORDS), {"lights": LIGHTS}),
    "jittered": ((BYTES, FLOATS), {"quality": {"jitter": True}, "clip": Clip(planes=(((9, 9, 9), (0.2, 1, 1)),))}),
    "coarse and fine": ((COARSE, WITHIN), {"lights": (Light(position=(30, 20, 60), positional=True),)}),
}


def scene_of(parts: tuple[Part, ...], camera: str = "outside", brick: int = 16, **sections: Any) -> Scene:
    return Scene(
        volumes=tuple(part[0] for part in parts),
        camera=CAMERAS[camera],
        image=ImageSettings(size=(40, 30)),
        quality=Quality(step=sections.pop("step", 0.7), **sections.pop("quality", {})),
        cluster=Cluster(brick=brick),
        **sections,
    )


def prepared(scene: Scene, parts: tuple[Part, ...]) -> tuple[Plan, dict[Any, Any]]:
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, [ArraySource(part[1], part[2]) for part in parts])
    assert share.plan is not None
    return share.plan, bricks


def drawn(
    context: moderngl.Context, scene: Scene, parts: tuple[Part, ...], leaves: int = 1, block_bytes: int | None = None
) -> tuple[np.ndarray, int]:
    """The picture, drawn in so many parts, and the samples taken."""
    plan, bricks = prepared(scene, parts)
    caster = Raycaster(context, plan, block_bytes)
    caster.load(plan, bricks)
    pieces = leaf_pieces(build_tree(plan.cost, leaves), plan.cost, plan.eye_in_bricks(), plan.view.forward)
    each = caster.draw(plan, pieces)
    caster.release()
    return over([whole(one.partial, scene.image.size) for one in each]), sum(one.samples for one in each)


def expected(scene: Scene, parts: tuple[Part, ...]) -> np.ndarray:
    return render_reference(scene, [part[2] for part in parts], [part[1] for part in parts])


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_the_reference(context: moderngl.Context, name: str, camera: str) -> None:
    parts, sections = SCENES[name]
    scene = scene_of(parts, camera, **dict(sections))
    picture, _ = drawn(context, scene, parts)
    assert picture[..., 3].max() > 0.3
    assert np.abs(picture - expected(scene, parts)).max() <= BOUND


@pytest.mark.parametrize("entries", [(4, 6, 4), (5, 3)], ids=["colours", "opacities"])
def test_tables_of_two_dimensions(context: moderngl.Context, entries: tuple[int, ...], tmp_path: Path) -> None:
    """Two volumes with tables of their own, beside one without."""
    parts = []
    for number, part in enumerate((BYTES, FLOATS)):
        path, clim = tmp_path / f"{number}.npy", part[0].clim
        np.save(path, np.random.default_rng(number).random(entries) * 0.8)
        keys = {"cmap": part[0].cmap, "clim": clim, "opacity_unit_distance": 6.0, "shade": not number}
        table = {"path": str(path), "values": clim, "magnitudes": (0.02 * np.ptp(clim), 0.3 * np.ptp(clim))}
        parts.append((Volume(path="b", transfer_2d=table, **keys), *part[1:]))
    scene = scene_of((*parts, WORDS))
    picture, _ = drawn(context, scene, (*parts, WORDS))
    assert np.abs(picture - expected(scene, (*parts, WORDS))).max() <= BOUND


@pytest.mark.parametrize("name", ["bytes beside turned floats with holes", "coarse and fine"])
def test_neither_parts_nor_bricks_nor_memory_change_the_picture(context: moderngl.Context, name: str) -> None:
    parts, sections = SCENES[name]
    first, _ = drawn(context, scene_of(parts, "inside", 64, **sections), parts)
    counts = set()
    for brick, leaves, block_bytes in ((9, 5, None), (13, 3, None), (13, 1, 1 << 17)):
        picture, taken = drawn(context, scene_of(parts, "inside", brick, **sections), parts, leaves, block_bytes)
        assert np.abs(picture - first).max() <= BOUND, (brick, leaves)
        if brick == 13:
            counts.add(taken)
    assert len(counts) == 1


def test_a_volume_given_twice_is_one_of_twice_the_extinction(context: moderngl.Context) -> None:
    one = (FLOATS[0].model_copy(update={"opacity_unit_distance": 1.5}), *BYTES[1:])
    twice = (one[0].model_copy(update={"opacity_unit_distance": 3.0}), *BYTES[1:])
    clim = {"clim": (20.0, 230.0), "opacity": BYTES[0].opacity, "cmap": BYTES[0].cmap}
    one, twice = ((part[0].model_copy(update=clim), *part[1:]) for part in (one, twice))
    alone, _ = drawn(context, scene_of((one,)), (one,))
    mixed, _ = drawn(context, scene_of((twice, twice)), (twice, twice))
    assert np.abs(mixed - alone).max() <= BOUND


OPAQUE = (BYTES[0].model_copy(update={"opacity": 1.0, "opacity_unit_distance": 1e-30}), *BYTES[1:])
FAINT = (FLOATS[0].model_copy(update={"opacity": 1e-8}), *FLOATS[1:])
SHIFTED = (*BYTES[:2], Grid((19, 23, 26), origin=(0.5, 0.5, 0.5)))  # midpoints lie on its faces
SINGLE = (volume(0, 1), np.ones((1, 1, 1), np.float32), Grid((1, 1, 1), origin=(3, 3, 3)))
FLAT = (volume(0, 1), np.ones((1, 9, 9), np.float32), Grid((1, 9, 9), origin=(3, 3, 3)))
ALONG = Camera(position=(12, 11, -40), focal_point=(12, 11, 0), view_up=(0, 1, 0), parallel_scale=12)
ON_A_FACE = Camera(position=(0, 0, -5), focal_point=(0, 0, 0), view_up=(0, 1, 0), parallel_scale=11.5)


@pytest.mark.parametrize(
    ("parts", "camera", "step"),
    [
        ((OPAQUE, FAINT), CAMERAS["outside"], 0.7),
        ((BYTES, FLOATS), CAMERAS["outside"], 30.0),
        ((BYTES, SHIFTED), ALONG, 1.0),
        ((BYTES, BYTES), ON_A_FACE, 1.0),
        ((SINGLE, FLAT, FLOATS), CAMERAS["outside"], 0.7),
    ],
    ids=["opaque and faint", "steps of 30 voxels", "midpoints on faces", "rays in faces", "without thickness"],
)
def test_extremes(context: moderngl.Context, parts: tuple[Part, ...], camera: Camera, step: float) -> None:
    scene = scene_of(parts, step=step).model_copy(update={"camera": camera})
    picture, _ = drawn(context, scene, parts)
    assert picture[..., 3].max() > 0.3
    assert np.abs(picture - expected(scene, parts)).max() <= BOUND


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units_are_of_no_account(context: moderngl.Context, unit: float) -> None:
    def scaled(part: Part) -> Part:
        look, voxels, grid = part
        spacing, origin = (tuple(unit * length for length in triple) for triple in (grid.spacing, grid.origin))
        farther = look.model_copy(update={"opacity_unit_distance": 3.0 * unit})
        return farther, voxels, Grid(grid.shape_zyx, spacing, origin, grid.direction)

    near = CAMERAS["outside"]
    position, focal_point = (tuple(unit * x for x in point) for point in (near.position, near.focal_point))
    camera = near.model_copy(update={"position": position, "focal_point": focal_point})
    parts = scaled(BYTES), scaled(FLOATS)
    scene = scene_of(parts).model_copy(update={"camera": camera})
    first, _ = drawn(context, scene_of((BYTES, FLOATS)), (BYTES, FLOATS))
    assert np.abs(drawn(context, scene, parts)[0] - first).max() <= BOUND


def test_volumes_apart_are_each_alone_where_rays_meet_one(context: moderngl.Context) -> None:
    """Rays along z, whose slabs begin at one plane for both."""
    parts = BYTES, (volume(20, 230, 0.3), noise((19, 10, 12), np.uint8), Grid((19, 10, 12), origin=(40.0, 3.0, 0.0)))
    camera = Camera(position=(25, 10, -40), focal_point=(25, 10, 0), view_up=(0, 1, 0), parallel_scale=24)
    scene = scene_of(parts, step=0.5).model_copy(update={"camera": camera})
    mixed, _ = drawn(context, scene, parts)
    alone = [drawn(context, scene.model_copy(update={"volumes": (part[0],)}), (part,))[0] for part in parts]
    assert min(picture[..., 3].max() for picture in alone) > 0.3
    assert np.abs(mixed - sum(alone)).max() <= BOUND


@pytest.mark.parametrize("classification", ["post", "pre-integrated"])
def test_what_is_skipped_shows_nothing(
    context: moderngl.Context, classification: Literal["post", "pre-integrated"], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A blob in each of two volumes, with isosurfaces where slabs are integrated: the picture without skipping, by far
    fewer samples.
    """
    squares = sum((axis - 20.0) ** 2 for axis in np.indices((40, 40, 40)))
    blob = np.exp(-squares / 12).astype(np.float32)
    look = volume(0.0, 1.0, **({"isosurfaces": [[0.6, 0.5]]} if classification == "pre-integrated" else {}))
    parts = (
        (look, blob, Grid(blob.shape)),
        (look, blob, Grid(blob.shape, origin=(14, 9, 5), direction=TURNED.direction)),
    )
    scene = scene_of(parts, brick=32, quality={"classification": classification})
    skipping, fewer = drawn(context, scene, parts)
    monkeypatch.setattr(stored_brick, "_visible", lambda low, high, look, transfer: np.ones(low.shape, bool))
    every, samples = drawn(context, scene, parts)
    assert np.array_equal(skipping, every)
    assert fewer < samples / 2


def test_several_volumes_cost_one_program_and_no_further_buffer_of_voxels(context: moderngl.Context) -> None:
    made = []
    for parts in ((BYTES,), (BYTES, FLOATS), (WORDS, SMOOTH, BYTES)):
        plan, bricks = prepared(scene_of(parts), parts)
        counted = Counted(context)
        caster = Raycaster(counted, plan)
        caster.load(plan, bricks)
        assert counted.made == {"programs": 1, "buffers": 1}
        counted.made.clear()
        caster.draw(plan, [Piece(0, build_tree(plan.cost, 1).leaves[0].trimmed)])
        made.append(counted.made["buffers"])
        caster.release()
    # One block for all volumes, and one for what lights those that are lit.
    assert (made[1], made[2]) == (made[0] + 1, made[0] + 2)


def test_only_what_the_volumes_need_is_compiled(context: moderngl.Context) -> None:
    sources = {}
    for name, parts in (("one", (BYTES,)), ("two", (BYTES, FLOATS)), ("lit", (WORDS, BYTES))):
        plan, _ = prepared(scene_of(parts), parts)
        caster = Raycaster(context, plan)
        sources[name] = caster.variant_of(plan).source.names
        caster.release()
    assert not {"multi_volume.glsl", "volume_layer.glsl", "kept.glsl"} & set(sources["one"])
    assert sources["two"].count("volume_layer.glsl") == 2
    assert {"voxel_u8.glsl", "voxel_f32.glsl"} < set(sources["two"])
    assert not {"lights.glsl", "gradient.glsl", "composite.glsl", "samples.glsl"} & set(sources["two"])
    assert (sources["lit"].count("lights.glsl"), sources["lit"].count("unlit.glsl")) == (1, 1)
