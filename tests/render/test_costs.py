"""A scene pays only for what it holds: programs, dispatches, buffers, textures, bytes and shader files, counted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import Counted, camera_at, prepare, scene_of

from clusterviz.data.source import Grid
from clusterviz.gl.device import Counts
from clusterviz.partition import Piece, build_tree
from clusterviz.plan.plan import Plan
from clusterviz.render import march
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.storage import slot_of
from clusterviz.render.variant import variant_of
from clusterviz.scene.values import Light

SHAPE = (33, 33, 33)
GRID = Grid(SHAPE)
VOXELS = (np.indices(SHAPE).sum(axis=0) * 2).astype(np.uint8)
BRICK = 16
# Of every picture: pixels, progress and samples, the transfer function's buckets, records, where bricks begin, visible
# groups, the frame.
BUFFERS = 7
ALWAYS = (
    "raycast pixels buffers ray numbers opacity transfer words pitch units records_uniform march groups "
    "groups_of_bricks no_prefetch no_profile own_box reals_double vectors_double reals bricks_double"
)
PLAIN = (
    "composite linear cells over samples whole_slab segment unclipped unlit gradient_none unfaded unjittered "
    "unsplit entries unnoted no_fragments fixed_step voxel_u8"
)

CLIP = {"clip": {"planes": [[[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]]]}}
LAMP = {"lights": (Light(type="headlight"),)}
SURFACES = {"blending": "isosurface", "isosurfaces": [50.0, 100.0]}
IN_VOLUME = {"isosurfaces": [50.0, 100.0]}
LOCAL = {"blending": "local-maximum", "threshold": 9.0}
PLACE = {"lights": (Light(position=(1, 2, 3), positional=True),)}
SHADE = {"shade": True}
OPTICS = {"wavelengths": [500, 600], "absorption": [[0, 0, 0], [1, 1, 2]]}
SMOOTH = {"gradient": "smooth"}
FADED = {"gradient_opacity": [[0.0, 0.0], [9.0, 1.0]]}


@dataclass(frozen=True)
class Case:
    """A scene, and what it takes beside what a plain one does.

    Attributes
    ----------
    keys : of the scene
    less, more : shader files that it does without, and with
    buffers, textures : more than a plain scene has
    side : samples along the side of a stored brick
    """

    keys: dict[str, Any]
    less: str = ""
    more: str = ""
    buffers: int = 0
    textures: int = 0
    side: int = 17


CASES = {
    "plain": Case({}),
    "lights of an unlit volume": Case(LAMP),
    "maximum, not lit": Case({"blending": "maximum"} | SHADE, "composite over", "extreme"),
    "average": Case({"blending": "average"}, "composite over", "sum"),
    "local maximum": Case(LOCAL, "composite over", "local_maximum"),
    "shade": Case(SHADE, "unlit gradient_none", "gradient ambient lights lights_far phong", buffers=1, side=19),
    "shade, from a place": Case(
        SHADE | PLACE, "unlit gradient_none", "gradient ambient lights lights_near phong", buffers=1, side=19
    ),
    "nearest, shade": Case(
        {"interpolation": "nearest"} | SHADE,
        "linear unlit gradient_none",
        "nearest gradient_nearest ambient lights lights_far phong",
        buffers=1,
        side=19,
    ),
    "shade, smooth": Case(
        SHADE | SMOOTH,
        "unlit gradient_none",
        "spline gradient_cubic ambient lights lights_far phong",
        buffers=1,
        side=19,
    ),
    "smooth, but not lit": Case(SMOOTH),
    "cubic": Case({"interpolation": "cubic"}, "linear", "spline cubic", side=19),
    "cubic, shade": Case(
        {"interpolation": "cubic"} | SHADE,
        "linear unlit gradient_none",
        "spline cubic gradient_cubic ambient lights lights_far phong",
        buffers=1,
        side=19,
    ),
    "optics": Case({"optics": OPTICS}, "composite over", "kubelka_munk two_flux"),
    "refraction": Case(
        {"optics": OPTICS | {"refraction": True}},
        "composite over unsplit entries gradient_none",
        "kubelka_munk two_flux refraction paths planes gradient",
    ),
    "clip": Case(CLIP, "unclipped", "clip kept", buffers=1),
    "isosurfaces": Case(SURFACES, "samples", "surfaces extremes root cell_linear", buffers=1, side=19),
    "isosurfaces in a volume": Case(IN_VOLUME, "samples", "surfaces extremes root cell_linear", buffers=1, side=19),
    "all of it": Case(
        SURFACES | SHADE | CLIP | {"interpolation": "cubic"},
        "samples linear unlit unclipped gradient_none",
        "surfaces root cell_cubic spline cubic gradient_cubic ambient lights lights_far clip kept phong",
        buffers=3,
        side=19 + 2,
    ),
    "adaptive": Case({"adaptive": 0.01}, "fixed_step", "adaptive_step"),
    "pre-integrated": Case(
        {"classification": "pre-integrated"},
        "composite samples whole_slab segment",
        "preintegrated ramp ramp_slab front_to_back sums",
        buffers=1,
        side=19,
    ),
    "pre-integrated, split": Case(
        {"classification": "pre-integrated", "borders": "split"},
        "composite samples whole_slab segment unsplit",
        "preintegrated ramp ramp_slab front_to_back sums split",
        buffers=1,
    ),
    "midpoints, which need no split": Case({"borders": "split"}),
    "pre-integrated, shade": Case(
        {"classification": "pre-integrated"} | SHADE,
        "composite samples whole_slab segment unlit gradient_none",
        "preintegrated ramp ramp_slab front_to_back sums gradient ambient lights lights_far phong",
        buffers=2,
        side=19 + 2,
    ),
    "pre-integrated, but nearest": Case(
        {"classification": "pre-integrated", "interpolation": "nearest"}, "linear", "nearest"
    ),
    "gradient opacity": Case(FADED, "gradient_none unfaded", "gradient magnitude faded", buffers=1, side=19),
    "gradient opacity, shade": Case(
        FADED | SHADE,
        "gradient_none unfaded unlit",
        "gradient magnitude faded ambient lights lights_far phong",
        buffers=2,
        side=19,
    ),
    "gradient opacity, pre-integrated": Case(
        FADED | {"classification": "pre-integrated"},
        "composite samples whole_slab segment gradient_none unfaded",
        "preintegrated ramp ramp_slab front_to_back sums gradient magnitude faded",
        buffers=2,
        side=19 + 2,
    ),
    "jitter": Case({"jitter": True}, "unjittered", "jitter"),
    "jitter, but surfaces": Case(
        {"jitter": True} | SURFACES, "samples", "surfaces extremes root cell_linear", buffers=1, side=19
    ),
    "cubic, hardware": Case(
        {"filter": "hardware", "interpolation": "cubic"},
        "linear voxel_u8",
        "spline cubic_hardware atlas rows",
        textures=1,
        side=19,
    ),
    "hardware": Case({"filter": "hardware"}, "linear voxel_u8", "hardware atlas rows", textures=1),
}


def planned(name: str) -> tuple[Plan, dict[Any, Any]]:
    prepared = prepare(scene_of(VOXELS, camera_at("outside", GRID), **CASES[name].keys), VOXELS, GRID, BRICK)
    return prepared.plan, prepared.bricks


@pytest.mark.cover("all of it")
@pytest.mark.gl
# Rays that bend have planes beside, see test_refraction.py.
@pytest.mark.parametrize("name", [name for name in CASES if name != "refraction"])
def test_only_what_is_shown_is_made(context: moderngl.Context, name: str) -> None:
    case = CASES[name]
    plan, bricks = planned(name)
    counted = Counted(context)
    caster = opengl_caster(counted, plan, band_pixels=1 << 62)
    assert counted.made == {"programs": 1}
    caster.load(plan, {index: bricks[index] for index in map(tuple, np.argwhere(plan.cost).tolist())})
    shown = np.count_nonzero(plan.cost)
    assert counted.made == {"programs": 1} | ({"textures": 1} if case.textures else {"buffers": 1})
    voxels = case.side**3 if case.textures else 4 * -(-(case.side - 1) // 3) * case.side**2
    assert caster.pool.bytes == shown * voxels
    counted.made.clear()
    pieces = [Piece(0, build_tree(plan.cost, 1).leaves[0].trimmed)]
    for _ in range(2):
        caster.draw(plan, pieces)
        assert counted.made["buffers"] == BUFFERS + case.buffers
    counted.made.clear()
    before = replace(caster.counts)
    (drawn,) = caster.draw(plan, pieces)
    assert counted.made == {"dispatches": 1}
    assert caster.counts.since(before) == Counts(dispatches=1, waits=1, uploaded=0, read=drawn.bytes_read)
    caster.release()


@pytest.mark.parametrize("name", CASES)
def test_only_what_is_shown_is_compiled(name: str) -> None:
    case, (plan, _) = CASES[name], planned(name)
    source = variant_of(plan, slot_of(plan), 1 << 24).source
    files = set(f"{ALWAYS} {PLAIN} {case.more}".split()) - set(case.less.split())
    assert {part.removesuffix(".glsl") for part in source.names if part.endswith(".glsl")} == files
    constants = (("LIGHTS", "lights"), ("PLANES", "clip"), ("SURFACES", "surfaces"), ("FADING_PIECES", "magnitude"))
    for constant, file in constants:
        assert (f"const int {constant} " in source.text) == (file in files)


@pytest.mark.gl
def test_a_table_is_one_texture_and_one_buffer(context: moderngl.Context, tmp_path: Path) -> None:
    np.save(tmp_path / "table.npy", np.ones((3, 5)))
    table = {"path": str(tmp_path / "table.npy"), "values": (0.0, 200.0), "magnitudes": (0.0, 9.0)}
    scene = scene_of(VOXELS, camera_at("outside", GRID), opacity=None, transfer_2d=table)
    prepared = prepare(scene, VOXELS, GRID, BRICK)
    counted = Counted(context)
    caster = opengl_caster(counted, prepared.plan)
    caster.load(prepared.plan, prepared.bricks)
    counted.made.clear()
    for _ in range(2):
        caster.draw(prepared.plan, [Piece(0, build_tree(prepared.plan.cost, 1).leaves[0].trimmed)])
    assert (counted.made["buffers"], counted.made["tables"]) == (BUFFERS + 1, 1)
    caster.release()


def test_scenes_that_differ_in_numbers_share_a_program() -> None:
    """Clim, opacity, camera, step, lights and planes are not constants: only how many there are is."""
    sources = set()
    for clim, step, normal in (((0.0, 150.0), 1.0, [1, 0, 0]), ((5.0, 120.0), 0.3, [1, 2, 3])):
        parts = {"clip": {"planes": [[[1, 1, 1], normal]]}, "lights": (Light(position=tuple(normal)),)}
        scene = scene_of(VOXELS, camera_at("inside", GRID), clim=clim, step=step, shade=True, **parts)
        plan = prepare(scene, VOXELS, GRID, BRICK).plan
        sources.add(variant_of(plan, slot_of(plan), 1 << 16).source.text)
    assert len(sources) == 1


def test_tile_is_that_of_the_shader() -> None:
    plan, _ = planned("plain")
    text = variant_of(plan, slot_of(plan), 1 << 16).source.text
    assert f"local_size_x = {march.TILE}, local_size_y = {march.TILE}" in text
