"""Longer slabs: fewer samples, an error far below the bound, and the same picture whatever the ranks and bricks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.data import open_source
from clusterviz.frame import Options, Rendered, render_frame
from clusterviz.gl.devices import Device
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.render.storage import Slot
from clusterviz.render.stored_brick import group_curvature
from clusterviz.scene import Scene, scene_of_data

FIELD = "field:gaussian:49"
DEVICES: tuple[Device, ...] = (0, "cpu")


def scene_of(adaptive: float, *more: str) -> Scene:
    keys = [
        "camera.position=[3.864,3.864,3.864]",
        "camera.focal_point=[0,0,0]",
        "image.size=[40,30]",
        "volumes.0.clim=[0,1]",
        "volumes.0.opacity=[[0,0],[1,0.08]]",
        "quality.step=0.25",
    ]
    return scene_of_data(FIELD, [*keys, "cluster.brick=16", f"quality.adaptive={adaptive}", *more])


def samples_of(rendered: Rendered) -> int:
    return sum(rank.samples for rank in rendered.statistics.per_rank)


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("bound", [1e-3, 1 / 64])
def test_the_bound_is_held_and_samples_are_saved(bound: float, device: Device) -> None:
    options = Options(device=device)
    rendered, whole = (render_frame(scene_of(each), LoopbackChannel(), options=options) for each in (bound, 0.0))
    source = open_source(FIELD, None)
    truth = render_reference(rendered.scene, source.grid, source.read((0, 0, 0), source.grid.shape_zyx))
    assert compare(rendered.image.astype(np.float64), truth).max < bound / 5  # type: ignore[union-attr]
    assert samples_of(rendered) < 0.7 * samples_of(whole)


@pytest.mark.gl
@pytest.mark.parametrize("device", DEVICES)
def test_stretches_depend_neither_on_ranks_nor_on_bricks_of_whole_groups(device: Device) -> None:
    options = Options(device=device)
    one, three, other = (
        run_loopback(ranks, lambda channel, keys=keys: render_frame(scene_of(1 / 64, *keys), channel, options=options))[
            0
        ]
        for ranks, keys in ((1, ()), (3, ("cluster.brick=8",)), (1, ("cluster.brick=11",)))
    )
    assert one.image is not None
    assert compare(one.image, three.image).max < 1e-6  # type: ignore[arg-type]
    assert samples_of(one) == samples_of(three)
    assert compare(one.image, other.image).max < 1 / 64 / 5  # type: ignore[arg-type]


@pytest.mark.gl
def test_both_casters_take_the_same_slabs() -> None:
    drawn = [render_frame(scene_of(1 / 64), LoopbackChannel(), options=Options(device=device)) for device in DEVICES]
    assert samples_of(drawn[0]) == samples_of(drawn[1])
    assert compare(drawn[0].image, drawn[1].image).max < 1e-6  # type: ignore[arg-type]


def plain_bend(samples: Any) -> float:
    """The largest second difference inside a group of samples."""
    along = [np.diff(samples, 2, axis) for axis in range(3)]
    mixed = [np.diff(np.diff(samples, axis=a), axis=b) for a, b in ((0, 1), (0, 2), (1, 2))]
    return max(float(np.abs(each).max()) for each in (*along, *mixed) if each.size)


@pytest.mark.parametrize("margin", [0, 1])
def test_bends_are_the_second_differences_inside_groups(margin: int) -> None:
    voxels = np.random.default_rng(5).integers(0, 256, np.add((17, 9, 12), margin)).astype(np.uint8)
    slot = Slot((24, 8, 16), "u8", False, margin=margin, adaptive=True)
    steep, bend = group_curvature(voxels, slot)
    assert bend.shape == slot.groups_zyx == (3, 1, 2)
    inside = voxels[margin:, margin:, margin:][:17, :9, :12].astype(np.float64)
    for z, x, xs in ((0, 0, 9), (1, 0, 9), (0, 1, 4), (1, 1, 4)):
        part = inside[8 * z : 8 * z + 9, :, 8 * x : 8 * x + xs]
        assert bend[z, 0, x] == plain_bend(part)
        steps = [np.abs(np.diff(part, axis=axis)).max() for axis in range(3)]
        assert steep[z, 0, x] == pytest.approx(np.linalg.norm(steps))
    assert np.all(bend[2] == 0)


def test_an_invalid_voxel_leaves_its_groups_without_a_bend() -> None:
    voxels = np.zeros((17, 9, 9), np.float32)
    voxels[8, 3, 3], voxels[14, 3, 3] = np.nan, np.inf
    _, bend = group_curvature(voxels, Slot((16, 8, 8), "f32", False, adaptive=True))
    assert np.isnan(bend).all()


def test_only_plans_that_stretch_slabs_pay_for_it() -> None:
    plain, adaptive = (Slot((16, 16, 16), "u8", False, adaptive=each) for each in (False, True))
    assert (plain.group_words, adaptive.group_words) == (1, 3)
