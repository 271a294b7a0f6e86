"""Polygons of slices, by each generator: the ray caster's picture of the same planes, without gaps or overlaps."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest
from render.scenes import Prepared, camera_at, drawn, prepare, scene_of, smooth

from clusterviz.data.source import Grid
from clusterviz.plan.slices import GENERATORS
from clusterviz.plan.slices.planes import plane_levels
from clusterviz.reference.rays import Rays, camera_rays, inside
from clusterviz.render.slices import Drawn, SliceDrawing

SHAPE, SIZE = (33, 30, 37), (48, 40)
HIDDEN = ((0.0, 0.0), (0.3, 0.1), (0.6, 0.0), (1.0, 0.7))
"""Nothing is visible at the volume's faces, where polygons do not cut slabs."""
NEAR = 0.02  # voxels from the volume's faces, where rasterisation decides


def prepared(camera: str) -> Prepared:
    voxels = np.zeros(SHAPE, np.float32)
    voxels[2:-2, 2:-2, 2:-2] = smooth(SHAPE)[2:-2, 2:-2, 2:-2]
    where = camera_at(camera, Grid(SHAPE))
    scene = scene_of(voxels, where, renderer="slices", size=SIZE, clim=(0.2, 0.9), opacity=HIDDEN)
    return prepare(scene, voxels, Grid(SHAPE), brick=9)


def drawing(context: moderngl.Context, scene: Prepared, generator: str, counted: bool = False) -> Drawn:
    made = SliceDrawing(context, scene.plan, scene.bricks, generator, counted)
    found = made.draw()
    made.release()
    return found


def planes_met(scene: Prepared, camera: str, grown: float) -> np.ndarray:
    """Planes that each pixel's ray meets in the volume, grown by some voxels on all sides."""
    levels = plane_levels(scene.plan.view, scene.plan.slice_planes)
    rays = camera_rays(camera_at(camera, Grid(SHAPE)), SIZE)
    entry, leave = inside(Rays(rays.start + grown, rays.direction), np.array(SHAPE[::-1]) - 1.0 + 2 * grown)
    first, last = ((rays.start + t[:, None] * rays.direction) @ levels.normal - levels.first for t in (entry, leave))
    return np.where(leave > entry, np.ceil(last) - np.ceil(first), 0.0).reshape(SIZE[::-1])


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize("camera", ["outside", "on-a-face", "parallel"])
def test_polygons_show_what_the_ray_caster_shows(context: moderngl.Context, camera: str) -> None:
    scene = prepared(camera)
    expected, _ = drawn(context, scene)
    least, most = (planes_met(scene, camera, grown) for grown in (-NEAR, NEAR))
    assert expected[..., 3].max() > 0.5
    for generator in GENERATORS:
        found = drawing(context, scene, generator)
        assert np.abs(found.rgba - expected).max() <= 1e-4, generator
        counts = drawing(context, scene, generator, counted=True).rgba[..., 0]
        assert ((counts >= least) & (counts <= most)).all(), generator


@pytest.mark.gl
def test_what_is_sent_is_as_in_the_thesis(context: moderngl.Context) -> None:
    """Three floats for each vertex; a few numbers for each brick; a template once."""
    scene = prepared("outside")
    found = {name: drawing(context, scene, name, counted=True) for name in GENERATORS}
    table = found["marching-cubes-table"]
    assert {each.slices for each in found.values()} == {table.slices}
    assert table.bytes_sent == 12 * table.vertices + 4 * (table.slices + table.bricks) + 28 * table.bricks
    assert [each.bytes_sent // each.bricks for each in (found["vertex-shader"], found["vertex-array-template"])] == [
        32,
        44,
    ]
    assert found["vertex-array-template"].bytes_once > 0
    assert all(each.bytes_once == 0 for name, each in found.items() if name != "vertex-array-template")
