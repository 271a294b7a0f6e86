"""Calibration: error bounds hold against the float64 reference, and every renderer gets the same settings."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from clusterviz import frame
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.composite import rounding_bound
from clusterviz.data import open_source
from clusterviz.errors import SceneError
from clusterviz.frame import FrameLoop, Options, Run, render_frame
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.report.decisions import Accuracy
from clusterviz.scene import Scene, scene_of_data

RAMP = "[[0.2, 0.0], [0.6, 0.5], [1.0, 0.1]]"
PEAK = "[[0.0, 0.0], [0.45, 0.0], [0.5, 0.8], [0.55, 0.0]]"
JUMP = "[[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [1.0, 0.5]]"

VIEW = ["automatic=false", "camera.position=[3.864, 3.864, 3.864]", "camera.focal_point=[0, 0, 0]"]


def scene_of(field: str, opacity: str, bound: float, *more: str) -> Scene:
    keys = ["image.size=[28,20]", "volumes.0.clim=[0,1]", f"volumes.0.opacity={opacity}", "cluster.brick=8"]
    return scene_of_data(f"field:{field}:16", [*VIEW, *keys, f"quality.max_error={bound}", *more])


def accuracy_of(rendered: Any) -> Accuracy:
    assert rendered.statistics.accuracy is not None
    return rendered.statistics.accuracy  # type: ignore[no-any-return]


@pytest.mark.gl
@pytest.mark.parametrize(
    ("field", "opacity", "bound"),
    [("gaussian", RAMP, 1e-3), ("marschner-lobb", PEAK, 2 / 255), ("hydrogen", JUMP, 1 / 255)],
)
def test_the_bound_is_held(field: str, opacity: str, bound: float) -> None:
    rendered = render_frame(scene_of(field, opacity, bound), LoopbackChannel())
    accuracy = accuracy_of(rendered)
    source = open_source(f"field:{field}:16", None)
    truth = render_reference(rendered.scene, source.grid, source.read((0, 0, 0), source.grid.shape_zyx), 1 / 100)
    difference = compare(rendered.image.astype(np.float64), truth)  # type: ignore[union-attr]
    assert accuracy.reached
    assert difference.max <= accuracy.error <= bound
    assert rendered.scene.quality.step == accuracy.step
    assert rendered.scene.quality.max_error is None


@pytest.mark.gl
def test_what_is_chosen_depends_neither_on_ranks_nor_on_bricks() -> None:
    chosen = []
    for ranks, brick in ((1, 8), (3, 5)):
        scene = scene_of("marschner-lobb", PEAK, 2 / 255, f"cluster.brick={brick}")
        every = run_loopback(ranks, lambda channel, scene=scene: accuracy_of(render_frame(scene, channel)))
        assert {(a.step, a.classification) for a in every} == {(every[0].step, every[0].classification)}
        chosen.append(every[0])
    for other in chosen[1:]:
        assert (other.step, other.classification) == (chosen[0].step, chosen[0].classification)
        errors = [
            one.error - (rounding_bound(one.pixel, 3) if one.pixel != "float32" else 0) for one in (other, chosen[0])
        ]
        assert errors[0] == pytest.approx(errors[1], rel=1e-3)


@pytest.mark.gl
def test_a_bound_out_of_reach_is_drawn_as_well_as_can_be_and_told_once() -> None:
    scene = scene_of("hydrogen", JUMP, 1e-7)
    with FrameLoop(scene, LoopbackChannel()) as loop:
        with pytest.warns(UserWarning, match=r"max_error 1e-07 is out of reach: the error may be about"):
            first = loop.frame()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            loop.frame(number=1)
    assert not accuracy_of(first).reached
    assert accuracy_of(first).error < 0.1


def test_what_draws_without_frames_refuses_to_choose() -> None:
    with pytest.raises(SceneError, match=r"quality.max_error: no settings are chosen here; found 0.001"):
        frame.prepare(Run(LoopbackChannel(), Options()), scene_of("gaussian", RAMP, 1e-3))
