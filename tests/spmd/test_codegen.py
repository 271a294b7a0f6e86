"""Generated code, and the interpreter, lane by lane: what lanes that part do is what each would do alone."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.kernels.objects import CPU_VARIABLE, OPTIMIZE_VARIABLE, has_features, machine, optimizes
from clusterviz.render.storage import HEADER_WORDS
from clusterviz.scene.values import Scene
from clusterviz.spmd import codegen
from clusterviz.spmd.codegen import Generator
from clusterviz.spmd.interpreter import Dispatch, Interpreter
from clusterviz.spmd.intrinsics import BELOW
from clusterviz.spmd.machine_code import addresses, code_of, code_sources, function_of, object_code, texture_block
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource

PROGRAM = """
layout(std430, binding = 0) readonly buffer GivenBlock {{ int given[]; }};
layout(std430, binding = 1) writeonly buffer FoundBlock {{ int found[]; }};
layout(std430, binding = 7) readonly buffer VoxelsBlock {{ uint voxels[]; }};
layout(std430, binding = 9) readonly buffer PiecesBlock {{ float piece_table[]; }};
uvec2 words_at(int brick, int word, int more) {{ int n = brick + word + more; return uvec2(voxels[n], voxels[n + 1]); }}
uint least_bytes(uint a, uint b) {{ return min(a & 255u, b & 255u) | min(a >> 8, b >> 8) << 8; }}
uint most_bytes(uint a, uint b) {{ return max(a & 255u, b & 255u) | max(a >> 8, b >> 8) << 8; }}
uint least_halves(uint a, uint b) {{ return min(a & 65535u, b & 65535u) | min(a >> 16, b >> 16) << 16; }}
uint most_halves(uint a, uint b) {{ return max(a & 65535u, b & 65535u) | max(a >> 16, b >> 16) << 16; }}
float piece_row(int row, int piece) {{ return piece_table[16 * row + piece]; }}
struct Pair {{ int a; vec2 b; }};
int counted = 0;
{functions}
void main() {{ found[gl_LocalInvocationIndex] = f(given[gl_LocalInvocationIndex]); }}
"""


def run(
    functions: str,
    given: np.ndarray,
    lanes: int = 16,
    intrinsics: bool = True,
    texture: Any = None,
    **buffers: np.ndarray,
) -> np.ndarray:
    """int32 (n,): f of each of `given`, int32 (n,), n a multiple of the lanes; 0 lanes: by the interpreter."""
    source = ShaderSource(PROGRAM.format(functions=functions), ("test",))
    if not lanes:
        text = f"layout(local_size_x = {len(given)}) in;" + source.text
        blocks = {0: np.ascontiguousarray(given, np.int32).view(np.uint8), 1: np.zeros(4 * len(given), np.uint8)}
        Interpreter(parse(ShaderSource(text, ("test",))), Dispatch(source, (1, 1, 1), {}, blocks)).finish()
        return blocks[1].view(np.int32)
    call = function_of(object_code(source, "f", lanes, intrinsics), "f")
    given, found, system = np.ascontiguousarray(given, np.int32), np.zeros(len(given), np.int32), np.zeros(7, np.uint32)
    blocks = {int(name[1:]): data for name, data in buffers.items()}
    table = addresses({}, blocks | {0: given, 1: found}, system, {} if texture is None else {1: texture})
    for system[6] in range(0, len(given), lanes):
        call(table.ctypes.data)
    return found


def collatz(x: int) -> int:
    steps = 0
    while x > 1 and steps < 40:
        x = 3 * x + 1 if x % 2 else x // 2
        steps += 1
    return steps


FUNCTIONS: dict[str, tuple[str, Callable[[int], int]]] = {
    "return in a branch": (
        "int f(int x) { if (x > 20) return 1; x += 2; return x; }",
        lambda x: 1 if x > 20 else x + 2,
    ),
    "return in a branch that a constant chooses, behind another one": (
        "const bool YES = true; int f(int x) { if (x > 20) return 1; if (YES) return 2; return 3; }",
        lambda x: 1 if x > 20 else 2,
    ),
    "product that is not rounded before something is taken from it": (
        "int f(int x) { float a = float(4097 + x); return int(a * a - 16785408.0); }",
        lambda x: (4097 + x) ** 2 - 16785408,
    ),
    "return in a branch in a branch": (
        "int f(int x) { int s = 0; if (x > 20) { ++s; if (x > 10) return 7; s += 5; } return s + 100 * x; }",
        lambda x: 7 if x > 20 else 100 * x,
    ),
    "continue in a branch in a branch": (
        "int f(int x) { int s = 0; for (int k = 0; k < 9; ++k) { if (x > 30) { if (x > 20) continue; ++s; } s += x; } "
        "return s; }",
        lambda x: 0 if x > 30 else 9 * x,
    ),
    "loop of own length": (
        "int f(int x) { int n = 0; while (x > 1 && n < 40) { x = x % 2 != 0 ? 3 * x + 1 : x / 2; ++n; } return n; }",
        collatz,
    ),
    "break and continue": (
        "int f(int x) { int s = 0; for (int k = 0; k < 30; ++k) { if (k % 3 == x % 3) continue; if (k > x) "
        "break; s += k; } return s; }",
        lambda x: sum(k for k in range(30) if k % 3 != x % 3 and k <= x),
    ),
    "return from two loops": (
        "int f(int x) { for (int a = 0; a < 9; ++a) for (int b = 0; b < 9; ++b) if (a * b >= x) return 10 * a "
        "+ b; return -1; }",
        lambda x: next((10 * a + b for a in range(9) for b in range(9) if a * b >= x), -1),
    ),
    "break of the inner loop": (
        "int f(int x) { int s = 0; for (int a = 0; a < 5; ++a) { for (int b = 0;; ++b) { if (b >= x || b > 6) "
        "break; ++s; } s += a; } return s; }",
        lambda x: sum(min(x, 7) + a for a in range(5)),
    ),
    "continue in an unrolled loop": (
        "int f(int x) { int s = 0; for (int a = 0; a < 3; ++a) { if (a == x) continue; if (x > 50) break; s "
        "+= a + 1; } return s; }",
        lambda x: 0 if x > 50 else sum(a + 1 for a in range(3) if a != x),
    ),
    "out and inout": (
        "bool g(int x, inout int s, out int t) { t = x; if (x > 9) return false; s += x; t = -x; return true; }"
        "int f(int x) { int s = 5, t; bool b = g(x, s, t); return 100 * s + t + (b ? 1000 : 0); }",
        lambda x: 500 + x if x > 9 else 100 * (5 + x) - x + 1000,
    ),
    "global variable": (
        "void g(int n) { for (int k = 0; k < n; ++k) { if (k == 7) return; ++counted; } }"
        "int f(int x) { counted = 0; g(x); g(3); return counted; }",
        lambda x: min(x, 7) + 3,
    ),
    "struct, swizzle, index": (
        "int f(int x) { Pair p = Pair(x, vec2(1.0, 2.0)); p.b.yx = vec2(float(x), 0.5); p.b[1] += float(x % 2); "
        "p.b[0] += float(1 - x % 2); return int(10.0 * p.b[x - x] + p.b.y); }",
        lambda x: int(10.0 * (0.5 + (x % 2 == 0)) + x + (x % 2)),
    ),
    "array": (
        "int f(int x) { int a[5]; for (int k = 0; k < 5; ++k) a[k] = k * k; a[x % 5] = x; return a[(x + 1) % "
        "5] + 7 * a[x % 5]; }",
        lambda x: ((x + 1) % 5) ** 2 + 7 * x,
    ),
    "choice with calls": (
        "int g(int x) { counted += x; return counted; } int f(int x) { counted = 0; int y = x > 9 ? g(x) : "
        "g(1) + g(2); return 100 * y + counted; }",
        lambda x: 101 * x if x > 9 else 403,
    ),
    "lanes that do not take part": (
        "int g(int x) { ++counted; return x; } int f(int x) { counted = 0; bool b = x > 9 && g(x) > 12 || x "
        "== 3; return counted + (b ? 10 : 0); }",
        lambda x: int(x > 9) + 10 * (x > 12 or x == 3),
    ),
    "an array's bounds": (
        "int f(int x) { int a[4]; for (int k = 0; k < a.length(); ++k) a[k] = k; a[x - 9] = 7; "
        "return a[x - 20] + a[int(0.0 / float(x - x))] * 0; }",
        lambda x: 7 if (index(x - 9) == index(x - 20)) else index(x - 20),
    ),
    "division by zero": (
        "int f(int x) { int z = x - x; uint u = uint(x); return (x / z) * 0 + (x % z) * 0 + int(u / uint(z)) * 0 + "
        "(-2147483647 - 1 + z) / (z - 1) % 2 + 7 / (x - 70) + 7 % (x - 70); }",
        lambda x: int(7 / (x - 70)) + math.fmod(7, x - 70),
    ),
    "NaN in masks": (
        "int f(int x) { float n = sqrt(float(20 - x)); int s = 0; if (n < 3.0) s += 1; else s += 2; "
        "if (n == n) s += 4; if (n != n) s += 8; if (isnan(n)) s += 16; "
        "for (int k = 0; float(k) <= n; ++k) s += 100; return s; }",
        lambda x: 26 if x > 20 else 4 + (1 if 20 - x < 9 else 2) + 100 * (1 + math.isqrt(20 - x)),
    ),
    "built-in functions": (
        "int f(int x) { float a = 0.1 * float(x) - 3.013; vec3 v = vec3(a, 1.0, 2.0), w = cross(v, vec3(0.5, a, 1.0)); "
        "float s = sign(a) + mod(a, 0.7) + step(0.0, a) + smoothstep(-1.0, 1.0, a) + w.x + w.y + w.z + distance(v, w); "
        "s += reflect(v, w).y + atan(a) + atan(a, 0.5) + tan(0.3 * a) + asin(0.2 * a) + acos(0.2 * a) + round(a); "
        "return int(round(100.0 * (s + radians(a) + degrees(a)))); }",
        lambda x: built_ins(0.1 * x - 3.013),
    ),
    "integers wrap": (
        "int f(int x) { uint u = uint(x) * 0x9e3779b9u; return int(u >> 7 ^ u << 3); }",
        lambda x: mixed(x),
    ),
}


def index(x: int) -> int:
    """Of an array of four, the last for an index outside."""
    return x if 0 <= x < 4 else 3


def built_ins(a: float) -> int:
    v, b = np.array([a, 1.0, 2.0]), np.array([0.5, a, 1.0])
    w, t = np.cross(v, b), min(max((a + 1) / 2, 0), 1)
    s = np.sign(a) + a % 0.7 + (a >= 0) + t * t * (3 - 2 * t) + w.sum() + np.linalg.norm(v - w)
    s += (v - 2 * (v @ w) * w)[1] + math.atan(a) + math.atan2(a, 0.5) + math.tan(0.3 * a) + math.asin(0.2 * a)
    return round(100 * (s + math.acos(0.2 * a) + math.radians(a) + math.degrees(a) + round(a)))


def mixed(x: int) -> int:
    u = x * 0x9E3779B9 & 0xFFFFFFFF
    found = (u >> 7) ^ (u << 3 & 0xFFFFFFFF)
    return found - (1 << 32) if found >= 1 << 31 else found


ALL = "".join(
    [
        *(
            f"#define f f_{n}\n#define g g_{n}\n{each[0]}\n#undef f\n#undef g\n"
            for n, each in enumerate(FUNCTIONS.values())
        ),
        "int f(int x) { int n = x / 64, y = x % 64; ",
        *(f"if (n == {n}) return f_{n}(y); " for n in range(len(FUNCTIONS))),
        "return 0; }\n",
    ]
)
"""One program of all functions, as compiling takes longer than running; of x it is function x / 64 of x mod 64."""
GIVEN = np.random.default_rng(3).permutation(64)


def run_all(lanes: int = 16) -> dict[str, list[int]]:
    given = np.concatenate([64 * n + GIVEN for n in range(len(FUNCTIONS))])
    found = run(ALL, given, lanes).reshape(len(FUNCTIONS), 64).tolist()
    return dict(zip(FUNCTIONS, found, strict=True))


@pytest.mark.parametrize("lanes", [16, 4, 1, 0])
def test_lanes_that_part_do_what_each_would_do_alone(lanes: int) -> None:
    found, expected = run_all(lanes), {name: [of(int(x)) for x in GIVEN] for name, (_, of) in FUNCTIONS.items()}
    if not (lanes and has_features("fma")):  # like OpenGL, these round every product
        del expected["product that is not rounded before something is taken from it"]
    assert {name: found[name] for name in expected} == expected


def test_all_passes_of_llvm_find_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    source = ShaderSource("", ())
    sources, found = code_sources(source, 16), run_all()
    monkeypatch.setenv(OPTIMIZE_VARIABLE, "1")
    assert code_sources(source, 16) != sources
    assert run_all() == found
    monkeypatch.setenv(OPTIMIZE_VARIABLE, "fast")
    with pytest.raises(InputError, match="CLUSTERVIZ_OPTIMIZE: neither 0 nor 1; found fast; allowed 0, 1"):
        optimizes()


def test_any_cpu_of_a_kind_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """On x86 by SSE2 alone, whose registers hold four lanes."""
    monkeypatch.setenv(CPU_VARIABLE, "generic")
    machine.cache_clear()
    try:
        for name in ("array", "NaN in masks", "built-in functions"):
            text, expected = FUNCTIONS[name]
            assert run(text, np.arange(64)).tolist() == [expected(x) for x in range(64)]
    finally:
        machine.cache_clear()


@pytest.mark.parametrize(
    "text",
    [
        FUNCTIONS["global variable"][0],
        FUNCTIONS["choice with calls"][0],
        "int a[3]; int g(int x, inout int s, out int t) { t = 7; for (int k = 0; k < 3; ++k) { a[k] += x; "
        "if (x > 9) return k; ++counted; } s += a[x % 3]; t = counted; return x; } "
        "int f(int x) { for (int k = 0; k < 3; ++k) a[k] = k; "
        "counted = 0; int s = 1, t = 2; int r = g(x, s, t); if (x % 2 != 0) r += g(3, t, s); "
        "return r + 10 * s + 100 * t; }",
    ],
)
def test_functions_that_are_called_do_what_inlined_ones_do(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    inlined = run(text, np.arange(64))
    monkeypatch.setattr(codegen, "LARGE_PROGRAM", 0)
    monkeypatch.setattr(codegen, "LARGE_FUNCTION", 0)
    program = parse(ShaderSource(PROGRAM.format(functions=text), ("test",)))
    assert "call fastcc" in Generator(program, 16, {}).text("f")
    assert run(text, np.arange(64)).tolist() == inlined.tolist()


@pytest.mark.parametrize("lanes", [16, 1])
def test_a_texel_is_fetched(lanes: int) -> None:
    """Of texels outside, the nearest."""
    texels = np.random.default_rng(5).random((5, 7, 4), np.float32)
    text = (
        "layout(binding = 1) uniform sampler2D image; int f(int x) { ivec2 at = ivec2(x % 9 - 1, x / 9); "
        "vec4 v = texelFetch(image, at, 0); "
        "return int(1e6 * dot(v, vec4(1.0, 2.0, 3.0, 4.0))) + textureSize(image, 0).x; }"
    )
    x = np.arange(64)
    rows, columns = np.minimum(x // 9, 4), np.clip(x % 9 - 1, 0, 6)
    expected = 1e6 * (texels[rows, columns] @ np.array([1.0, 2.0, 3.0, 4.0])) + 7
    assert np.abs(run(text, x, lanes, texture=texture_block(texels)) - expected).max() < 3


@pytest.mark.parametrize(
    "text",
    [
        "int f(int x) { if (x % 3 == 0) return 0; uvec2 w = words_at(2, x, -2); return int(w.x) + 1000 * int(w.y); }",
        "int f(int x) { uvec2 w = words_at(x, 0, x % 3); return int(w.x) + 1000 * int(w.y); }",
        "int f(int x) { uint w = uint(1021 * x) & 65535u; return int(least_bytes(w, 25900u)); }",
        "int f(int x) { return int(most_bytes(uint(1021 * x) & 65535u, 25900u) ^ most_bytes(511u, 256u)); }",
        "int f(int x) { return int(least_halves(uint(x) << 20 | 100u, 33554432u | uint(3 * x))); }",
        "int f(int x) { return int(most_halves(uint(x) << 20 | 100u, 33554432u | uint(3 * x))); }",
        "int f(int x) { uvec2 w = words_at(-x, x - 1, 0); return int(w.x) + 1000 * int(w.y) + x; }",
        "int f(int x) { return int(piece_row(2, x % 16)) + int(piece_row(0, 5)); }",
    ],
    ids=[
        "words_at",
        "words_at by lane",
        "least_bytes",
        "most_bytes",
        "least_halves",
        "most_halves",
        "words before",
        "piece_row",
    ],
)
def test_an_intrinsic_equals_its_meaning_in_glsl(text: str) -> None:
    words, pieces = (np.arange(88, dtype=np.uint32) * 7)[8:], (np.arange(64) * 3).astype(np.float32)
    found = [run(text, np.arange(64), 16, intrinsics, b7=words, b9=pieces) for intrinsics in (False, True)]
    assert np.array_equal(*found)
    assert len(set(found[0].tolist())) > 10


def test_idle_lanes_read_behind_the_header_of_several_volumes() -> None:
    """Its small integers would be denormal float32 numbers, which take long to multiply."""
    functions = "layout(std140, binding = 0) uniform volumeBlock { vec4 volume; };" + (
        "int f(int x) { if (x > 3) return 0; return int(words_at(x, 0, 0).x); }"
    )
    code = code_of(ShaderSource(PROGRAM.format(functions=functions), ("test",)), "f", 16)
    (idle,) = re.findall(r"select <16 x i1> \S+, <16 x i32> \S+, <16 x i32> splat \(i32 (\d+)\)", code)
    assert int(idle) - BELOW == HEADER_WORDS * Scene.model_fields["volumes"].metadata[0].max_length
