"""The front end of the compiler for CPUs: it reads what the product draws with, and says where a mistake is."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

import llvmlite.binding
import pytest
from render.variants import CPU_VARIANTS, VARIANTS

from clusterviz.errors import InputError
from clusterviz.gl.driver_needs import AMPLE, needs_of
from clusterviz.render.variant import Lanes, Variant
from clusterviz.spmd.codegen import Generator
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource

KINDS = {"sampler": "texture"}
SLOW = "linear u16, isosurface, 16 surfaces, 0 lights"


def covering(variants: Iterable[tuple[str, Variant]]) -> Iterator[tuple[str, Variant]]:
    """Few variants that have all files of all of them."""
    files = {name: ({*one.source.names}, one) for name, one in variants}
    missing = set[str]().union(*(own for own, _ in files.values()))
    while missing:
        best = max(files, key=lambda name: len(files[name][0] & missing))
        missing -= files[best][0]
        yield best, files[best][1]


def distinct(takes_all: bool) -> list[tuple[str, Variant]]:
    """Variants that differ in their files; without all of them, those that have each file."""
    every = VARIANTS | CPU_VARIANTS
    if not takes_all:
        return list(covering((name, one) for name, one in every.items() if name != SLOW))
    return list({one.source.names: (name, one) for name, one in every.items()}.values())


def test_every_combination_of_files_is_understood(takes_all: bool) -> None:
    for name, variant in distinct(takes_all):
        source = variant.source
        program = parse(source)
        found = {(KINDS.get(one.kind, one.kind), one.binding) for one in program.blocks}
        assert {(one.kind, one.number) for one in source.blocks.values()} == found, name
        assert program.functions["main"][0].body is not None, name
        assert program.local_size == (8, 8, 1), name
        assert next(block for block in program.blocks if block.name == "frameBlock").binding == 0, name
        needs = needs_of(program)
        assert not needs.beyond(AMPLE), name
        assert needs.storage_blocks <= 8 or variant.profile, f"{name}: GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS may be 8"


def test_every_file_becomes_code_for_cpus(takes_all: bool) -> None:
    """Of variants that read no textures through filters, which CPUs do not."""
    found = [
        (name, replace(one, cpu=Lanes(8))) for name, one in distinct(takes_all) if "hardware" not in one.volume.filter
    ]
    for _, variant in covering(found):
        llvmlite.binding.parse_assembly(Generator(parse(variant.source), 8, {}).text("f")).verify()


MISTAKES = {
    "float x = 1.0": "look.glsl:1:14: expected ;; found the end",
    "void main() { x = 1.0; }": "look.glsl:1:15: x is not declared",
    "void main() { int x = 1.5; }": "look.glsl:1:19: the value has another type; found float; allowed int",
    "void main() {\n  float x = 1;\n  vec3 y = x * vec2(1.0);\n}": "look.glsl:3:8: the value has another type",
    "void main() { vec3 y = vec2(1.0) + vec3(1.0); }": "operator + has no such operands; found vec2 and vec3",
    "struct A { float b; };\nfloat f(A a) { return a.c; }": "look.glsl:2:25: A has no member c; allowed b",
    "float f(vec2 a) { return a.z; }": "vec2 has no component z",
    "float f() { float a[3]; return a[3]; }": "an index outside of the array; found 3; allowed 0 to 2",
    "float f(float a) { return f(a); }\nvoid main() { f(1.0); }": "f calls itself: recursion is outside of the subset",
    "float f(float a);\nvoid main() { f(1.0); }": "look.glsl:2:15: f is called, but has no body",
    "float f(float a) { return 1.0; }\nvoid main() { f(1.0, 2.0); }": "f has no such parameters; found float, float",
    "void f(int n) {\n  dvec3 a;\n  a[n] = 1.0LF;\n}": (
        "look.glsl:3:4: a component is assigned by an index that is not constant; found dvec3"
    ),
    "layout(std430, binding = 0) buffer A { vec4 b[]; };\nvoid f(int n) { b[n].x = 1.0; b[n][n] = 1.0; }": (
        "look.glsl:2:35: a component is assigned by an index that is not constant; found vec4"
    ),
    "void f(out int a) {}\nvoid main() { f(3); }": "this cannot be assigned; found an expression",
    "const int N = 3;\nvoid main() { N = 4; }": "look.glsl:2:15: this cannot be assigned",
    "layout(std140, binding = 0) uniform A { vec4 b; };\nvoid main() { b.x = 1.0; }": "cannot be assigned; found A",
    "void main() { float x = clamp(1.0); }": "clamp has no such parameters; found float",
    "void main() { float x = imageLoad(1.0); }": "imageLoad is not declared, or outside of the subset",
    "void main() { do {} while (true); }": "look.glsl:1:15: this word of GLSL is outside of the subset; found do",
    "void f(float a[3]) {}": "look.glsl:1:15: an array as a parameter is outside of the subset",
    "void f() { float a[]; }": "a variable of type float[]",
    "void f() { float a[2], b[2];\na = b; }": "look.glsl:2:3: an array as a whole cannot be assigned",
    "struct A { float b[3]; };\nfloat f(A a) { return a.b[0]; }": "look.glsl:2:26: an array inside of another value",
    "struct A { float a[60000]; float b[60000]; };": "a type of too many numbers; found 120000; allowed up to 65536",
    "void f() { vec4 a[1 << 30]; }": "look.glsl:1:19: a type of too many numbers",
    "int f(int x) { return x / 0; }": "look.glsl:1:25: division of an integer by 0",
    "int f(int x) { if (x > 0) return 1; }": "look.glsl:1:5: f may end without a value",
    "int x = 99999999999;": "no such number of 32 bits; found 99999999999",
    f"float x = {'(' * 2000}1.0{')' * 2000};": "nested too deeply; found (",
    "float f(float a) { return a.length(); }": "the length of this is not known; found float",
    "void main() { if (1) return; }": "the condition has another type; found int; allowed bool",
    "float f() { return; }": "return with a value of another type; found no value",
    "#if 1\n#endif": "look.glsl:1:1: a preprocessor directive outside of the subset; found if",
    "void main() { float x = 1.0 @ 2.0; }": "look.glsl:1:29: this character has no meaning; found @",
    "#line 7 1\nint x = y;": "part.glsl:7:9: y is not declared",
    "void main() { break; }": "break outside of a loop",
    "int a, a;": "a is declared twice",
    "void f(float return) {}": "look.glsl:1:14: this word is GLSL's own; found return",
    "float f(float vec2) { return 1.0; }": "look.glsl:1:15: vec2 is declared twice",
    "void f() { float a = max(1.0, 2.0,); }": "look.glsl:1:35: expected an expression; found )",
}


@pytest.mark.parametrize(("text", "message"), MISTAKES.items(), ids=MISTAKES.values())
def test_a_mistake_is_one_message_with_its_place(text: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as error:
        parse(ShaderSource(text, ("look.glsl", "part.glsl")))
    assert re.match(r"(look|part)\.glsl:\d+:\d+: ", str(error.value))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("void f() {}", "look.glsl:1:1: no function main"),
        (
            "layout(binding = 0) uniform sampler3D a;\nvoid main() { vec4 b = texture(a, vec3(0.0)); }",
            "look.glsl:2:24: CPUs do not filter textures; found texture; allowed texelFetch",
        ),
        (f"void main() {{ float x = 1.0{' + 1.0' * 2000}; }}", "look.glsl:1:6: nested too deeply"),
    ],
)
def test_what_only_gpus_can_do_is_one_message(text: str, message: str) -> None:
    program = parse(ShaderSource(text, ("look.glsl",)))
    with pytest.raises(InputError, match=re.escape(message)):
        Generator(program, 4, {}).text("f")


def test_functions_that_call_one_another_often_are_checked_once() -> None:
    calls = [f"void f{n}() {{ f{n - 1}(); f{n - 1}(); }}" for n in range(1, 60)]
    assert len(parse(ShaderSource("\n".join(["void f0() {}", *calls]), ("look.glsl",))).functions) == 60
