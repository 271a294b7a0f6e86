from __future__ import annotations

from pathlib import Path

import moderngl
import pytest

from clusterviz.errors import DeviceError
from clusterviz.gl import shader
from clusterviz.gl.context import compile_compute
from clusterviz.gl.shader import assemble, defined_names, shader_folder
from clusterviz.spmd.source import ShaderSource


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty shader folder."""
    monkeypatch.setattr(shader, "shader_folder", lambda: tmp_path)
    return tmp_path


def put(folder: Path, **files: str) -> None:
    for name, text in files.items():
        (folder / f"{name}.glsl").write_text(text)


def test_files_and_texts_take_the_place_of_their_includes_in_order(folder: Path) -> None:
    put(folder, top='first\n#include "a.glsl"\nsecond\n#include <SLOT>\n  #include <TEXT>\nlast', a="in a", b="in b\n")
    source = assemble("top.glsl", {"SLOT": "b.glsl", "TEXT": "in text\n"})
    lines = [line for line in source.text.splitlines() if not line.startswith("#line")]
    assert lines == ["first", "in a", "second", "in b", "in text", "last"]
    assert source.names == ("top.glsl", "a.glsl", "b.glsl", "<TEXT>")


def test_line_directives_number_every_part_from_one_and_resume_the_top_level(folder: Path) -> None:
    put(folder, top='1\n2\n#include "a.glsl"\n4\n', a="a1\na2\n")
    assert assemble("top.glsl").text.splitlines() == ["1", "2", "#line 1 1", "a1", "a2", "#line 4 0", "4"]


def test_names_of_functions_structs_and_variables_are_those_that_a_file_defines(folder: Path) -> None:
    text = """struct Walk {
    int member;
};
const int FAR = min(3, 4), NEAR = 1; // far, and near
float kept[2], last;
layout(binding = 0) uniform sampler2D not_counted;
void only_declared(int x);
int walk(int a, int b) {
    int inner = 3;
}
bool is_one(int x) { return x == 1; }
"""
    put(folder, defining=text)
    assert defined_names("defining.glsl") == ("Walk", "FAR", "NEAR", "kept", "last", "walk", "is_one")


def test_nested_include_names_both_places(folder: Path) -> None:
    put(folder, top='\n#include "a.glsl"', a='void f();\n\n#include "b.glsl"', b="")
    with pytest.raises(DeviceError, match=r"a\.glsl:3: only a top-level .* included by top\.glsl:2"):
        assemble("top.glsl")


def test_missing_include_names_the_line_that_asks_for_it(folder: Path) -> None:
    put(folder, top='\n\n#include "gone.glsl"')
    with pytest.raises(DeviceError, match=r"top\.glsl:3: the shader file gone\.glsl cannot be read: No such file"):
        assemble("top.glsl")


def test_missing_top_level_file_is_named(folder: Path) -> None:
    with pytest.raises(DeviceError, match=r"gone\.glsl cannot be read"):
        assemble("gone.glsl")


def test_missing_slot_is_named_with_those_that_were_given(folder: Path) -> None:
    put(folder, top="#include <VOXEL>")
    with pytest.raises(DeviceError, match=r"top\.glsl:1: nothing given for #include <VOXEL>; given \['SCALAR'\]"):
        assemble("top.glsl", {"SCALAR": "x.glsl"})


def test_missing_folder_names_both_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "is_dir", lambda self: False)
    with pytest.raises(DeviceError, match="the shader files are missing"):
        shader_folder.__wrapped__()


@pytest.mark.parametrize(
    ("complaint", "explained"),
    [
        ("1:12(3): error: `x' undeclared", "b.glsl:12(3): error: `x' undeclared"),  # Mesa
        ("1(12) : error C1503: undefined variable", "b.glsl:12 : error C1503: undefined variable"),  # NVIDIA
        ("ERROR: 0:7: 'x' : undeclared identifier", "ERROR: a.glsl:7: 'x' : undeclared identifier"),  # AMD, Apple
        ("WARNING: 1:7: unused", "WARNING: b.glsl:7: unused"),
        ("0:1(2): error\n1:2(3): error", "a.glsl:1(2): error\nb.glsl:2(3): error"),
        ("9:1(2): error", "9:1(2): error"),  # a number that no part has
        ("link failed at 1:2", "link failed at 1:2"),
    ],
)
def test_complaints_of_all_drivers_name_the_file(complaint: str, explained: str) -> None:
    assert ShaderSource("", ("a.glsl", "b.glsl")).explain(complaint) == explained


@pytest.mark.gl
@pytest.mark.parametrize(
    ("files", "place"),
    [
        ({"a": "float f() {\n    return nowhere;\n}\n"}, r"a\.glsl:2"),
        ({"a": "float f() { return 1.0; }\n\n", "end": "nowhere = 1.0;"}, r"broken\.glsl:9"),
    ],
    ids=["in-an-included-file", "behind-the-includes"],
)
def test_broken_shader_names_file_and_line(
    context: moderngl.Context, shaders: Path, files: dict[str, str], place: str
) -> None:
    head = (shaders / "probe.glsl").read_text().splitlines()[0]
    lines = [
        head,
        "layout(local_size_x = 1) in;",
        "",
        '#include "a.glsl"',
        "",
        "",
        "void main() {",
        "",
        files.get("end", ""),
        "}",
    ]
    put(shaders, broken="\n".join(lines), a=files["a"])
    with pytest.raises(DeviceError, match=place):
        compile_compute(context, assemble("broken.glsl"))
