"""Pictures of the shaders' CPU variants against the float64 reference."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from render.looks import PATHS
from render.scenes import LIT, SHAPE, Prepared, camera_at, prepare, scene_of, smooth, whole

from clusterviz.data.source import Grid
from clusterviz.image.partial import PartialImage
from clusterviz.partition import Piece, bounding_box, build_tree
from clusterviz.reference import render_reference
from clusterviz.render.cpu.marching.empty_space import skips_of
from clusterviz.render.cpu.memory import lay_out, words_of
from clusterviz.render.cpu.transfer.pieces import pieces_of
from clusterviz.render.frame_block import frame_block
from clusterviz.render.render_result import finish_projection, footprint
from clusterviz.render.storage import slot_of
from clusterviz.render.stored_brick import store, visible_groups
from clusterviz.render.variant import Lanes, variant_of
from clusterviz.spmd.machine_code import addresses, function_of, object_code


def drawn(prepared: Prepared, lanes: int, in_registers: bool = False, far: bool = False) -> np.ndarray:
    """The finished picture, float64 (h, w, 4), by one thread that draws all tiles."""
    plan, slot = prepared.plan, slot_of(prepared.plan)
    found = pieces_of(plan.transfer, plan.march.slab_units) if in_registers else None
    assert bool(found) == in_registers
    cpu = Lanes(lanes, found.capacity, found.fitted, far) if found else Lanes(lanes, far=far)
    variant = replace(variant_of(plan, slot, 0), cpu=cpu)

    piece = Piece(0, build_tree(plan.cost, 1).leaves[0].trimmed)
    members = piece.members(plan.cost > 0)
    box, rect, places = bounding_box(members), footprint(plan, piece), members - bounding_box(members).begin_zyx
    stored = [store(prepared.bricks[tuple(index)], plan.encoding, slot) for index in members.tolist()]
    words = words_of(slot) if variant.has_cells else slot.words
    voxels, offsets = np.zeros(words * len(members) + 16, np.uint32), np.full(box.shape_zyx, -1, np.int32)
    offsets[tuple(places.T)] = np.arange(len(members)) * words
    for own, brick in zip(voxels[: words * len(members)].reshape(-1, words), stored, strict=True):
        if variant.has_cells:
            lay_out(brick.samples, slot, own)
        else:
            own[:] = slot.pack(brick.samples).reshape(-1).view(np.uint32)
    visible = visible_groups((np.stack([b.low for b in stored]), np.stack([b.high for b in stored])), plan)

    frame, segments, mode = frame_block(plan, box, rect, slot), plan.segments, plan.blend_mode
    frame["first_box"], frame["first_dispatch"] = 2, 1
    uniforms = {0: frame} | ({2: mode.shading.block()} if mode.shading else {})
    uniforms |= {4: mode.surface_block()} if mode.surfaces else {}
    uniforms |= {5: mode.grading.block()} if mode.grading else {}
    pixels, samples_and_tile = np.zeros((2, rect.height, rect.width, 4), np.float32), np.zeros(2, np.int32)
    skips = np.ascontiguousarray(skips_of(visible, places, box.shape_zyx, plan.layout.brick))
    records = np.ascontiguousarray(segments.records)
    buffers: dict[int, Any] = {1: pixels, 2: samples_and_tile, 3: offsets, 4: segments.buckets, 5: records, 6: skips}
    buffers |= {7: voxels} | ({9: found.table} if found else {})
    system = np.zeros(7, np.uint32)
    table = addresses(uniforms, buffers, system)
    function_of(object_code(variant.source, "cast", lanes), "cast")(table.ctypes.data)
    assert samples_and_tile[0] > 0
    return finish_projection(plan, whole(PartialImage(rect, pixels[0]), plan.view.size).astype(np.float32))


PLAIN: dict[str, Any] = {}
SURFACES = {"blending": "isosurface", "isosurfaces": ((100.0, 0.4), (160.0, 1.0))}


@pytest.mark.parametrize(
    ("lanes", "dtype", "bound", "keys", "how"),
    [
        pytest.param(16, "uint8", 1e-5, PLAIN, {"in_registers": True}, id="transfer function in registers"),
        pytest.param(8, "uint8", 1e-5, PLAIN, {"far": True}, id="cells in two words, fetched ahead"),
        pytest.param(4, "uint8", 1e-5, PLAIN, {}, id="4 lanes"),
        pytest.param(1, "uint8", 1e-5, PLAIN, {}, id="1 lane"),
        pytest.param(16, "uint16", 1e-5, {"jitter": True}, {}, id="jittered uint16"),
        pytest.param(16, "float32", 1e-5, {"blending": "maximum"}, {}, id="maximum of float32"),
        pytest.param(16, "uint8", 4e-5, LIT, {}, id="lit"),
        pytest.param(16, "uint16", 4e-5, LIT, {}, id="lit uint16"),
        pytest.param(8, "uint8", 4e-5, LIT | {"ambient_occlusion": {"radius": 3.0}}, {}, id="occluded"),
        pytest.param(16, "float32", 4e-5, {"interpolation": "cubic"}, {}, id="cubic float32"),
        pytest.param(16, "uint8", 1e-4, SURFACES, {}, id="isosurfaces"),
        pytest.param(8, "uint8", 4e-5, LIT | {"shader": PATHS["boundaries"]}, {}, id="a user's look"),
        pytest.param(8, "uint8", 1e-5, {"shader": PATHS["wild"]}, {}, id="a look without an end"),
    ],
)
def test_a_cpu_draws_what_the_reference_does(
    lanes: int, dtype: str, bound: float, keys: dict[str, Any], how: dict[str, bool]
) -> None:
    voxels = smooth(dtype=dtype)
    scene = scene_of(voxels, camera_at("outside", Grid(SHAPE)), size=(70, 50), **keys)
    expected = render_reference(scene, Grid(SHAPE), voxels)
    found = drawn(prepare(scene, voxels, brick=16), lanes, **how)
    assert expected.max() > 0.1
    assert np.count_nonzero(np.abs(found - expected).max(axis=-1) > bound) == 0
