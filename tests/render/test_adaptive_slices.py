"""Adaptive sampling in three dimensions: the reference's picture, fewer samples, and oracles that answer nonsense."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.scenes import Prepared, camera_at, prepare, scene_of

from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.jobs.device import devices_of, on_device
from clusterviz.plan.sampling_oracle import BLOCK, SamplingOracle, distance_by_bend, distance_to_change
from clusterviz.reference.adaptive_slices import render_adaptively
from clusterviz.render.slices.adaptive import AdaptivePicture, draw_adaptively

SHAPE = (33, 30, 37)
SPARSE = ((0.0, 0.0), (0.7, 0.0), (0.85, 0.5), (1.0, 0.7))


def prepared(
    camera: str = "outside", size: tuple[int, int] = (45, 38), **keys: Any
) -> tuple[Prepared, np.ndarray, Any]:
    """A planned scene in which most is empty, its voxels and the scene."""
    z, y, x = np.indices(SHAPE)
    voxels = np.exp(-((x - 14) ** 2 + 0.6 * (y - 17) ** 2 + (z - 12) ** 2) / 40).astype(np.float32)
    keys = {"renderer": "slices"} | keys
    scene = scene_of(voxels, camera_at(camera, Grid(SHAPE)), size=size, opacity=SPARSE, **keys)
    return prepare(scene, voxels, Grid(SHAPE)), voxels, scene


def drawn(
    plan: Any, voxels: np.ndarray, oracle: SamplingOracle, coarsest: int = 3, device: Any = "cpu", **how: bool
) -> AdaptivePicture:
    with on_device(devices_of([device])[0]):
        return draw_adaptively(plan, voxels, oracle, coarsest, **how)


@pytest.mark.parametrize(("camera", "size"), [("outside", (45, 38)), ("parallel", (1, 17)), ("along-an-axis", (1, 1))])
def test_pictures_are_those_of_the_reference(camera: str, size: tuple[int, int]) -> None:
    scene, voxels, given = prepared(camera, size)
    for oracle in (
        distance_to_change(voxels, scene.plan.volume.transfer, 0.01),
        distance_by_bend(voxels, scene.plan.volume.transfer, 0.1),
    ):
        expected, samples = render_adaptively(given, Grid(SHAPE), voxels, oracle.distances, BLOCK, 3)
        found = drawn(scene.plan, voxels, oracle)
        # Where a distance is a power of two, rounding decides whether a sample is taken.
        assert abs(sum(found.samples) - samples) <= 0.01 * samples + 2
        assert np.abs(found.rgba - expected).max() <= 2e-3
        assert expected.any() or size == (1, 1)


def test_fewer_samples_for_the_same_picture() -> None:
    scene, voxels, _ = prepared(size=(160, 140))
    every = drawn(scene.plan, voxels, SamplingOracle(np.zeros((1, 1, 1), np.float32), 64), 0)
    assert sum(every.samples) == pytest.approx(every.uniform, rel=2e-3)
    for tolerance, bound, most in ((0.03, 1e-4, 0.25), (0.3, 0.04, 0.04)):
        oracle = distance_by_bend(voxels, scene.plan.volume.transfer, tolerance)
        found = drawn(scene.plan, voxels, oracle)
        along_rays = drawn(scene.plan, voxels, oracle, along_rays=True)
        assert max(np.abs(each.rgba - every.rgba).max() for each in (found, along_rays)) <= bound
        assert found.share < min(most, 0.75 * along_rays.share)


@pytest.mark.parametrize("answer", [0.0, -1.0, np.nan, np.inf])
def test_oracles_may_answer_anything(answer: float) -> None:
    """What is not above 1 asks for every sample; infinity leaves the coarsest level."""
    scene, voxels, _ = prepared()
    every = drawn(scene.plan, voxels, SamplingOracle(np.zeros((1, 1, 1), np.float32), 64))
    found = drawn(scene.plan, voxels, SamplingOracle(np.full((1, 1, 1), answer, np.float32), 64))
    assert np.isfinite(found.rgba).all()
    if answer == np.inf:
        assert sum(found.samples[:-1]) == 0 < found.samples[-1]
    else:
        assert np.array_equal(found.rgba, every.rgba)
        assert found.samples == every.samples


def test_distances_never_reach_into_a_block_that_needs_more() -> None:
    """And single busy voxels are found, at the borders of blocks too."""
    voxels = np.zeros((25, 25, 25), np.float32)
    voxels[8, 13, 21] = 1.0
    scene, *_ = prepared()
    found = distance_to_change(voxels, scene.plan.volume.transfer, 0.01).distances
    assert (
        found[2, 3, 5] == found[1, 3, 5] == 0.0
    )  # voxel 8 is in the last cells of one block and the first of the next
    assert (found[..., 0] >= 12).all()
    for axis in range(3):
        assert np.abs(np.diff(found, axis=axis)).max() <= BLOCK


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        ({"shade": True}, "light"),
        ({"blending": "maximum"}, "blending: maximum"),
        ({"clip": {"planes": [[[0, 0, 0], [1, 0, 0]]]}}, "clipping planes"),
        ({"renderer": "raycast"}, "rays"),
        ({}, "1 of them not finite"),
    ],
)
def test_what_cannot_be_sampled_adaptively_is_refused(keys: dict[str, Any], found: str) -> None:
    scene, voxels, _ = prepared(size=(4, 4), **keys)
    voxels[0, 0, 0] = np.nan if not keys else 0.0
    with pytest.raises(InputError, match=found):
        drawn(scene.plan, voxels, SamplingOracle(np.zeros((1, 1, 1), np.float32), 64))


@pytest.mark.gl
def test_opengl_draws_the_same() -> None:
    scene, voxels, _ = prepared(size=(20, 17))
    oracle = distance_by_bend(voxels, scene.plan.volume.transfer, 0.1)
    here, there = (drawn(scene.plan, voxels, oracle, 2, device) for device in ("cpu", 0))
    assert np.abs(here.rgba - there.rgba).max() <= 2e-3
    assert sum(here.samples) == pytest.approx(sum(there.samples), rel=0.01)
