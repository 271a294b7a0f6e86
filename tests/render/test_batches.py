"""Leaping over what is empty changes no bit of OpenGL's pictures: places and sums are those of windows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest
from render.cpu.test_windows import PLANES, SHAPE, SPARSE, blobs, sparse
from render.scenes import Prepared, camera_at, prepare, scene_of, whole
from render.test_shading import LIT

from clusterviz.data.source import Grid
from clusterviz.partition import Piece, build_tree
from clusterviz.plan.plan import Plan, brick_cost
from clusterviz.render import brick_atlas
from clusterviz.render.raycast import Raycaster
from clusterviz.render.render_result import RenderResult, finish_projection
from clusterviz.render.storage import Slot
from clusterviz.scene.values import Cluster

pytestmark = pytest.mark.gl

SIZE, SMALL = (47, 41), (11, 9)
CLIPPED = {"clip": PLANES}
SPLIT = {"classification": "pre-integrated", "borders": "split"}
PIECES = tuple((k / 40, k / 40, 0.5, 1 - k / 40) for k in range(41))
MANY_DISPATCHES = {"step": 0.008, "size": SMALL, "opacity": ((0.0, 0.0), (0.1, 0.0), (0.2, 0.5), (1.0, 0.9))}
CASES: dict[str, tuple[str, str, int, dict[str, Any]]] = {
    "16-bit, clipped, long steps": ("uint16", "parallel", 32, {"step": 2.9, "parts": CLIPPED}),
    "float32, many pieces, jittered": ("float32", "on-a-face", 11, {"cmap": PIECES, "jitter": True}),
    "layers of bricks, ends early": ("uint8", "on-a-face", 5, {"early_termination": 0.02}),
    "many dispatches": ("uint8", "outside", 16, MANY_DISPATCHES),
    "pre-integrated": ("float32", "outside", 16, {"classification": "pre-integrated"}),
    "cut at bricks": (
        "uint8",
        "outside",
        7,
        SPLIT | {"jitter": True, "early_termination": 0.02, "parts": CLIPPED | {"cluster": Cluster(brick=7)}},
    ),
    "cut at bricks, many dispatches": (
        "float32",
        "outside",
        7,
        SPLIT | MANY_DISPATCHES | {"parts": {"cluster": Cluster(brick=7)}},
    ),
    "cubic, lit": ("uint8", "outside", 16, {"interpolation": "cubic", "look": LIT}),
    "texture unit": ("uint8", "outside", 16, {"filter": "hardware"}),
    "surfaces, long steps": (
        "uint8",
        "outside",
        16,
        {"look": {"blending": "isosurface", "isosurfaces": [[90.0, 0.3], [200.0, 0.8]]}, "step": 2.9},
    ),
    "surfaces in a clipped volume, many dispatches": (
        "float32",
        "outside",
        16,
        MANY_DISPATCHES | {"look": LIT | {"isosurfaces": [[0.3, 0.3], [0.8, 0.8]]}, "parts": CLIPPED},
    ),
    "maximum": ("uint8", "outside", 16, {"look": {"blending": "maximum"}, "opacity": ((0.0, 0.0), (0.5, 0.0), (1, 1))}),
}


def skipped_and_every(
    context: moderngl.Context, monkeypatch: pytest.MonkeyPatch, prepared: Prepared, block_bytes: int | None = None
) -> list[RenderResult]:
    """A scene, and the same with every group of cells of every brick called visible."""

    def visible(ranges: Any, _: Plan, slot: Slot) -> np.ndarray:
        return np.full((len(ranges[0]), slot.visibility_words), 0xFFFFFFFF, np.uint32)

    plan, drawn = prepared.plan, []
    every = replace(plan, cost=brick_cost(plan.layout, np.zeros(plan.layout.counts_zyx, bool)))
    caster = Raycaster(context, plan, block_bytes)
    caster.load(plan, dict(prepared.bricks))
    for one in (plan, every):
        drawn += caster.draw(one, [Piece(0, build_tree(one.cost, 1).leaves[0].trimmed)])
        monkeypatch.setattr(brick_atlas, "visibility_bits", visible)
    caster.release()
    return drawn


@pytest.mark.parametrize("case", CASES)
def test_leaping_over_what_is_empty_changes_no_bit(
    context: moderngl.Context, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared, size = sparse(*CASES[case])
    skipped, every = skipped_and_every(context, monkeypatch, prepared)
    assert skipped.samples < every.samples
    found, expected = (finish_projection(prepared.plan, whole(drawn.partial, size)) for drawn in (skipped, every))
    assert expected.max() > 0.1
    assert np.array_equal(found, expected)


def test_bricks_in_several_buffers_and_windows_of_few_slabs_change_no_bit(
    context: moderngl.Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    voxels, grid = blobs("uint8"), Grid(SHAPE)
    scene = scene_of(voxels, camera_at("outside", grid), clim=(0, 255), opacity=SPARSE, unit=2.0, step=9.3, size=SIZE)
    skipped, every = skipped_and_every(context, monkeypatch, prepare(scene, voxels, grid, 16), 40000)
    assert skipped.samples < every.samples
    found, expected = (whole(drawn.partial, SIZE) for drawn in (skipped, every))
    assert expected.max() > 0.1
    assert np.array_equal(found, expected)
