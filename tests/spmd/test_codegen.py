"""Generated code, and the interpreter, lane by lane: what lanes that part do is what each would do alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from clusterviz.gl.shader import ShaderSource
from clusterviz.spmd.interpreter import Dispatch, Interpreter
from clusterviz.spmd.machine_code import addresses, function_of, object_code
from clusterviz.spmd.parser import parse

PROGRAM = """
layout(std430, binding = 0) readonly buffer GivenBlock {{ int given[]; }};
layout(std430, binding = 1) writeonly buffer FoundBlock {{ int found[]; }};
layout(std430, binding = 7) readonly buffer VoxelsBlock {{ uint voxels[]; }};
layout(std430, binding = 9) readonly buffer PiecesBlock {{ float piece_table[]; }};
uvec2 words_at(int word) {{ return uvec2(voxels[word], voxels[word + 1]); }}
float piece_row(int row, int piece) {{ return piece_table[16 * row + piece]; }}
struct Pair {{ int a; vec2 b; }};
int counted = 0;
{functions}
void main() {{ found[gl_LocalInvocationIndex] = f(given[gl_LocalInvocationIndex]); }}
"""


def run(
    functions: str, given: np.ndarray, lanes: int = 16, intrinsics: bool = True, **buffers: np.ndarray
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
    table = addresses({}, blocks | {0: given, 1: found}, system)
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
        "int f(int x) { Pair p = Pair(x, vec2(1.0, 2.0)); p.b.yx = vec2(float(x), 0.5); p.b[x % 2] += 1.0; "
        "return int(10.0 * p.b.x + p.b.y); }",
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
    "integers wrap": (
        "int f(int x) { uint u = uint(x) * 0x9e3779b9u; return int(u >> 7 ^ u << 3); }",
        lambda x: mixed(x),
    ),
}


def mixed(x: int) -> int:
    u = x * 0x9E3779B9 & 0xFFFFFFFF
    found = (u >> 7) ^ (u << 3 & 0xFFFFFFFF)
    return found - (1 << 32) if found >= 1 << 31 else found


@pytest.mark.parametrize("lanes", [16, 8, 4, 0])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_lanes_that_part_do_what_each_would_do_alone(name: str, lanes: int) -> None:
    text, expected = FUNCTIONS[name]
    given = np.random.default_rng(3).permutation(64)
    assert run(text, given, lanes).tolist() == [expected(int(x)) for x in given]


@pytest.mark.parametrize(
    "text",
    [
        "int f(int x) { if (x % 3 == 0) return 0; uvec2 w = words_at(x); return int(w.x) + 1000 * int(w.y); }",
        "int f(int x) { return int(piece_row(2, x % 16)) + int(piece_row(0, 5)); }",
    ],
    ids=["words_at", "piece_row"],
)
def test_an_intrinsic_equals_its_meaning_in_glsl(text: str) -> None:
    words, pieces = np.arange(80, dtype=np.uint32) * 7, (np.arange(64) * 3).astype(np.float32)
    found = [run(text, np.arange(64), 16, intrinsics, b7=words, b9=pieces) for intrinsics in (False, True)]
    assert np.array_equal(*found)
    assert len(set(found[0].tolist())) > 10
