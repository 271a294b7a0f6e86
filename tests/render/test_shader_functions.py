"""The shaders' functions one by one, as they stand in the assembled program, against float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import moderngl
import numpy as np
import pytest
from render.scenes import BUMP, CAMERAS, SHAPE, camera_at, noise, prepare, scene_of
from render.variants import alone

from clusterviz.content.transfer import transfer_function
from clusterviz.data.source import Grid
from clusterviz.gl.context import compile_compute
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.plan import Plan
from clusterviz.reference.preintegrated import integrate
from clusterviz.reference.sample import nearest, trilinear
from clusterviz.render.frame_block import frame_block
from clusterviz.render.storage import Slot, slot_of
from clusterviz.render.variant import Variant, variant_of
from clusterviz.spmd.adversary import DRIVERS
from clusterviz.spmd.machine_code import ADVERSARY_VARIABLE, addresses, chosen_driver, function_of, object_code
from clusterviz.spmd.source import ShaderSource

GRID = Grid(SHAPE)
PROBE = """
layout(std430, binding = 9) readonly buffer GivenBlock {{ vec4 given[]; }};
layout(std430, binding = 10) writeonly buffer FoundBlock {{ vec4 found[]; }};
vec4 probe(vec4 x) {{ {body} }}
void main() {{
    uint i = gl_WorkGroupID.x * 64u + gl_LocalInvocationIndex;
    if (i < {count}u) found[i] = probe(given[i]);
}}
"""
PLAIN = alone("linear", Slot((16, 16, 16), "f32", False), 16, 0, 0)
CPU_LANES = 16, 8, 4
Device = moderngl.Context | int
"""OpenGL, or the lanes of a CPU's vectors."""


@pytest.fixture(params=[pytest.param("opengl", marks=pytest.mark.gl), *CPU_LANES, *DRIVERS])
def device(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Device:
    """A device, or a CPU for which shaders are compiled as an adversarial driver would."""
    if request.param in DRIVERS:
        monkeypatch.setenv(ADVERSARY_VARIABLE, request.param)
        return CPU_LANES[0]
    return request.param if request.param in CPU_LANES else request.getfixturevalue("context")


def evaluate(
    device: Device, body: str, given: np.ndarray, variant: Variant = PLAIN, **blocks: np.ndarray
) -> np.ndarray:
    """float32 (n, 4): what `body` returns for each x of `given` (n, up to 4), in a variant's program.

    `u0`, `u1`, … are its uniform blocks, and `b3`, `b4`, … its buffers by binding.
    """
    points = np.zeros((len(given), 4), np.float32)
    points[:, : given.reshape(len(given), -1).shape[1]] = given.reshape(len(given), -1)
    text = variant.source.text.partition("void main()")[0] + PROBE.format(body=body, count=len(points))
    source, groups, found = replace(variant.source, text=text), -(-len(points) // 64), np.zeros_like(points)
    if isinstance(device, int):
        uniforms, buffers = (
            {int(k[1:]): np.ascontiguousarray(b) for k, b in blocks.items() if k[0] == kind} for kind in "ub"
        )
        system = np.zeros(7, np.uint32)
        table = addresses(uniforms, buffers | {9: points, 10: found}, system)
        for system[0] in range(groups):
            for system[6] in range(0, 64, device):
                on_cpu(source, device, chosen_driver())(table.ctypes.data)
        return found
    program = compile_compute(device, source)
    held = {name: device.buffer(np.ascontiguousarray(data).tobytes()) for name, data in blocks.items()}
    for name, buffer in held.items():
        (buffer.bind_to_uniform_block if name[0] == "u" else buffer.bind_to_storage_buffer)(int(name[1:]))
    source_buffer, target = device.buffer(points.tobytes()), device.buffer(reserve=points.nbytes)
    source_buffer.bind_to_storage_buffer(9)
    target.bind_to_storage_buffer(10)
    program.run(groups)
    device.finish()
    found = np.frombuffer(target.read(), np.float32).reshape(-1, 4)
    for made in (source_buffer, target, program, *held.values()):
        made.release()
    return found


@cache
def on_cpu(source: ShaderSource, lanes: int, driver: str) -> Callable[[int], None]:
    return function_of(object_code(source, "probe", lanes), "probe")


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest error, as a share of what is expected; nothing may differ where 0 is."""
    assert not found[expected == 0].any()
    wanted = expected != 0
    return float(np.abs(found[wanted] / expected[wanted] - 1).max())


ALPHAS = np.unique(
    np.float32(
        np.concatenate(
            [[0, 0.29, 0.5, 1 - 2.0**-24], np.geomspace(1e-30, 1, 3000), 1 - np.geomspace(2.0**-24, 0.9, 3000)]
        )
    )
)
ALPHAS = ALPHAS[ALPHAS <= 1 - 2.0**-24]


def test_optical_depth_of_every_opacity(device: Device) -> None:
    found = evaluate(device, "return vec4(optical_depth(x.x));", ALPHAS)[:, 0]
    assert relative(found, -np.log1p(-ALPHAS.astype(np.float64))) <= 4e-7


def test_absorption_of_every_depth(device: Device) -> None:
    depths = np.float32(np.concatenate([[0.0], np.geomspace(1e-30, 1e30, 6000), np.linspace(0, 100, 3000)]))
    found = evaluate(device, "return vec4(absorbed(x.x));", depths)[:, 0]
    assert relative(found, -np.expm1(-depths.astype(np.float64))) <= 4e-7


def test_sums_of_many_faint_terms_lose_none(device: Device) -> None:
    """Each alone is less than half of the last bit of the sum."""
    body = "Sum sum = Sum(vec4(1.0), vec4(0.0)); for (int n = 0; n < 10000; ++n) add(sum, x); return sum.high;"
    np.testing.assert_allclose(evaluate(device, body, np.full(4, 1e-8))[:, 0], 1.0001, rtol=1.2e-7)


@pytest.mark.parametrize("units", [1e-6, 1e-3, 0.1, 1.0, 3.0, 100.0, 1e4])
def test_slab_opacity_of_every_opacity_and_length(device: Device, units: float) -> None:
    alphas = np.union1d(ALPHAS[(ALPHAS == 0) | (ALPHAS >= 1e-8)], np.float32([1e-8, 1 - 1e-7]))
    units = float(np.float32(units))
    found = evaluate(
        device, "return vec4(slab_opacity(x.x, x.y));", np.column_stack([alphas, np.full(len(alphas), units)])
    )
    assert relative(found[:, 0], -np.expm1(units * np.log1p(-alphas.astype(np.float64)))) <= 1e-6


STEEP = ((0.0, 0.0), (0.3, 0.0), (0.3, 0.9), (0.31, 0.9), (0.31, 0.0), (0.6, 0.0), (0.600001, 1.0), (1.0, 0.2))
MANY = tuple((0.5 + 1e-5 * k, k % 2 * 0.4) for k in range(60))


@pytest.mark.cover
@pytest.mark.parametrize("opacity", [BUMP, STEEP, MANY, 0.3], ids=["bump", "steep", "many-close", "number"])
@pytest.mark.parametrize("uniform_bytes", [0, 1 << 16], ids=["storage", "block"])
def test_segment_of_every_scalar_is_the_last_that_starts_at_or_below_it(
    device: Device, opacity: object, uniform_bytes: int
) -> None:
    voxels = noise()
    plan = prepare(scene_of(voxels, camera_at("outside", GRID), opacity=opacity, clim=(0.0, 1.0)), voxels).plan
    slot = slot_of(plan)
    starts = plan.volume.segments.records["start"]
    below = np.nextafter(starts[1:], -1)
    below[starts[1:] == 0] = -np.finfo(np.float32).tiny  # drivers may take subnormal numbers for 0
    scalars = np.concatenate([np.linspace(-1, 2, 3001), starts[1:], below, [-1e30, 1e30]])
    variant, buffers = variant_of(plan, slot, uniform_bytes), shader_buffers(plan, slot)
    block = np.frombuffer(plan.volume.segments.records.tobytes().ljust(max(variant.block_bytes, 16), b"\0"), np.uint8)
    found = evaluate(device, "return vec4(segment_of(x.x));", scalars.astype(np.float32), variant, u1=block, **buffers)[
        :, 0
    ]
    assert np.array_equal(found, np.searchsorted(starts, scalars.astype(np.float32), side="right") - 1)


def shader_buffers(plan: Plan, slot: Slot, box: BrickBox | None = None) -> dict[str, np.ndarray]:
    """The frame block and the transfer function, by binding."""
    box = box or BrickBox((0, 0, 0), plan.layout.counts_zyx)
    frame = frame_block(plan, box, Rect(0, 0, *plan.view.size), slot)
    return {"u0": frame, "b4": plan.volume.segments.buckets, "b5": plan.volume.segments.records}


@pytest.mark.cover
@pytest.mark.parametrize("slab", [1.0, 0.05, 20.0])
def test_classification_follows_the_transfer_function(device: Device, slab: float) -> None:
    voxels = noise()
    scene = scene_of(voxels, camera_at("outside", GRID), clim=(0.0, 1.0), unit=1.0, step=slab)
    plan, transfer = prepare(scene, voxels).plan, transfer_function(scene.volumes[0])
    slot = slot_of(plan)
    scalars = np.linspace(-0.5, 1.5, 20001).astype(np.float32)
    body = "Segment s = segment_at(x.x); return vec4(s.colour, s.opacity);"
    found = evaluate(device, body, scalars, variant_of(plan, slot, 0), **shader_buffers(plan, slot))
    expected = -np.expm1(-slab * transfer.extinction(scalars))
    assert np.abs(found[:, 3] - expected).max() <= 2e-6 * expected.max()
    assert np.abs(found[:, :3] - transfer.colour(scalars)).max() <= 1e-6


def test_deep_slab_of_many_colours_shows_its_front(device: Device) -> None:
    """Pieces of the transfer function hide one another, so that few of them may be taken as one."""
    rng, voxels = np.random.default_rng(8), noise()
    colours = tuple((x, *rng.random(3)) for x in np.linspace(0, 1, 33))
    keys = {"classification": "pre-integrated", "cmap": colours, "opacity": ((0.0, 0.3), (1.0, 0.9))}
    scene = scene_of(voxels, camera_at("outside", GRID), clim=(0.0, 1.0), unit=1.0, **keys)
    plan, transfer = prepare(scene, voxels).plan, transfer_function(scene.volumes[0])
    slot, ends = slot_of(plan), rng.random((2000, 2)).astype(np.float32)
    given = np.column_stack([ends, 10 ** rng.uniform(-1, 1.5, 2000)]).astype(np.float32)
    body = "return integrated(class_at(x.x), class_at(x.y), x.z);"
    buffers = shader_buffers(plan, slot) | {"b0": plan.volume.segments.sums}
    found = evaluate(device, body, given, variant_of(plan, slot, 0), **buffers)
    colour, depth = integrate(transfer, *given[:, :2].T.astype(float), given[:, 2].astype(float))
    expected = np.append(colour, -np.expm1(-depth)[:, None], axis=1)
    assert np.abs(found - expected).max() <= 1.5e-3


@pytest.mark.cover
@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16", "float32"])
def test_field_in_a_brick_is_that_of_its_samples(device: Device, dtype: str, interpolation: str) -> None:
    voxels = noise((8, 9, 12), np.dtype(dtype))
    scene = scene_of(voxels, camera_at("outside", Grid(voxels.shape)), interpolation=interpolation)
    prepared = prepare(scene, voxels, brick=16)
    plan = prepared.plan
    slot = slot_of(plan)
    points = np.random.default_rng(2).random((4000, 3)) * (11, 8, 7)
    points[:512] = np.indices((8, 8, 8)).reshape(3, -1).T  # on samples
    points = points.astype(np.float32)
    packed = slot.pack(plan.volume.encoding.encode(prepared.bricks[0, 0, 0].samples[0]))
    body = "return vec4(scalar_at(0, ivec3(x.xyz), x.xyz - floor(x.xyz)));"
    found = evaluate(device, body, points, variant_of(plan, slot, 0), b7=packed, **shader_buffers(plan, slot))[:, 0]
    sample = trilinear if interpolation == "linear" else nearest
    low, high = scene.volumes[0].clim
    expected = (sample(voxels, *points.T.astype(np.float64))[0] - low) / (high - low)
    assert np.abs(found - expected).max() <= 1e-6


@pytest.mark.cover
@pytest.mark.parametrize(("camera", "jitter"), [*((camera, False) for camera in CAMERAS), ("outside", True)])
def test_first_slab_of_a_box_is_found_from_every_camera(device: Device, camera: str, jitter: bool) -> None:
    """The estimate against a search through all slabs of the ray, for each brick as a box."""
    voxels = noise()
    plan = prepare(scene_of(voxels, camera_at(camera, GRID), step=0.7, jitter=jitter), voxels, brick=11).plan
    slot = slot_of(plan)
    width, height = plan.view.size
    pixels = np.indices((height, width)).reshape(2, -1).T[:, ::-1]
    body = """
    Ray ray = ray_through(ivec2(x.xy));
    int first = ray.slabs, owned_slabs = 0;
    for (int k = ray.slabs - 1; k >= 0; --k) if (owned(cell_of(midpoint(ray, k)))) { first = k; ++owned_slabs; }
    return vec4(first_owned(ray), first, owned_slabs, ray.slabs);"""
    counts, slabs = np.zeros(len(pixels)), np.zeros(len(pixels))
    for index in np.ndindex(*plan.layout.counts_zyx):
        box = BrickBox(index, tuple(i + 1 for i in index))
        found = evaluate(device, body, pixels, variant_of(plan, slot, 0), **shader_buffers(plan, slot, box))
        assert np.array_equal(found[:, 0], found[:, 1]), index
        counts, slabs = counts + found[:, 2], found[:, 3]
    assert slabs.max() > 20
    assert np.array_equal(counts, slabs), "every slab belongs to one box"
