"""Recorded draws: the interpreter draws what OpenGL does, and probes find the same in both, in every shader file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest
from data.checks import Pyramid
from render import scenes
from render.scenes import LIT, camera_at, clip_of, lights_in, noise, scene_of, smooth

from clusterviz.comm import LoopbackChannel
from clusterviz.content.flow.section import FlowSection
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray
from clusterviz.frame import Options, Run, prepare
from clusterviz.gl.shader import shader_folder
from clusterviz.partition import Piece, build_tree
from clusterviz.plan.plan import Plan
from clusterviz.render.cpu import arrays as cpu_arrays
from clusterviz.render.cpu.device import cpu_caster
from clusterviz.render.crossing import Crossing
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.recording import recorded, run_on
from clusterviz.spmd.interpreter import Dispatch, Interpreter
from clusterviz.spmd.ir import Declare, Variable
from clusterviz.spmd.machine_code import ONE_GROUP, addresses, function_of, object_code
from clusterviz.spmd.probe import Probe, Shader, Taken, probe_bytes, taken_by, taken_of_words
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.width import host_width

SHAPE = (9, 11, 12)
GRID = Grid(SHAPE)
BINDING = 9
"""Of the probe's buffer."""
SIZE = (8, 8)
SURFACES = {"isosurfaces": ((100.0, 0.4), (160.0, 0.7))}
INTEGRATED = {"classification": "pre-integrated"}
STEEP = {"gradient_opacity": ((0.0, 0.0), (40.0, 0.7), (60.0, 0.2), (120.0, 1.0))}
OPTICS = {
    "wavelengths": [500, 600],
    "absorption": [[60, 0, 0], [255, 0.2, 0.4]],
    "scattering": [[60, 0, 0], [255, 1, 2]],
}
CLIP = clip_of(GRID)
LOOKS: dict[str, tuple[str, dict[str, Any], str]] = {
    "jittered uint16": (
        "uint16",
        {"jitter": True},
        "composite entries fixed_step gradient_none groups groups_of_bricks jitter linear march opacity over pixels "
        "ray records_storage samples segment transfer unfaded unlit unnoted unsplit voxel_u16 whole_slab "
        "bricks_double reals_double vectors_double",
    ),
    "lit, clipped": (
        "uint8",
        LIT | {"clip": clip_of(GRID), "lights": lights_in(GRID)},
        "ambient cells clip gradient kept lights lights_near phong units unjittered voxel_u8 reals",
    ),
    "maximum of float32": ("float32", {"blending": "maximum"}, "extreme numbers rows voxel_f32"),
    "average of slices": ("uint8", {"blending": "average", "renderer": "slices"}, "slices sum"),
    "first hit": ("uint8", {"blending": "first-hit"}, "first_hit"),
    "local maximum": ("uint8", {"blending": "local-maximum"}, "local_maximum"),
    "nearest, lit": ("uint8", LIT | {"interpolation": "nearest"}, "gradient_nearest lights_far nearest"),
    "cubic": ("uint8", {"interpolation": "cubic", "step": 4.0}, "cubic"),
    "cubic, an opaque surface": (
        "uint8",
        LIT | {"interpolation": "cubic", "blending": "isosurface", "isosurfaces": (215.0,)},
        "cell_cubic gradient_cubic root spline surfaces unclipped",
    ),
    "nearest, surfaces": ("uint8", SURFACES | {"interpolation": "nearest"}, "cell_nearest"),
    "surfaces": ("uint8", SURFACES, "cell_linear extremes"),
    "surfaces of uint16": ("uint16", SURFACES, ""),
    "pre-integrated, split": (
        "float32",
        INTEGRATED | {"borders": "split"},
        "front_to_back ramp ramp_slab records_uniform split",
    ),
    "hardware, lit": ("uint8", LIT | {"filter": "hardware"}, "atlas gradient_differences hardware"),
    "cubic hardware": ("float32", {"filter": "hardware", "interpolation": "cubic"}, "cubic_hardware"),
    "gradient opacity": ("uint8", STEEP, "faded magnitude"),
    "table": ("uint8", {"transfer_2d": {}}, "composite_2d table"),
    "spectral": ("uint8", {"optics": OPTICS}, "kubelka_munk two_flux"),
    "user's look": ("uint8", {"shader": "examples/looks/octants.glsl"}, "look"),
    "occluded": ("uint8", LIT | {"ambient_occlusion": {"radius": 1.1}, "step": 5.0}, "ambient_occlusion density"),
    "occluded, pre-integrated": (
        "uint8",
        LIT | INTEGRATED | {"ambient_occlusion": {"radius": 1.5}},
        "density_ramp preintegrated",
    ),
    "opacity of one half": ("uint8", {}, "crossing slope"),
    "opacity of one half, two volumes": ("uint8", {}, "slope_mixed"),
    "adaptive step": ("uint8", {"adaptive": 0.01, "step": 1.0}, "adaptive_step"),
    "coherent": ("uint8", {"frame_coherence": True}, "planes starts"),
    "layers of bricks": ("uint8", {"early_termination": 0.05}, ""),
    "two volumes": (
        "uint8",
        INTEGRATED,
        "absorbing_ramp densest groups_of_domain layers_none multi_volume volume_layer",
    ),
    "two volumes, surfaces": (
        "uint8",
        LIT | SURFACES | STEEP | {"detail": {"level": 1}},
        "absorbing classified layers level_gradient levels met surface_list",
    ),
    "volume of a flow": ("float32", {}, "lines vector"),
}
"""Type of the voxels, keys of the scene, and the files in which a probe looks."""
WITHOUT_CODE = "buffers levels_none own_box met_none no_prefetch no_profile packets pitch raycast sums"
ON_CPUS = {
    "jittered uint16": "cells_in_words cells_u16 drawn_once linear_cells skips tiles words",
    "maximum of float32": "cells_f32",
    "surfaces": "cells_u8 extremes_u8",
    "surfaces of uint16": "extremes_u16",
    "coherent": "packets_starts",
    "opacity of one half": "packets_crossing",
    "first hit": "pitches",
}
"""Looks that machine code draws, too, and the files of CPUs in which a probe looks."""
OF_16_LANES = "classified_pieces piece_rows pieces"
"""Files of CPUs whose vectors have 16 numbers."""
NOT_PROBED = (
    "profile_clock profile_counts words_wide packets_paths paths refraction "
    "bricks_integer reals_integer vectors_integer"
)
"""Of the profiler, of memory by its addresses, which are indices of nothing that the interpreter has, of rays that
bend, which are refused by what looks into shaders, and of devices without double precision, which recordings have."""
DRAWN = ("jittered uint16", "hardware, lit", "layers of bricks", "two volumes")
"""Looks that the ray caster draws on OpenGL, too, with programs that hold no probes."""
LOOSE = {"hardware, lit": 0.02, "cubic hardware": 0.02}
"""Weights of the texture unit have about 8 bits."""


def dispatches(
    look: str, folder: Path, brick: int = 8, in_units: bool = False
) -> tuple[Plan, tuple[Piece, ...], dict[Any, Any]]:
    """The plan of a look, its pieces and its bricks, or a single brick of several units."""
    dtype, keys, _ = LOOKS[look]
    if "transfer_2d" in keys:
        np.save(folder / "table.npy", np.random.default_rng(1).random((4, 6, 4)) * 0.8)
        keys = {"transfer_2d": {"path": str(folder / "table.npy")}, "opacity": None}
    if "shader" in keys:
        keys = {"shader": str(Path(__file__).parents[2] / keys["shader"])}
    voxels = [smooth(SHAPE, dtype)]
    scene = scene_of(voxels[0], camera_at("outside", GRID), size=SIZE, **{"step": 2.0} | keys)
    if "two volumes" in look:
        other = scene_of(noise(SHAPE), scene.camera, cmap=((0.0, 1, 0, 0), (1.0, 0, 1, 1))).volumes[0]
        scene, voxels = scene.model_copy(update={"volumes": (*scene.volumes, other)}), [*voxels, noise(SHAPE)]
    sources: list[Any] = [ArraySource(each, GRID) for each in voxels]
    if look == "volume of a flow":
        z, y, x = np.indices(SHAPE)
        turning = np.stack([y - 11, 13 - x, 0 * z + 4], axis=-1).astype(np.float32)
        flow = FlowSection.model_validate({"path": "flow", "show": "lic", "lic": {"length": 4.0}, "opacity": 0.5})
        scene, sources = scene.model_copy(update={"volumes": (), "flows": (flow,)}), [VectorArray(turning, GRID)]
    if "detail" in keys:
        sources[0] = Pyramid((voxels[0], voxels[0][::2, ::2, ::2]))
    if "one half" in look:
        scene = scene.model_copy(update={"image": scene.image.model_copy(update={"layers": ("depth", "normal")})})
    if in_units:
        made = scenes.prepare(scene, voxels[0], GRID, 8, ((), (), ()))
        return made.plan, (Piece(0, build_tree(made.plan.cost, 1).leaves[0].trimmed),), made.bricks
    cluster = scene.cluster.model_copy(update={"brick": brick})
    scene = scene.model_copy(update={"cluster": cluster, "automatic": False})
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, sources)
    assert share.plan is not None
    return share.plan.crossing if "one half" in look else share.plan, share.pieces, bricks


def copies(buffers: Mapping[int, np.ndarray]) -> Iterator[tuple[int, np.ndarray]]:
    return ((number, data.copy()) for number, data in buffers.items())


def executed(dispatch: Dispatch) -> dict[str, str]:
    """Execute a dispatch, and return the last place that a pixel reached in each file, as a probe names it."""
    shader, reached = Shader(dispatch.source), set[int]()
    interpreter = Interpreter(shader.program, dispatch)
    while (statement := interpreter.advance()) is not None:
        reached.add(statement.at)
    assert not interpreter.faults
    places = [shader.where(at) for at in sorted(reached)]
    return {file.removesuffix(".glsl"): f"shaders/{file}:{line}" for file, line in places}


def watches_at(shader: Shader, place: str) -> tuple[str, ...]:
    """The variables of a place that were declared last, of those that have a value."""
    (found, *_) = shader.places_at(place)
    declared = {each: each.value for each in shader.places if isinstance(each, Declare)}
    undefined = {each.variable for each, value in declared.items() if value is None}
    known = {name: each for name, each in found.names.items() if isinstance(each, Variable) and each not in undefined}
    return tuple(name for name, each in known.items() if each.kind in ("local", "in", "inout"))[-2:] or ("true",)


@pytest.mark.cover(
    "cubic, an opaque surface",
    "occluded, pre-integrated",
    "jittered uint16",
    "hardware, lit",
    "cubic",
    "two volumes, surfaces",
    "nearest, surfaces",
    "surfaces",
    "nearest, lit",
    "opacity of one half, two volumes",
    "occluded",
    "cubic hardware",
    "two volumes",
    "volume of a flow",
)
@pytest.mark.gl
@pytest.mark.parametrize("look", LOOKS)
def test_the_interpreter_and_instrumented_shaders_find_what_opengl_draws(
    look: str, context: moderngl.Context, tmp_path: Path
) -> None:
    plan, pieces, bricks = dispatches(look, tmp_path)
    rays, again = ([Crossing.behind(np.zeros(SIZE[::-1], np.float32))] * plan.march.crossing for _ in range(2))
    bound, reached, ways = LOOSE.get(look, 2e-6), dict[str, str](), list[tuple[Dispatch, Dispatch]]()
    for dispatch in recorded(plan, dict(bricks), pieces, again):
        ways.append((replace(dispatch, buffers=dict(copies(dispatch.buffers))), dispatch))
        reached |= executed(dispatch)
    if look in DRAWN:
        caster = opengl_caster(context, plan)
        caster.load(plan, dict(bricks))
        drawn = caster.draw(plan, pieces, carried=rays)[0].partial.rgba
        caster.release()
        assert close(dispatch.buffers[1].view(np.float32)[: drawn.size], drawn.ravel(), bound)

    # One program serves for the pictures and for the probes, since compiling takes longest.
    shader = Shader(dispatch.source)
    places = [reached[file] for file in LOOKS[look][2].split()]
    probes = [shader.probe(place, watches_at(shader, place), "", 1 + n % 2) for n, place in enumerate(places)]
    size = probe_bytes(probes) * 64 * int(np.prod(dispatch.groups))
    begun = replace(ways[-1][0], buffers=dict(copies(ways[-1][0].buffers)))
    mine = taken_by(Interpreter(shader.program, begun), probes)
    for begun, after in ways:
        assert after.source == dispatch.source
        instrumented = replace(begun, source=shader.instrumented(probes, BINDING))
        words = run_on(context, instrumented, BINDING, size)
        assert close(after.buffers[1].view(np.float32), begun.buffers[1].view(np.float32), bound)
    assert begun.buffers[1].view(np.float32).max() > 0.1 or rays
    if probes:
        check_taken(places, probes, mine, taken_of_words(words, probes), 50 * bound)


def close(found: np.ndarray, expected: np.ndarray, bound: float) -> bool:
    """Whether numbers differ by no more than a share of the largest."""
    return bool((np.abs(found - expected) <= bound * np.abs(expected).max()).all())


def check_taken(places: list[str], probes: list[Probe], mine: list[Taken], theirs: list[Taken], bound: float) -> None:
    """Probes of both ways come to the same lanes, and find the same numbers there."""
    for place, probe, a, b in zip(places, probes, mine, theirs, strict=True):
        assert np.array_equal(a.reached, b.reached), place
        for (name, _), x, y in zip(probe.scalars, a.values, b.values, strict=True):
            close = np.isclose(x[a.reached], y[a.reached], rtol=bound, atol=bound, equal_nan=True)
            assert close.all(), f"{place}: {name}"
    assert any(each.reached.any() for each in mine)


@pytest.mark.cover("surfaces", "coherent", "opacity of one half", "surfaces of uint16")
@pytest.mark.parametrize("look", ON_CPUS)
def test_the_interpreter_and_instrumented_shaders_find_what_machine_code_draws(
    look: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_units = "pitches" in ON_CPUS[look]
    plan, pieces, bricks = dispatches(look, tmp_path, 16, in_units)  # one brick, as others lie elsewhere
    seen: dict[str, Any] = {}
    bound = cpu_arrays.bound

    def recorded_blocks(source: ShaderSource, blocks: Mapping[str, np.ndarray]) -> Any:
        seen.update(source=source, uniforms={}, buffers={})
        for name, binding in source.blocks.items():
            if name in blocks and binding.kind != "texture":
                seen[f"{binding.kind}s"][binding.number] = np.frombuffer(blocks[name].tobytes(), np.uint8).copy()
        return bound(source, blocks)

    monkeypatch.setattr(cpu_arrays, "bound", recorded_blocks)
    caster, lanes = cpu_caster(plan), host_width().lanes
    caster.load(plan, dict(bricks))
    rays = [Crossing.behind(np.zeros(SIZE[::-1], np.float32))] * plan.march.crossing
    drawn = caster.draw(plan, pieces, carried=rays)[0].partial.rgba
    source = seen["source"]
    text = source.text.replace("local_size_x = 8, local_size_y = 8", f"local_size_x = {lanes}")
    dispatch = Dispatch(replace(source, text=text), (1, 1, 1), seen["uniforms"], dict(copies(seen["buffers"])))
    reached = executed(dispatch)
    assert drawn.max() > 0.1 or rays
    rgba = dispatch.buffers[1].view(np.float32)[: drawn.size].reshape(drawn.shape)
    assert np.abs(rgba - drawn).max() <= 2e-6 * drawn.max()

    shader = Shader(dispatch.source)
    places = [reached[file] for file in ON_CPUS[look].split()]
    places += [reached[file] for file in OF_16_LANES.split() if file in reached]
    probes = [shader.probe(place, watches_at(shader, place), "", 1 + n % 2) for n, place in enumerate(places)]
    begun = replace(dispatch, buffers=dict(copies(seen["buffers"])))
    mine = taken_by(Interpreter(shader.program, begun), probes, np.ones(lanes, bool))
    words = np.zeros(probe_bytes(probes) * lanes, np.uint8)
    blocks = addresses(seen["uniforms"], seen["buffers"] | {BINDING + 2: words}, ONE_GROUP)
    code = object_code(shader.instrumented(probes, BINDING + 2), "probed", lanes, intrinsics=False)
    function_of(code, "probed")(blocks.ctypes.data)
    check_taken(places, probes, mine, taken_of_words(words, probes), 1e-4)


def test_probes_look_into_every_file_of_the_shaders() -> None:
    """A new file needs a look in the table, in which a pixel comes to it; other tests probe geometry and jobs.

    No ray comes to those that pack pictures.
    """
    files = " ".join(
        [*(look[2] for look in LOOKS.values()), *ON_CPUS.values(), OF_16_LANES, WITHOUT_CODE, NOT_PROBED]
    ).split()
    every = [path.relative_to(shader_folder()) for path in shader_folder().rglob("*.glsl")]
    elsewhere = r"abuffer|packed|(cells|flow|jobs|pyramid|slices)/"
    assert sorted(files) == sorted(path.stem for path in every if not re.search(elsewhere, str(path)))
