"""Several volumes whose slabs have ends that matter: isosurfaces, and integrals of transfer functions."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.test_multi_volume import BYTES, FLOATS, LIGHTS, SMOOTH, STEEP, WORDS, Part, drawn, expected, scene_of

from clusterviz.scene.values import Clip

pytestmark = pytest.mark.gl

BOUND, FEW = 1e-6, 0.005
"""The share of pixels in which a ray may graze a surface of noise: where it meets it is anybody's guess."""
SHELLS = (
    BYTES[0].model_copy(update={"isosurfaces": (100.0, (150.0, 0.5)), "blending": "isosurface", "shade": True}),
    *BYTES[1:],
)
CORES = (FLOATS[0].model_copy(update={"isosurfaces": ((-0.2, 0.3), (0.1, 0.6))}), *FLOATS[1:])
CUT = {"clip": Clip(planes=(((9, 9, 9), (0.2, 1, 1)),))}
PREINTEGRATED = {"quality": {"classification": "pre-integrated"}}
JITTERED = {"quality": {"classification": "pre-integrated", "jitter": True}}
INTEGRATED: dict[str, tuple[tuple[Part, ...], dict[str, Any]]] = {
    "beside nearest voxels": ((BYTES, FLOATS, WORDS), PREINTEGRATED),
    "lit, clipped, jittered": ((STEEP, SMOOTH), JITTERED | CUT),
}
SURFACES: dict[str, tuple[tuple[Part, ...], dict[str, Any]]] = {
    "through each other": ((SHELLS, CORES, WORDS), {"lights": LIGHTS} | CUT),
    "beside integrals": ((FLOATS, SHELLS), JITTERED | CUT),
}


def wrong(found: np.ndarray, right: np.ndarray) -> float:
    """The share of pixels that differ, of pictures that show something."""
    assert right[..., 3].max() > 0.3
    return float((np.abs(found - right).max(axis=-1) > 1e-5).mean())


@pytest.mark.parametrize(
    ("name", "camera"), [("beside nearest voxels", "inside"), ("lit, clipped, jittered", "outside")]
)
def test_integrals_are_the_reference(context: moderngl.Context, name: str, camera: str) -> None:
    parts, sections = INTEGRATED[name]
    scene = scene_of(parts, camera, **sections)
    picture, _ = drawn(context, scene, parts)
    assert picture[..., 3].max() > 0.3
    assert np.abs(picture - expected(scene, parts)).max() <= BOUND


@pytest.mark.parametrize(("name", "camera"), [("through each other", "inside"), ("beside integrals", "parallel")])
def test_surfaces_are_the_reference(context: moderngl.Context, name: str, camera: str) -> None:
    parts, sections = SURFACES[name]
    scene = scene_of(parts, camera, **sections)
    assert wrong(drawn(context, scene, parts)[0], expected(scene, parts)) <= FEW


def test_neither_parts_nor_bricks_change_where_slabs_end(context: moderngl.Context) -> None:
    """Slabs of two voxels reach a voxel beyond their bricks, and no slab is longer."""
    parts, sections = SURFACES["beside integrals"]
    pictures = [
        drawn(context, scene_of(parts, "parallel", brick, step=step, **sections), parts, leaves)[0]
        for brick, leaves, step in ((64, 1, 30.0), (9, 5, 2.0))
    ]
    assert wrong(*pictures) <= FEW
