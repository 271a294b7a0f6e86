"""Numbers that decide which slabs a box owns: integers give those of double precision, bit for bit."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import LIT, SHAPE, camera_at, clip_of, drawn, noise, prepare, scene_of
from render.test_shader_functions import CPU_LANES, PLAIN, Device, evaluate
from render.variants import VARIANTS

from clusterviz.data.source import Grid
from clusterviz.errors import DeviceError
from clusterviz.gl.reals import ENVIRONMENT, FORMS
from clusterviz.render import opengl
from clusterviz.render.frame_block import FRAME
from clusterviz.render.variant import Variant
from clusterviz.spmd.adversary import DRIVERS
from clusterviz.spmd.machine_code import ADVERSARY_VARIABLE

Doubles = np.ndarray[Any, np.dtype[np.float64]]
Where = Callable[[str | int], Device]
OPENGL = pytest.param("opengl", marks=pytest.mark.gl)
DEVICES = CPU_LANES[0], OPENGL, *DRIVERS
INTEGER = replace(PLAIN, reals="integer")
WIDTH = 128
DOUBLE, COMMENT = re.compile(r"\b(double|dvec[234]|unpackDouble2x32)\b|\dLF"), re.compile(r"//.*")
DECISIONS = """
    Ray ray = ray_through(ivec2(x.xy));
    int first = first_owned(ray), end = slabs_in_box(ray, first).y;
    uint hash = uint(ray.slabs);
    for (int n = 0; n < 6; ++n) {
        int k = n < 4 ? (ray.slabs - 1) * n / 3 : n == 4 ? first : end;
        if (k < 0 || k >= ray.slabs) continue;
        Real3 at = midpoint(ray, k);
        ivec3 cell = cell_of(at);
        uvec3 bits = floatBitsToUint(offset_from(cell, at));
        hash = (hash ^ uint(cell.x * 73 + cell.y * 1031 + cell.z * 40961)) * 0x9e3779b1u;
        hash = (hash ^ (bits.x + 3u * bits.y + 7u * bits.z)) * 0x9e3779b1u;
    }
    return vec4(float(first), float(end), float(hash >> 8), ray.last_share);"""
"""The first slab of a box and the one behind its last, and a number that depends on cells and offsets of midpoints."""
ARITHMETIC = {
    "sum_of(a, b)": lambda n, a, b: a + b,
    "difference(a, b)": lambda n, a, b: a - b,
    "product(a, b)": lambda n, a, b: a * b,
    "quotient(a, b)": lambda n, a, b: a / b,
    "root(magnitude(a))": lambda n, a, b: np.sqrt(np.abs(a)),
    "fused(n, a, b)": lambda n, a, b: [
        float(int(k) * Fraction(x) + Fraction(y)) for k, x, y in zip(n, a, b, strict=True)
    ],
    "larger(a, b)": lambda n, a, b: np.maximum(a, b),
    "real(floor_of(a))": lambda n, a, b: np.floor(a).clip(-(2.0**31), 2.0**31 - 1),
    "real(ceiling_of(a))": lambda n, a, b: np.ceil(a).clip(-(2.0**31) + 1, 2.0**31 - 1),
    "real(to_float(a))": lambda n, a, b: a.astype(np.float32).astype(np.float64),
}


@pytest.fixture
def where(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Where:
    """Function that makes a device the one on which programs run: lanes of a CPU, OpenGL, or an adversarial driver."""

    def chosen(device: str | int) -> Device:
        if device in DRIVERS:
            monkeypatch.setenv(ADVERSARY_VARIABLE, str(device))
            return CPU_LANES[0]
        return device if isinstance(device, int) else request.getfixturevalue("context")

    return chosen


def pairs() -> tuple[Doubles, Doubles]:
    """Numbers of all sizes, and close ones, whose differences and roundings are hard."""
    rng = np.random.default_rng(5)
    a = rng.choice([-1.0, 1.0], 6000) * rng.uniform(1, 2, 6000) * 2.0 ** rng.integers(-30, 31, 6000)
    b = rng.choice([-1.0, 1.0], 6000) * rng.uniform(1, 2, 6000) * 2.0 ** rng.integers(-90, 91, 6000)
    b[1000:3000] = a[1000:3000] * (1 + rng.integers(-40, 41, 2000) * 2.0**-52)
    a[3000:4000], b[3000:4000] = np.round(a[3000:4000]), rng.integers(1, 300, 1000)
    a[4000:4500] = np.round(a[4000:4500]) + rng.choice([0, 2.0**-26, -(2.0**-40), 0.5], 500)
    a[:8] = 0.0, -0.0, 1.0, -1.0, 2.0**30, 2.0**53 - 1, 1 + 2.0**-24, 1 + 2.0**-24 + 2.0**-52
    return a, b


@pytest.mark.cover
@pytest.mark.parametrize("device", DEVICES)
def test_integers_compute_as_double_precision_does(device: str | int, where: Where) -> None:
    a, b = pairs()
    words = np.stack([a, b], axis=1).view(np.float32)
    choices = "".join(f"if (of == {number}) found = {body};\n" for number, body in enumerate(ARITHMETIC))
    text = f"""
        Real a = floatBitsToUint(x.xy), b = floatBitsToUint(x.zw), found = ZERO;
        int at = int(gl_WorkGroupID.x * 64u + gl_LocalInvocationIndex);
        int of = at / {len(a)}, n = at % {len(a)} % 5 * 40961 - 3;
        {choices}
        return vec4(uintBitsToFloat(found), 0.0, 0.0);"""
    given = np.tile(words, (len(ARITHMETIC), 1))
    rows = evaluate(where(device), text, given, INTEGER)[:, :2].copy().view(np.float64).reshape(len(ARITHMETIC), -1)
    n = np.arange(len(a)) % 5 * 40961 - 3
    for (body, exact), found in zip(ARITHMETIC.items(), rows, strict=True):
        expected = np.asarray(exact(n, a, b), np.float64)
        assert np.array_equal(found, expected), (body, np.flatnonzero(found != expected)[:5])


def random_frame(rng: np.random.Generator, kind: int) -> np.ndarray[Any, Any]:
    """Return the block of a random view, of a box in a volume: any; along the axes, on faces; or from far away."""
    record, on_faces = np.zeros(1, FRAME), kind in (1, 2)
    cells = rng.integers(100, 300, 3)
    low, high = rng.integers(0, cells // 2 + 1), rng.integers(cells // 2, cells) + 1
    record["cells"], record["box_begin"][0, :3], record["box_end"][0, :3] = (*cells, 64), low, high
    unit, parallel = 10.0 ** rng.uniform(-9, 9), kind in (1, 3)
    turned = np.eye(3)[rng.permutation(3)] if on_faces else np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axes = turned * rng.choice([-1, 1], (3, 1)) * rng.uniform(0.3, 3, 3) / unit
    right, forward = np.linalg.norm(axes[0]), axes[2] / np.linalg.norm(axes[2])
    away = 10.0 ** rng.uniform(1, 6) if kind == 4 else rng.uniform(0.1, 3)
    eye = cells / 2 + rng.normal(size=3) * cells * 0.1 - forward * away * max(cells)
    record["eye"][0, :3] = np.round(eye) if on_faces else eye
    for name, axis in zip(("right", "up", "forward"), axes, strict=True):
        record[name][0, :3] = axis
    pixel = 1 / right if kind == 1 else max(cells) / WIDTH / right if parallel else 1 / WIDTH / max(away, 0.3)
    record["lens"] = pixel, WIDTH / 2 + 0.5 * on_faces, WIDTH / 2, parallel
    record["extent"] = *cells, unit * 10 ** rng.uniform(-1, 0.5)
    return record


@pytest.mark.gl
def test_boxes_own_the_same_slabs_of_many_rays(context: moderngl.Context, takes_all: bool) -> None:
    """OpenGL with integers against this CPU's double precision: of a million rays, or of a sixth of them."""
    rng, views = np.random.default_rng(3), 62 if takes_all else 10  # of 16,384 rays each
    pixels, owning = np.indices((WIDTH, WIDTH)).reshape(2, -1).T[:, ::-1], 0
    for n in range(views):
        frame = random_frame(rng, n % 5).view(np.uint8)
        expected = evaluate(CPU_LANES[0], DECISIONS, pixels, PLAIN, u0=frame)
        found = evaluate(context, DECISIONS, pixels, INTEGER, u0=frame)
        assert np.array_equal(found, expected), n
        owning += np.count_nonzero(found[:, 0] < found[:, 1])
    assert owning > views * WIDTH**2 / 6


@pytest.mark.cover
@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS)
def test_variants_without_double_precision_have_none(variant: Variant) -> None:
    text = COMMENT.sub("", replace(variant, reals="integer").source.text)
    assert bool(DOUBLE.search(text)) == bool(variant.needs_doubles or variant.split)


@pytest.mark.long
@pytest.mark.gl
def test_pictures_are_the_same(context: moderngl.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    voxels, grid = noise(), Grid(SHAPE)
    look = {"jitter": True, **LIT, "clip": clip_of(grid)}
    prepared = prepare(scene_of(voxels, camera_at("inside", grid), **look), voxels)
    pictures = []
    for form in FORMS:
        monkeypatch.setenv(ENVIRONMENT, form)
        pictures.append(drawn(context, prepared, parts=2)[0])
    assert np.abs(pictures[0] - pictures[1]).max() <= 1e-7
    assert pictures[0][..., 3].max() > 0.1


@pytest.mark.gl
def test_what_needs_double_precision_is_named(context: moderngl.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "has_doubles", lambda context: False)
    monkeypatch.setenv(ENVIRONMENT, "integer")
    voxels, camera = noise(), camera_at("outside", Grid(SHAPE))
    plan = prepare(scene_of(voxels, camera, classification="pre-integrated", frame_coherence=True), voxels).plan
    with pytest.raises(DeviceError, match=r"no double precision.*needed by: pre-integrated slabs, frame coherence"):
        opengl.opengl_caster(context, plan)
