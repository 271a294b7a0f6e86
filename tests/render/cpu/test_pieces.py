"""Transfer functions as few polynomials: as exact as hundreds of chords, and given up where they would be many."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.scenes import camera_at, draw, noise, prepare, scene_of, whole

from clusterviz.data.source import Grid
from clusterviz.plan.plan import Plan
from clusterviz.reference import render_reference
from clusterviz.render.cpu.pieces import COLOUR, DEGREE, MOST, OPACITY, PER_LENGTH, START, pieces_of

SHAPE = (12, 13, 14)
VOXELS = noise(SHAPE)
RAMP = ((0.0, 0.0), (0.3, 0.02), (0.6, 0.4), (1.0, 0.9))


def plan_of(**keys: Any) -> Plan:
    scene = scene_of(VOXELS, camera_at("outside", Grid(SHAPE)), clim=(0.0, 1.0), **keys)
    return prepare(scene, VOXELS).plan


def opacities(table: np.ndarray, s: np.ndarray) -> np.ndarray:
    """What the kernel makes of a table, in float32."""
    piece = (s[:, None] >= table[START, None, 1:]).sum(axis=1)
    x = (s - table[START, piece]) * table[PER_LENGTH, piece]
    found = np.zeros_like(s)
    for row in range(COLOUR - 1, OPACITY - 1, -1):
        found = found * x + table[row, piece]
    return found


@pytest.mark.parametrize("step", [0.1, 0.5, 1.0, 3.0])
def test_polynomials_are_as_good_as_chords(step: float) -> None:
    plan = plan_of(opacity=RAMP, unit=1.0, step=step)
    pieces = pieces_of(plan.volume.transfer, plan.volume.slab_units)
    assert pieces is not None
    assert pieces.fitted
    table = pieces.table
    # What lies below is never looked up.
    s = np.linspace(plan.volume.segments.transparent_below, 1.5, 4001).astype(np.float32)
    exact = -np.expm1(plan.volume.slab_units * np.log1p(-plan.volume.transfer.opacity(s.astype(np.float64))))
    assert np.abs(opacities(table, s) - exact).max() <= 1e-6
    # Far fewer than chords, of which there are so many.
    assert step == 1.0 or len(plan.volume.segments.records) > 5 * MOST


@pytest.mark.parametrize(("points", "capacity"), [(2, 4), (6, 8), (11, 16)])
def test_few_pieces_are_found_in_few_steps(points: int, capacity: int) -> None:
    """And what lies in front of all that is visible is not among them."""
    values = np.linspace(0.5, 1.0, points)
    opacity = ((0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.3, 0.0), *((float(x), 0.1 * k) for k, x in enumerate(values)))
    plan = plan_of(opacity=opacity, cmap=((0.0, 1.0, 0.1, 0.0), (1.0, 0.0, 0.25, 1.0)), unit=1.0)
    pieces = pieces_of(plan.volume.transfer, plan.volume.slab_units)
    assert pieces is not None
    assert pieces.capacity == capacity
    assert pieces.table[START, 0] == np.float32(0.5)


def test_many_pieces_are_not_held_in_registers() -> None:
    points = tuple((float(x), 0.3) for x in np.linspace(0, 1, MOST + 4))
    assert pieces_of(plan_of(opacity=points).volume.transfer, 1.0) is None
    assert DEGREE > 1


@pytest.mark.parametrize(
    ("opacity", "unit"),
    [
        (RAMP, 2.0),
        (((0.0, 0.1), (0.5, 0.1), (0.5, 0.7), (1.0, 0.0)), 2.0),
        (0.3, 2.0),
        (((0.0, 0.0), (1.0, 1.0)), 20.0),
    ],
    ids=["ramp", "step", "even", "opaque"],
)
def test_few_and_many_pieces_give_the_same_picture(opacity: Any, unit: float) -> None:
    """The same function with more control points than fit. Near an opacity of 1 no polynomial fits a thin slab's."""
    grid, camera = Grid(SHAPE), camera_at("outside", Grid(SHAPE))
    colours = ((0.0, 1.0, 0.1, 0.0), (1.0, 0.0, 0.25, 1.0))
    mixed = tuple(
        (x, *(np.array(colours[0][1:]) * (1 - x) + np.array(colours[1][1:]) * x)) for x in np.linspace(0, 1, 40)
    )
    for cmap in (colours, mixed):
        scene = scene_of(VOXELS, camera, clim=(0.0, 1.0), opacity=opacity, cmap=cmap, unit=unit, step=0.6)
        prepared = prepare(scene, VOXELS, grid)
        pieces = pieces_of(prepared.plan.volume.transfer, prepared.plan.volume.slab_units)
        assert (pieces is None) == (cmap is mixed)
        assert pieces is None or pieces.fitted == (unit < 20.0)
        found = whole(draw(None, prepared).partial, scene.image.size)
        assert np.abs(found - render_reference(scene, grid, VOXELS)).max() <= 1e-5
