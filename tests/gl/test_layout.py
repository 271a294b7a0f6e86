from __future__ import annotations

import moderngl
import numpy as np
import pytest
from gl.probing import Probe

from clusterviz.gl.layout import glsl_block

MIXED = np.dtype(
    [("d", "f8", 4), ("f", "f4", 4), ("i", "i4", 4), ("u", "u4", 4), ("a", "f4"), ("b", "i4"), ("c", "u4")]
)


def test_block_has_a_line_for_each_member_in_order() -> None:
    assert glsl_block("look", 3, MIXED).splitlines() == [
        "layout(std140, binding = 3) uniform lookBlock {",
        "    dvec4 d;",
        "    vec4 f;",
        "    ivec4 i;",
        "    uvec4 u;",
        "    float a;",
        "    int b;",
        "    uint c;",
        "} look;",
    ]


@pytest.mark.parametrize(
    "members",
    [
        [("three", "f4", 3)],
        [("double", "f8")],
        [("half", "f2", 4)],
        [("matrix", "f4", (4, 4))],
        [("scalar", "f4"), ("column", "f4", 4)],  # GLSL would move the column to byte 16
        [("column", "f4", 4), ("wide", "f8", 4)],  # and this one to byte 32
        [("long", "i8", 4)],
    ],
    ids=lambda members: members[-1][0],
)
def test_member_that_glsl_would_place_elsewhere_is_refused(members: list[tuple[object, ...]]) -> None:
    with pytest.raises(ValueError, match=str(members[-1][0])):
        glsl_block("look", 0, np.dtype(members))


@pytest.mark.gl
def test_shader_reads_every_member_as_numpy_wrote_it(context: moderngl.Context, probe: Probe) -> None:
    record = np.zeros(1, MIXED)
    record["d"], record["f"], record["i"], record["u"] = [1, 2, 3, 4], [5, 6, 7, 8], [-9, 10, -11, 12], [13, 14, 15, 16]
    record["a"], record["b"], record["c"] = 17, -18, 19
    block = context.buffer(record.tobytes())
    block.bind_to_uniform_block(0)
    rows = ["vec4(look.d)", "look.f", "vec4(look.i)", "vec4(look.u)", "vec4(look.a, look.b, look.c, 0.0)"]
    body = "\n".join([*(f"if (x.x == {n}.0) return {row};" for n, row in enumerate(rows)), "return vec4(-1.0);"])
    found = probe(body, np.arange(len(rows)), declarations=glsl_block("look", 0, MIXED))
    assert found.tolist() == [[1, 2, 3, 4], [5, 6, 7, 8], [-9, 10, -11, 12], [13, 14, 15, 16], [17, -18, 19, 0]]
    block.release()
