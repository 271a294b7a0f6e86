"""Boxes of texels come back as they were written, whatever the driver offers."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest

from clusterviz.gl import texels
from clusterviz.gl.texels import read_box

pytestmark = pytest.mark.gl


@pytest.mark.parametrize("since", [texels.SINCE, 10**6])
@pytest.mark.parametrize(("kind", "texel"), [("u1", "f1"), ("<u2", "nu2"), ("<f4", "f4")])
def test_a_box_is_what_was_written(
    context: moderngl.Context, kind: str, texel: str, since: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(texels, "SINCE", since)
    voxels = np.random.default_rng(1).integers(0, 250, (5, 4, 7)).astype(kind)
    texture = context.texture3d((7, 4, 5), 1, voxels.tobytes(), alignment=1, dtype=texel)
    for x, y, z, shape in ((0, 0, 0, (5, 4, 7)), (3, 1, 2, (2, 3, 3)), (6, 3, 4, (1, 1, 1))):
        expected = voxels[z : z + shape[0], y : y + shape[1], x : x + shape[2]]
        np.testing.assert_array_equal(read_box(texture, (x, y, z), shape, kind), expected)
    texture.release()
