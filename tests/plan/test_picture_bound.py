"""The bound of a picture's error: never below the true one, and the levels that are chosen by it."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from clusterviz.content.transfer import transfer_function
from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import Grid
from clusterviz.plan.picture_bound import FieldError, PictureBound, Rays, classified, dilated
from clusterviz.plan.ray_sampling import clip_planes, slab_length, slab_units
from clusterviz.plan.refinement import Refiner
from clusterviz.plan.view import make_view
from clusterviz.reference import render_reference
from clusterviz.scene.values import Scene

Floats = np.ndarray[Any, np.dtype[np.float64]]


def bricks_of(field: Floats, brick: int, error: Floats) -> tuple[Floats, FieldError]:
    """Return the error allowed at each sample, and the field's errors by bricks, which share their faces."""
    layout, allowed = BrickLayout(field.shape, brick), np.full(field.shape, np.inf)
    low, high = np.empty((2, *layout.counts_zyx))
    for index in np.ndindex(layout.counts_zyx):
        here = tuple(slice(b, e + 1) for b, e in zip(*layout.cell_box(index), strict=True))
        allowed[here] = np.minimum(allowed[here], error[index])
        low[index], high[index] = field[here].min(), field[here].max()
    return allowed, FieldError(low, high, np.stack([np.zeros_like(error), error]))


def bound_of(scene: Scene, field: FieldError, grid: Grid, brick: int) -> tuple[PictureBound, Rays]:
    volume, step = scene.volumes[0], slab_length(scene.quality.step, grid)
    transfer, ramps = transfer_function(volume), scene.quality.classification == "pre-integrated"
    units, whole = slab_units(step, transfer.unit_distance), not scene.quality.jitter
    # Nothing may be drawn of bricks without opacity.
    drawn = np.ones(field.low.shape, bool) if ramps else ~transfer.is_transparent(field.low, field.high)
    bound = PictureBound(transfer, units, field, drawn, brick, whole=whole, ramps=ramps)
    view = make_view(scene.camera, scene.image.size, grid)
    return bound, Rays(view, grid.shape_zyx, step, clip_planes(scene.clip, grid))


@pytest.mark.cover
@pytest.mark.parametrize("seed", range(9))
def test_no_picture_differs_by_more_than_the_bound(seed: int) -> None:
    random = np.random.default_rng(seed)
    z, y, x = np.indices(random.integers(9, 18, 3).tolist())
    a, b, c = random.uniform(1, 6, 3)
    field = 100 + 60 * np.sin(z / a + y / b) * np.cos(x / c) + random.uniform(0, 40) * random.random(z.shape)
    brick, spacing = int(random.choice([4, 8])), random.uniform(0.5, 2, 3).tolist()
    error = random.choice([0, 0.01, 0.3, 1, 5, 40], BrickLayout(field.shape, brick).counts_zyx)
    allowed, known = bricks_of(field, brick, error)
    drawn_field = field + allowed * random.choice([random.uniform(-1, 1, field.shape), np.ones(field.shape)])
    values, opacities = np.sort(random.uniform(0, 150, 5)), random.random(5) ** random.choice([1, 4, 12])
    values[2], opacities[random.random(5) < 0.4] = values[1 if seed % 2 else 2], 0
    values[-1], opacities[-1] = 150, 1 if seed % 3 == 0 else 0.2
    volume = {
        "path": "a.npy",
        "cmap": "viridis",
        "clim": [20, 190],
        "opacity": np.stack([values, opacities], axis=1).tolist(),
        "opacity_unit_distance": random.choice([0.3, 1.0, 3.0]),
    }
    middle = np.multiply(field.shape[::-1], spacing) / 2
    camera = {"position": random.normal(size=3) * 60, "focal_point": middle, "view_up": [0, 0.3, 1]}
    if seed == 5:  # along a face between bricks
        camera |= {"position": [*middle[:1], -50, brick * spacing[2]], "focal_point": [*middle[:2], brick * spacing[2]]}
    if seed % 3 == 1:
        camera["parallel_scale"] = random.uniform(5, 40)
    quality = {
        "step": random.choice([0.3, 1.0, 2.0]),
        "jitter": seed % 5 == 4,
        "classification": "pre-integrated" if seed == 3 else "post",
        "early_termination": 0.01 if seed % 6 == 1 else 0.0,
    }
    clip = {"planes": [[middle, random.normal(size=3)]]} if seed % 4 == 2 else {}
    image = {"size": [13, 11], "background": "black"}
    scene = Scene.model_validate(
        {"volumes": [volume], "camera": camera, "image": image, "quality": quality, "clip": clip}
    )
    grid = Grid(field.shape, tuple(spacing))
    bound, rays = bound_of(scene, known, grid, brick)
    found = bound.trace(rays, error, rays.pixels)[0]
    pictures = [render_reference(scene, grid, voxels) for voxels in (field, drawn_field)]
    true = np.abs(pictures[0] - pictures[1]).max(axis=-1).reshape(-1)
    assert (true <= found + 2 * quality["early_termination"] * (found > 0) + 1e-9).all(), (true.max(), found.max())
    assert found.max() > 0


def test_the_bound_of_a_constant_change_is_tight() -> None:
    field, grid = np.full((9, 17, 9), 100.0), Grid((9, 17, 9))
    volume = {"path": "a.npy", "cmap": "gray", "clim": [0, 200], "opacity": [[0, 0], [200, 0.02]]}
    scene = Scene.model_validate({
        "volumes": [volume | {"opacity_unit_distance": 1.0}],
        "camera": {"position": [4, -40, 4.1], "focal_point": [4, 8, 4.1], "view_up": [0, 0, 1]},
        "image": {"size": [9, 9], "background": "black"},
    })  # fmt: skip
    _, known = bricks_of(field, 8, np.full((1, 2, 1), 1.0))
    bound, rays = bound_of(scene, known, grid, 8)
    found = bound.trace(rays, known.errors[1], rays.pixels)[0].max()
    pictures = [render_reference(scene, grid, voxels) for voxels in (field, field + 1)]
    true = np.abs(pictures[0] - pictures[1]).max()
    assert true <= found <= 1.5 * true


def test_changes_are_those_of_a_search() -> None:
    volume = {
        "path": "a.npy",
        "cmap": "viridis",
        "clim": [0, 1],
        "opacity": [[0.2, 0], [0.4, 0.3], [0.7, 0.8], [1, 0.1]],
    }
    transfer = transfer_function(
        Scene.model_validate({"volumes": [volume | {"opacity_unit_distance": 1.0}]}).volumes[0]
    )
    binned = classified(transfer)
    change, random = binned.change(0.7, whole=True), np.random.default_rng(1)
    low = random.uniform(-0.1, 1, 50)
    high, error = low + random.uniform(0, 0.3, 50), 10 ** random.uniform(-6, 0, 50)
    found = change.largest(binned.bin_of(low, 0), binned.bin_of(high, 0), error * binned.per_unit)
    for n in range(50):
        s = random.uniform(low[n], high[n], 4000)
        t = s + random.uniform(-error[n], error[n], s.size)
        a, b = (1 - np.exp(-0.7 * transfer.extinction(v)) for v in (s, t))
        q, r = (c[:, None] * transfer.colour(v) for c, v in ((a, s), (b, t)))
        true = max(np.abs(q - r).max(), np.abs(q - r - (a - b)[:, None]).max(), np.abs(a - b).max())
        assert true <= found[n] + 1e-12
        assert found[n] <= 2.5 * true + 1e-3


def test_levels_hold_the_error_and_the_budget() -> None:
    random, shape = np.random.default_rng(3), (33, 33, 33)
    field = 100 + 5 * np.sin(np.indices(shape).sum(axis=0) / 9)
    _, known = bricks_of(field, 8, np.zeros((4, 4, 4)))
    steps = random.choice([0, 1e-3, 0.1, 20], (3, 4, 4, 4), p=[0.2, 0.3, 0.3, 0.2])
    known = FieldError(known.low, known.high, np.concatenate([known.errors[:1], np.cumsum(steps, axis=0)]))
    volume = {"path": "a.npy", "cmap": "bone", "clim": [80, 120], "opacity": [[80, 0.0], [120, 0.1]]}
    scene = Scene.model_validate({
        "volumes": [volume | {"opacity_unit_distance": 1.0}],
        "camera": {"position": [90, -70, 60], "focal_point": [16, 16, 16], "view_up": [0, 0, 1]},
        "image": {"size": [40, 30]},
    })  # fmt: skip
    bound, rays = bound_of(scene, known, Grid(shape), 8)
    refiner, before = Refiner(bound, known, np.ones((4, 4, 4), bool)), -1
    for error in (0.0, 1e-3, 0.05, 0.5):
        levels = refiner.within_error(rays, error)
        assert bound.trace(rays, known.of(levels), rays.pixels)[0].max() <= error
        assert levels.sum() > before, "a larger error needs fewer samples"
        before = levels.sum()
    sizes = np.array([512.0, 64, 8, 1])

    def fits(budget: float, levels: np.ndarray[Any, Any]) -> bool:
        return bool(sizes[levels].sum() <= budget)

    for budget in (1000, 9000, 64 * 512):
        levels = refiner.within_budget(rays, sizes, partial(fits, budget))
        assert budget * 0.7 <= sizes[levels].sum() <= budget
    assert refiner.within_budget(rays, sizes, partial(fits, 0)).min() == 3


def test_surroundings_are_all_26_neighbours() -> None:
    field = np.random.default_rng(0).random((5, 3, 4))
    padded = np.pad(field, 1, constant_values=0)
    shifts = [tuple(np.subtract(each, 1)) for each in np.ndindex(3, 3, 3)]
    expected = np.max([np.roll(padded, each, (0, 1, 2))[1:-1, 1:-1, 1:-1] for each in shifts], axis=0)
    assert np.array_equal(dilated(field, np.maximum), expected)
