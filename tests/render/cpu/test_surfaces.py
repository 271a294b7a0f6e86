"""The processor's isosurfaces in other widths of vectors and in bricks; ../test_surfaces.py says more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, draw_on_cpu, prepare, scene_of, whole
from render.test_independence import in_parts
from render.test_shading import LIT, smooth
from render.test_surfaces import FEW, SIZE, surfaces, wrong

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.render.cpu.width import WIDTHS, Width
from clusterviz.scene.values import Scene

GRID = Grid(SHAPE)


def drawn(scene: Scene, voxels: np.ndarray, grid: Grid = GRID, brick: int = 7, width: Width | None = None) -> Any:
    """The processor's picture."""
    return whole(draw_on_cpu(prepare(scene, voxels, grid, brick), width=width).partial, scene.image.size)


@pytest.mark.parametrize("width", [None, WIDTHS[-1]], ids=["own", "narrowest"])
def test_surfaces_are_those_of_the_reference(width: Width | None) -> None:
    voxels = smooth(dtype="uint8")
    for camera, step in (("outside", 1.0), ("inside", 1.4), ("parallel-along-an-axis", 0.6)):
        scene = scene_of(voxels, camera_at(camera, GRID), step=step, look=surfaces(voxels, 0.55, 0.7, 0.4))
        expected = render_reference(scene, GRID, voxels)
        assert wrong(drawn(scene, voxels, width=width), expected) <= FEW, camera


@pytest.mark.parametrize("brick", [5, 16, 33])
def test_bricks_leave_no_seams(brick: int) -> None:
    voxels = smooth((40, 35, 70), np.uint8)
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), step=2.0, look=surfaces(voxels, 0.7, 0.55))
    assert wrong(drawn(scene, voxels, grid, brick), drawn(scene, voxels, grid, 70), 1e-5) == 0


@pytest.mark.parametrize("camera", ["outside", "inside", "parallel"])
def test_parts_drawn_apart_make_the_whole(camera: str) -> None:
    voxels = smooth(dtype="uint8")
    for blending in ("isosurface", "composite"):
        look = surfaces(voxels, 0.7, 0.55, **(LIT if blending == "composite" else {})) | {"blending": blending}
        prepared = prepare(scene := scene_of(voxels, camera_at(camera, GRID), look=look, step=0.93), voxels, brick=7)
        found = whole(draw_on_cpu(prepared).partial, SIZE)
        for count in (2, 5):
            assert wrong(in_parts(None, scene, prepared, count)[0], found, 1e-5) <= FEW


def test_a_ray_ends_with_the_surface_that_leaves_too_little_light() -> None:
    voxels = smooth((40, 35, 70), np.uint8)
    grid, counted = Grid(voxels.shape), []
    for residual in (0.0, 1e-3):
        keys: dict[str, Any] = {"look": surfaces(voxels, 0.4), "early_termination": residual, "step": 0.3}
        scene = scene_of(voxels, camera_at("outside", grid), **keys)
        counted.append(draw_on_cpu(prepare(scene, voxels, grid, 64)))
    assert counted[1].samples < 0.7 * counted[0].samples
    assert np.abs(counted[0].partial.rgba - counted[1].partial.rgba).max() <= 1e-3


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    voxels = smooth(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID), size=(97, 83), look=surfaces(voxels, 0.7, 0.4))
    pictures = []
    for threads in ("1", "3"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        pictures.append(draw_on_cpu(prepare(scene, voxels)).partial.rgba)
    assert np.array_equal(*pictures)
