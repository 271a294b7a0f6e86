"""Leaping over what is empty changes no bit of a picture: places and sums are those of windows, wherever runs begin."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from render.scenes import Prepared, camera_at, draw_on_cpu, prepare, scene_of, whole
from render.test_shading import LIT

from clusterviz.data.source import Grid
from clusterviz.plan.plan import Plan, brick_cost
from clusterviz.render.cpu import caster
from clusterviz.render.render_result import RenderResult

SHAPE = (38, 45, 61)
SPARSE = ((0.0, 0.0), (0.5, 0.0), (0.7, 0.3), (0.8, 0.0), (0.9, 0.0), (1.0, 0.9))
PLANES = {"planes": [[[30, 20, 20], [1, 0.5, 0.2]]]}
CASES: dict[str, tuple[str, str, int, dict[str, Any]]] = {
    "8-bit": ("uint8", "outside", 16, {}),
    "16-bit": ("uint16", "parallel", 32, {}),
    "float32": ("float32", "on-a-corner", 11, {}),
    "long steps": ("uint8", "outside", 16, {"step": 2.9}),
    "ends early": ("uint8", "on-a-face", 16, {"early_termination": 0.02}),
    "many pieces": ("uint8", "parallel", 8, {"cmap": tuple((k / 40, k / 40, 0.5, 1 - k / 40) for k in range(41))}),
    "clipped": ("uint8", "outside", 16, {"parts": {"clip": PLANES}}),
    "jittered": ("uint8", "on-a-face", 16, {"jitter": True}),
    "pre-integrated": ("float32", "outside", 16, {"classification": "pre-integrated"}),
    "split": ("uint8", "outside", 16, {"classification": "pre-integrated", "borders": "split"}),
    "cubic": ("uint8", "outside", 16, {"interpolation": "cubic"}),
    "lit": ("uint8", "outside", 16, {"look": LIT}),
    "surfaces": (
        "uint8",
        "outside",
        16,
        {"look": {"blending": "isosurface", "isosurfaces": [[90.0, 0.3], [200.0, 0.8]]}},
    ),
}


def blobs(dtype: str) -> np.ndarray:
    """Some small bodies far apart, around them nothing."""
    random = np.random.default_rng(11)
    z, y, x = np.indices(SHAPE)
    field = np.zeros(SHAPE)
    for centre in random.random((6, 3)) * SHAPE:
        field += np.exp(-((z - centre[0]) ** 2 + (y - centre[1]) ** 2 + (x - centre[2]) ** 2) / 18)
    field /= field.max()
    return (field if dtype == "float32" else field * np.iinfo(dtype).max).astype(dtype)


def sparse(dtype: str, camera: str, brick: int, special: dict[str, Any]) -> tuple[Prepared, tuple[int, int]]:
    """These bodies, which are little of what is seen, and the size of the picture."""
    voxels, grid = blobs(dtype), Grid(SHAPE)
    keys = {
        "clim": (0.0, float(voxels.max())),
        "opacity": SPARSE,
        "unit": 2.0,
        "step": 0.37,
        "size": (47, 41),
    } | special
    return prepare(scene_of(voxels, camera_at(camera, grid), **keys), voxels, grid, brick), keys["size"]


def draw_all(prepared: Prepared, monkeypatch: pytest.MonkeyPatch) -> RenderResult:
    """With every group of cells of every brick called visible."""
    plan = prepared.plan
    every = replace(plan, cost=brick_cost(plan.layout, np.zeros(plan.layout.counts_zyx, bool)))

    def visible(ranges: Any, _: Plan) -> np.ndarray:
        return np.ones(ranges[0].shape, bool)

    with monkeypatch.context() as patched:
        patched.setattr(caster, "visible_groups", visible)
        return draw_on_cpu(replace(prepared, plan=every))


@pytest.mark.parametrize("case", CASES)
def test_leaping_over_what_is_empty_changes_no_bit(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    prepared, size = sparse(*CASES[case])
    skipped, every = draw_on_cpu(prepared), draw_all(prepared, monkeypatch)
    assert skipped.samples < every.samples
    found, expected = (whole(drawn.partial, size) for drawn in (skipped, every))
    assert expected.max() > 0.1
    assert np.array_equal(found, expected)
