"""Bricks wait until a ray comes to them; those behind what is opaque are neither drawn nor stored, and not missed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.content.complete import complete_scene
from clusterviz.data import open_source
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.summary import summarise
from clusterviz.gl.context import open_context
from clusterviz.partition import build_tree, leaf_pieces
from clusterviz.partition.pieces import Piece
from clusterviz.plan.content import KnownVolume, bricks_of_volume
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.render import brick_tables
from clusterviz.render.brick_atlas import BrickAtlas
from clusterviz.render.caster import Caster
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.render_result import RenderResult
from clusterviz.scene import VolumeInfo, scene_of_data

OPAQUE, FAINT = "[[0.0, 0.9], [1.0, 1.0]]", "[[0.0, 0.001], [1.0, 0.001]]"


def planned(opacity: str, residual: float = 1 / 255) -> tuple[Plan, dict[Any, Any]]:
    """A view along the volume's longest way, so that most bricks lie behind others."""
    keys = ["image.size=[24,24]", "volumes.0.clim=[0,1]", f"volumes.0.opacity={opacity}", "cluster.brick=8"]
    camera = ["camera.position=[0.1,0.2,-6]", "camera.focal_point=[0,0,0]", "camera.view_up=[0,1,0]"]
    scene = scene_of_data("field:ramp:41", [*keys, *camera, f"quality.early_termination={residual}"])
    source = open_source("field:ramp:41", None)
    layout = BrickLayout(source.grid.shape_zyx, 8)
    samples = list(read_bricks(source, layout, np.ndindex(*layout.counts_zyx)))
    summary = summarise(source.dtype, layout, lambda: iter(samples), lambda value: [value])
    info = VolumeInfo(source.grid.shape_zyx, source.grid.spacing, source.grid.corners, 0.0, 1.0, 0.01, 0.99)
    known = KnownVolume(source, layout, summary)
    return make_plan(complete_scene(scene, info), [known]), bricks_of_volume(layout, samples)


def whole(plan: Plan) -> Piece:
    (piece,) = leaf_pieces(build_tree(plan.cost, 1), plan.cost, None, plan.view.forward)
    return piece


def drawn(plan: Plan, bricks: dict[Any, Any]) -> tuple[RenderResult, Caster]:
    caster = opengl_caster(open_context(), plan)
    caster.load(plan, dict(bricks))
    (found,) = caster.draw(plan, [whole(plan)])
    return found, caster


@pytest.mark.gl
def test_occluded_bricks_are_neither_drawn_nor_stored_and_the_picture_is_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan, bricks = planned(OPAQUE)
    found, caster = drawn(plan, bricks)
    assert found.bricks + found.occluded == len(bricks) == len(caster.pool.bricks)
    assert found.occluded > len(bricks) / 2
    assert caster.pool.voxels <= found.bricks * 9**3 < 125 * 9**3
    monkeypatch.setattr(brick_tables, "waits_for_rays", lambda _: False)
    all_drawn, _ = drawn(plan, bricks)
    assert (all_drawn.bricks, all_drawn.occluded) == (len(bricks), 0)
    assert found.samples == all_drawn.samples
    assert np.array_equal(found.partial.rgba, all_drawn.partial.rgba)


@pytest.mark.gl
def test_what_can_be_seen_through_hides_nothing() -> None:
    plan, bricks = planned(FAINT)
    found, _ = drawn(plan, bricks)
    assert (found.bricks, found.occluded) == (len(bricks), 0)
    plain, _ = drawn(*planned(FAINT, 0.0))
    assert np.abs(found.partial.rgba - plain.partial.rgba).max() < 1e-6


@pytest.mark.gl
def test_a_brick_that_waits_is_stored_when_another_view_reaches_it() -> None:
    plan, bricks = planned(OPAQUE)
    found, caster = drawn(plan, bricks)
    back, _ = planned(FAINT)
    caster.compile(back)
    (again,) = caster.draw(back, [whole(back)])
    assert (again.bricks, again.occluded) == (len(bricks), 0)
    assert caster.pool.voxels > 2 * found.bricks
    caster.drop(list(bricks)[:5])
    assert len(caster.pool.bricks) == len(bricks) - 5


@pytest.mark.gl
def test_bricks_that_do_not_fit_into_one_buffer_while_rays_wait_are_drawn_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As on a card without memory for a buffer that grows."""
    plan, bricks = planned(FAINT)
    expected, _ = drawn(plan, bricks)

    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(BrickAtlas, "grown", full)
    found, caster = drawn(plan, bricks)
    assert len(list(caster.pool.parts(plan, np.array(sorted(bricks))))) > 1
    assert np.abs(found.partial.rgba - expected.partial.rgba).max() < 1e-6
    assert found.bricks == len(bricks)
