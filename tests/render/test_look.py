"""Looks of users: pictures against the float64 reference, and mistakes that never reach a driver."""

from __future__ import annotations

import random
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from render.looks import PATHS
from render.scenes import LIT, SHAPE, TURNED, camera_at, drawn, prepare, scene_of, smooth

from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.kernels import objects
from clusterviz.plan import look_files
from clusterviz.plan.look_files import read_look
from clusterviz.reference import render_reference
from clusterviz.render.storage import slot_of
from clusterviz.render.variant import variant_of
from clusterviz.spmd import look_checks
from clusterviz.spmd.look_checks import SIGNATURE, make_look
from clusterviz.spmd.tokens import WORD

GRID = Grid(SHAPE, (0.05, 0.07, 0.06), (-0.61, -0.83, -0.55), TURNED)
SURFACES = {"isosurfaces": ((0.6, 0.3),)}


@pytest.mark.cover
@pytest.mark.parametrize("caster", [pytest.param("gl", marks=pytest.mark.gl), "cpu"])
@pytest.mark.parametrize(
    ("look", "dtype", "bound", "keys"),
    [
        ("contours", "float32", 1e-4, {}),
        ("octants", "float32", 1e-5, {"interpolation": "cubic", "opacity": ((0.3, 0.0), (0.6, 1.0))}),
        ("boundaries", "float32", 4e-5, {**LIT, "gradient": "smooth", "gradient_opacity": ((0.0, 0.0), (2.0, 1.0))}),
        ("boundaries", "uint8", 1e-4, {"classification": "pre-integrated", "jitter": True}),
        ("octants", "float32", 1e-4, SURFACES),
        ("wild", "float32", 1e-5, {"opacity": ((0.3, 0.0), (0.6, 0.4))}),
    ],
)
def test_pictures_are_the_reference(
    request: pytest.FixtureRequest, caster: str, look: str, dtype: str, bound: float, keys: dict[str, object]
) -> None:
    where = request.getfixturevalue("context") if caster == "gl" else None
    voxels = smooth(dtype=dtype)
    opacity = {"opacity": 1.0} | keys
    scene = scene_of(
        voxels,
        camera_at("outside", GRID),
        clim=(0.1, 0.8) if dtype == "float32" else (20.0, 200.0),
        unit=0.2,
        shader=PATHS[look],
        **opacity,
    )
    expected = render_reference(scene, GRID, voxels)
    for parts in (1, 3):
        found = drawn(where, prepare(scene, voxels, GRID), parts)[0]
        assert np.ptp(expected[..., :3]) > 0.2
        assert np.abs(found - expected).max() < bound


def test_the_gradient_is_computed_where_a_look_reads_it() -> None:
    voxels = smooth()
    for look, file in (("contours", "gradient_none.glsl"), ("boundaries", "gradient.glsl")):
        scene = scene_of(voxels, camera_at("outside", GRID), shader=PATHS[look])
        plan = prepare(scene, voxels, GRID).plan
        assert file in variant_of(plan, slot_of(plan), 0).source.names


BODY = "vec4 look(float value, vec3 gradient, vec3 position) {{ {} }}"
MISTAKES = {
    "vec4 look(float value) { return vec4(1.0); }": f"look.glsl: no function look; allowed {SIGNATURE}",
    "vec3 look(float v, vec3 g, vec3 p) { return p; }": "look.glsl:1:6: look has another result",
    "vec4 look(float v, inout vec3 g, vec3 p) { return vec4(1.0); }": "look.glsl:1:6: look has another result",
    "\n  x;": "look.glsl:2:3: expected a type; found x",
    "#define A 1": "look.glsl:1:1: a preprocessor directive",
    "float state = 0.0;\n" + BODY.format("return vec4(state);"): "look.glsl:1:7: a variable outside of functions",
    "void main() {}\n" + BODY.format("return vec4(0.0);"): "look.glsl:1:6: a look has no main",
    "layout(std430, binding = 0) buffer A { float a[]; };\n"
    + BODY.format("return vec4(a[0]);"): "look.glsl:1:36: a look reads no blocks",
    BODY.format("return vec4(0.0); barrier();"): "look.glsl:1:74: not in a look; found barrier",
    BODY.format("return vec4(float(gl_WorkGroupID.x));"): "not in a look; found gl_WorkGroupID",
    BODY.format("float a[2000]; return vec4(a[0]);"): "too large arrays; found 2000 numbers; allowed up to 1024",
    BODY.format("float step = 1.0; return vec4(step(0.0, value));"): "step is a variable, and hides the function",
    BODY.format("float value = 1.0; return vec4(value);"): "value is declared twice",
    BODY.format("if (value > 0.0) return vec4(1.0);"): "look may end without a value",
    BODY.format("return look(value, gradient, position);"): "look calls itself",
    "float f0(float x) { return x * x; }\n"
    + "\n".join(f"float f{n}(float x) {{ return f{n - 1}(x) + f{n - 1}(x + 1.0); }}" for n in range(1, 31))
    + BODY.format("return vec4(f30(value));"): "too many operations",
    "float f(float x) { return x; }\nconst float A = f(1.0);\n"
    + BODY.format("return vec4(A);"): "look.glsl:2:13: a constant that calls",
    BODY.format(f"return vec4({'-(' * 400}value{')' * 400});"): "nested too deeply",
    BODY.format("return texture(value);"): "texture has no such parameters",
}


@pytest.mark.parametrize(("text", "message"), MISTAKES.items(), ids=MISTAKES.values())
def test_a_mistake_is_one_message_with_its_place(text: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as error:
        make_look(text, "look.glsl")
    assert "\n" not in str(error.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.glsl").write_bytes(b"\xff\x00")
    (tmp_path / "b.glsl").write_bytes(b"x" * 100_000)
    for name, what in (("a.glsl", "not a text"), ("b.glsl", "too long"), ("c.glsl", "cannot read the shader: No such")):
        with pytest.raises(InputError, match=f"{name}: {what}"):
            read_look(str(tmp_path / name))


def test_no_change_of_a_look_ends_in_another_error() -> None:
    """Words of looks that are left out, doubled, exchanged or replaced."""
    texts = [Path(path).read_text() for path in PATHS.values()]
    words = [found[0] for text in texts for found in WORD.finditer(text)]
    draw, accepted = random.Random(2), 0
    for _ in range(400):
        changed = [found[0] for found in WORD.finditer(draw.choice(texts))]
        for _ in range(draw.randrange(1, 4)):
            at = draw.randrange(len(changed))
            changed[at : at + 1] = draw.choice([[], [changed[at]] * 2, [draw.choice(words)]])
        with suppress(InputError):
            make_look("".join(changed), "look.glsl")
            accepted += 1
    assert 10 < accepted < 200


def test_a_look_is_checked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What became of it is kept; a mistake is not."""
    path, (kept, changed) = tmp_path / "own.glsl", (tmp_path / "kept", "const int A = 3;\n")
    path.write_text(BODY.format("return vec4(value);"))
    monkeypatch.setattr(objects, "folders", lambda: (kept,))
    first = read_look(str(path))
    assert [file.suffix for file in kept.iterdir()] == [".json"]
    monkeypatch.setattr(look_checks, "parse", {}.popitem)
    look_files._read.cache_clear()
    assert read_look(str(path)) == first
    path.write_text(changed + path.read_text())
    with pytest.raises(InputError, match="popitem"):
        read_look(str(path))
    monkeypatch.undo()
    path.write_text("x")
    for _ in range(2):
        with pytest.raises(InputError, match="expected"):
            read_look(str(path))
