"""Empty-space skipping changes no bit of a picture: positions and sums are those of windows, wherever runs begin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import LIT, Counted, Prepared, camera_at, draw, drawn, prepare, scene_of

from clusterviz.data.source import Grid
from clusterviz.plan.content import brick_cost
from clusterviz.plan.plan import Plan
from clusterviz.reference import render_reference
from clusterviz.render import brick_atlas, opengl
from clusterviz.render.cpu import device as cpu_device
from clusterviz.render.storage import Slot
from clusterviz.scene.values import Cluster

pytestmark = pytest.mark.gl

SHAPE = (38, 45, 61)
SPARSE = ((0.0, 0.0), (0.5, 0.0), (0.7, 0.3), (0.8, 0.0), (0.9, 0.0), (1.0, 0.9))
CLIPPED = {"clip": {"planes": [[[30, 20, 20], [1, 0.5, 0.2]]]}}
PREINTEGRATED = {"classification": "pre-integrated"}
SPLIT = PREINTEGRATED | {"borders": "split", "cluster": Cluster(brick=7)}
PIECES = tuple((k / 40, k / 40, 0.5, 1 - k / 40) for k in range(41))
ENDS_EARLY = {"early_termination": 0.02}
SURFACES = {"blending": "isosurface", "isosurfaces": [[90.0, 0.3], [200.0, 0.8]]}
IN_VOLUME = LIT | {"isosurfaces": [[0.3, 0.3], [0.8, 0.8]]}
MANY_DISPATCHES = {"step": 0.008, "size": (11, 9), "opacity": ((0.0, 0.0), (0.1, 0.0), (0.2, 0.5), (1.0, 0.9))}
LARGEST = {"blending": "maximum", "opacity": ((0.0, 0.0), (0.5, 0.0), (1, 1))}
SMALLEST = {"blending": "minimum", "opacity": ((0.0, 1.0), (0.5, 0.0), (1, 0))}
CASES: dict[str, tuple[str, str, int, dict[str, Any]]] = {
    "8-bit": ("uint8", "outside", 16, {}),
    "16-bit, clipped, long steps": ("uint16", "parallel", 32, {"step": 2.9} | CLIPPED),
    "float32, many pieces, jittered": ("float32", "on-a-face", 11, {"cmap": PIECES, "jitter": True}),
    "layers of bricks, ends early": ("uint8", "on-a-face", 5, ENDS_EARLY),
    "many dispatches": ("uint8", "outside", 16, MANY_DISPATCHES),
    "pre-integrated": ("float32", "outside", 16, PREINTEGRATED),
    "cut at bricks": ("uint8", "outside", 7, SPLIT | CLIPPED | ENDS_EARLY | {"jitter": True}),
    "cut at bricks, many dispatches": ("float32", "outside", 7, SPLIT | MANY_DISPATCHES),
    "cubic, lit": ("uint8", "outside", 16, {"interpolation": "cubic"} | LIT),
    "texture unit": ("uint8", "outside", 16, {"filter": "hardware"}),
    "surfaces, long steps": ("uint8", "outside", 16, SURFACES | {"step": 2.9}),
    "surfaces in a clipped volume, many dispatches": ("float32", "outside", 16, MANY_DISPATCHES | IN_VOLUME | CLIPPED),
    "maximum": ("uint8", "outside", 16, LARGEST),
    "minimum": ("uint8", "outside", 16, SMALLEST),
    "table": ("uint8", "outside", 16, {"transfer_2d": True}),
    "few slabs in a window, several buffers": ("uint8", "outside", 16, {"step": 9.3}),
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


def show_all(prepared: Prepared, monkeypatch: pytest.MonkeyPatch) -> Prepared:
    """The same with every group of cells of every brick called visible."""

    def visible(ranges: Any, _: Plan, slot: Slot | None = None) -> np.ndarray:
        if slot is None:
            return np.ones(ranges[0][:, 0].shape, bool)
        return np.full((len(ranges[0]), slot.visibility_words), 0xFFFFFFFF, np.uint32)

    monkeypatch.setattr(cpu_device, "visible_groups", visible)
    monkeypatch.setattr(brick_atlas, "visibility_bits", visible)
    plan = prepared.plan
    return replace(prepared, plan=replace(plan, cost=brick_cost(plan.layout, np.zeros(plan.layout.counts_zyx, bool))))


@pytest.mark.cover("surfaces in a clipped volume, many dispatches")
@pytest.mark.parametrize("case", CASES)
def test_skipping_changes_no_bit(
    context: moderngl.Context, case: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    dtype, camera, brick, keys = CASES[case]
    voxels, grid = blobs(dtype), Grid(SHAPE)
    highest = float(voxels.max())
    voxels = voxels.max() - voxels if case == "minimum" else voxels
    keys = {"opacity": SPARSE, "unit": 2.0, "step": 0.37, "size": (47, 41)} | keys
    if "transfer_2d" in keys:
        table = np.random.default_rng(4).random((5, 9))
        table[:, :3] = 0.0
        np.save(tmp_path / "table.npy", table)
        keys |= {"opacity": None, "transfer_2d": {"path": str(tmp_path / "table.npy"), "values": (0.0, highest)}}
        keys["transfer_2d"]["magnitudes"] = (0.0, highest / 3)
    prepared = prepare(scene_of(voxels, camera_at(camera, grid), clim=(0.0, highest), **keys), voxels, grid, brick)
    limits = {"block_bytes": 40000} if "several buffers" in case else {}
    casters = [(context, limits), (None, {})]
    skipped = [drawn(where, prepared, **own) for where, own in casters]
    every = show_all(prepared, monkeypatch)
    for (where, own), (found, samples) in zip(casters, skipped, strict=True):
        expected, all_samples = drawn(where, every, **own)
        assert expected.max() > 0.1
        assert samples < all_samples
        assert np.array_equal(found, expected)


def sheets() -> np.ndarray:
    """Sheets one cell thick, at the ends of groups of cells and of bricks that groups do not divide."""
    voxels = np.zeros((9, 9, 120), np.uint8)
    voxels[..., [0, 8, 9, 33, 63, 64, 65, 119]] = 200
    return voxels


def single_voxels() -> np.ndarray:
    return (np.random.default_rng(2).random((26, 41, 43)) > 0.998).astype(np.uint8) * 200


@pytest.mark.parametrize("iterations", [5, 100])
def test_dispatches_end_where_nothing_is_cut(
    iterations: int, context: moderngl.Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dispatch may end in empty space, in the middle of a batch."""
    voxels = blobs("uint8")
    prepared = prepare(scene_of(voxels, camera_at("outside", Grid(SHAPE)), opacity=SPARSE), voxels, brick=64)
    at_once, samples = drawn(context, prepared)
    monkeypatch.setattr(opengl, "ITERATIONS", (iterations, iterations))
    counted = Counted(context)
    in_shares, taken = drawn(counted, prepared)
    assert counted.made["dispatches"] > 1
    assert np.array_equal(in_shares, at_once)
    assert taken == samples


@pytest.mark.cover
@pytest.mark.parametrize("brick", [5, 12, 33, 64])
@pytest.mark.parametrize(
    ("voxels", "keys"),
    [
        (sheets(), {"opacity": ((0.3, 0.0), (1.0, 0.9)), "step": 0.4}),
        (single_voxels(), {"opacity": ((0.3, 0.0), (1.0, 0.9)), "step": 0.4}),
        (single_voxels(), {"opacity": ((0.0, 0.0), (0.02, 0.3)), "step": 1.7} | SPLIT),
    ],
    ids=["sheets", "single voxels", "cut at bricks"],
)
def test_leaps_end_before_what_is_visible(
    context: moderngl.Context, voxels: np.ndarray, keys: dict[str, Any], brick: int
) -> None:
    """Where a group of cells is cut by its brick's end, a leap over it must not go on into the next brick."""
    grid = Grid(voxels.shape)
    keys = keys | ({"cluster": Cluster(brick=brick)} if "cluster" in keys else {})
    scene = scene_of(voxels, camera_at("outside", grid), clim=(0.0, 200.0), unit=2.0, size=(14, 12), **keys)
    expected, prepared = render_reference(scene, grid, voxels), prepare(scene, voxels, grid, brick)
    assert expected[..., 3].max() > 0.1
    for where in (context, None):
        (found, samples), (merged, taken) = drawn(where, prepared), drawn(where, prepared, 5)
        assert np.abs(found - expected).max() <= 1e-5
        assert np.abs(merged - found).max() <= 1e-6
        assert taken == samples


def test_split_bricks_hold_less_and_take_as_many_samples(context: moderngl.Context) -> None:
    voxels, grid = single_voxels(), Grid((26, 41, 43))
    prepared = []
    for keys in (SPLIT | {"cluster": Cluster(brick=16)}, PREINTEGRATED):
        opacity = ((0.0, 0.0), (0.02, 0.3))
        scene = scene_of(voxels, camera_at("outside", grid), clim=(0.0, 200.0), opacity=opacity, **keys)
        prepared.append(prepare(scene, voxels, grid, 16))
    split, overlap = (sum(brick.nbytes for brick in each.bricks.values()) for each in prepared)
    assert split < 0.8 * overlap
    whole_slabs = draw(context, prepared[1])
    for where in (context, None):
        assert draw(where, prepared[0]).samples < 1.2 * whole_slabs.samples
