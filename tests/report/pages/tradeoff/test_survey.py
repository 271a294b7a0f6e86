"""The page's arithmetic beside the float64 oracle, for five kinds of scenes: errors, and what is recommended."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.report.pages.tradeoff.knobs import settings_of
from clusterviz.report.pages.tradeoff.measure import measure
from clusterviz.report.pages.tradeoff.rating import by_rms, error_of, verdict
from clusterviz.report.pages.tradeoff.survey import Survey
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.settings import with_settings

ROUNDING = 2.0**-24  # of pictures, which are float32
SECOND = {"path": "field:gaussian:9", "clim": [0.0, 1.0], "opacity": 0.2, "shade": True}
PEAK = [[0.0, 0.0], [0.45, 0.0], [0.5, 0.8], [0.55, 0.0]]
KINDS: dict[str, dict[str, Any]] = {
    "composite": {"opacity": [[0.2, 0.0], [0.6, 0.5], [1.0, 0.1]]},
    "pre-integrated": {"opacity": PEAK, "classification": "pre-integrated", "step": 2.0},
    "projection": {"blending": "maximum"},
    "isosurface": {"blending": "isosurface", "isosurfaces": [0.4, 0.6], "opacity": 0.5},
    "several, lit": {"opacity": PEAK, "shade": True},
}


def scene_of(kind: str) -> Scene:
    plain = scene_of_data("field:marschner-lobb:12", ["image.size=[14,10]", "volumes.0.clim=[0,1]"])
    scene = with_settings(plain, KINDS[kind])
    if not kind.startswith("several"):
        return scene
    data = scene.model_dump(mode="json", exclude_unset=True)
    return Scene.model_validate(data | {"volumes": [*data["volumes"], SECOND]})


def oracle(scene: Scene, step: float) -> Any:
    sources = [open_source(volume.path, volume.array) for volume in scene.volumes]
    voxels = [one.read((0, 0, 0), one.grid.shape_zyx) for one in sources]
    return render_reference(with_settings(scene, {"classification": "post"}), [s.grid for s in sources], voxels, step)


@pytest.mark.gl
@pytest.mark.parametrize(
    ("kind", "budget"), [("composite", 60.0), ("composite", 0.0), *((kind, 0.0) for kind in list(KINDS)[1:])]
)
def test_errors_are_those_of_the_oracle_and_nothing_worse_is_recommended(kind: str, budget: float) -> None:
    settings = settings_of(scene_of(kind), 1, ["step", "classification", "early_termination"], 10)
    survey = Survey(*settings, ranks=1, frames=1, rounds=1, budget_seconds=budget)

    def job(scene: Scene, frames: int, warm_up: int = 1) -> Any:
        return measure(scene, LoopbackChannel(), frames, warm_up)

    report = survey.run(kind, scene_of(kind), job, lambda step: None)
    assert not report.failed
    truth, rated = report.truth, report.rated
    assert truth.source == ("reference" if budget else "renderer")
    exact = oracle(report.scene, 1 / 40)
    unsure = compare(oracle(report.scene, 1 / 20), exact)
    largest, rms = [], []
    for one in rated:
        really = compare(one.image.astype(np.float64), exact)
        largest.append(really.max)
        rms.append(really.rms)
        assert really.rms <= one.rms + truth.rms + unsure.rms + ROUNDING
        if not by_rms(truth):
            assert really.max <= one.max + truth.max + unsure.max + ROUNDING
    errors = rms if by_rms(truth) else largest
    slack = ROUNDING + (unsure.rms if by_rms(truth) else unsure.max)
    assert all(e <= error_of(one, truth) + slack for e, one in zip(errors, rated, strict=True))
    # Whichever setting were the fastest, only one that is as exact may be called so.
    for one, error in zip(rated[1:], errors[1:], strict=True):
        fast = replace(one, cost=replace(one.cost, total_seconds=1e-9))
        text = verdict([rated[0], fast], truth)
        if any("at no larger error" in sentence and sentence.startswith("With") for sentence in text):
            assert error <= errors[0] + 2 * (truth.rms if by_rms(truth) else truth.max) + slack
            assert one.rms <= rated[0].rms
