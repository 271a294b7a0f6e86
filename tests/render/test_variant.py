from __future__ import annotations

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, noise, prepare, scene_of
from render.variants import VARIANTS

from clusterviz.data.source import Grid
from clusterviz.gl.context import compile_compute
from clusterviz.render.storage import Slot
from clusterviz.render.variant import Variant, variant_of


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS)
def test_every_variant_compiles(context: moderngl.Context, variant: Variant) -> None:
    compile_compute(context, variant.source).release()


@pytest.mark.parametrize(
    ("dtype", "interpolation", "filter", "parts"),
    [
        ("uint8", "linear", "exact", {"voxel_u8.glsl", "linear.glsl"}),
        ("int16", "linear", "exact", {"voxel_u16.glsl", "linear.glsl"}),
        ("float64", "linear", "exact", {"voxel_f32.glsl", "linear.glsl"}),
        ("uint8", "nearest", "exact", {"voxel_u8.glsl", "nearest.glsl"}),
        ("uint8", "linear", "hardware", {"atlas.glsl", "hardware.glsl"}),
        ("uint8", "cubic", "hardware", {"atlas.glsl", "cubic_hardware.glsl"}),
        ("uint8", "nearest", "hardware", {"voxel_u8.glsl", "nearest.glsl"}),  # a nearest voxel needs no weights
    ],
)
def test_plan_chooses_the_parts(dtype: str, interpolation: str, filter: str, parts: set[str]) -> None:
    voxels = noise(dtype=np.dtype(dtype))
    scene = scene_of(voxels, camera_at("outside", Grid(SHAPE)), interpolation=interpolation, filter=filter)
    plan = prepare(scene, voxels).plan
    slot = Slot((16, 16, 16), plan.volume.encoding.kind, "hardware" in plan.filter)
    names = set(variant_of(plan, slot, 1 << 16).source.names)
    chosen = {name for name in names if name.startswith(("voxel", "atlas", "linear", "nearest", "hardware", "cubic_"))}
    assert chosen == parts


def test_records_that_do_not_fit_in_a_block_go_into_storage() -> None:
    voxels = noise(dtype=np.uint8)
    plan = prepare(scene_of(voxels, camera_at("outside", Grid(SHAPE))), voxels).plan
    slot = Slot((16, 16, 16), "u8", False)
    size = plan.volume.segments.records.nbytes
    assert "records_uniform.glsl" in variant_of(plan, slot, size).source.names
    assert "records_storage.glsl" in variant_of(plan, slot, size - 1).source.names
