"""Settings that are asked for and not used as given are told, each with what is used instead."""

from __future__ import annotations

import warnings
from typing import Any

import pytest

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.frame import FrameLoop, Options
from clusterviz.plan.blend_mode import step_of
from clusterviz.plan.plan import changed_settings
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

PREINTEGRATED = {"classification": "pre-integrated"}
SURFACES = {"isosurfaces": [0.5], "opacity": 0.3}


def scene_of(**settings: Any) -> Scene:
    plain = scene_of_data("field:gaussian:9", ["image.size=[4,3]", "volumes.0.clim=[0,1]"])
    return with_settings(plain, settings)


@pytest.mark.parametrize(
    ("settings", "ranks", "told"),
    [
        ({}, 1, {}),
        ({"step": 8.0}, 1, {}),
        (PREINTEGRATED, 1, {}),
        ({"step": 2.0, "borders": "split", **PREINTEGRATED}, 1, {}),
        ({"step": 8.0, **PREINTEGRATED}, 1, {"quality.step": 2.0}),
        ({"step": 8.0, "borders": "split", **PREINTEGRATED}, 1, {"quality.step": 2.0}),
        ({"step": 4.0, **SURFACES}, 1, {"quality.step": 2.0}),
        ({"interpolation": "nearest", **PREINTEGRATED}, 1, {"quality.classification": "post"}),
        ({**SURFACES, **PREINTEGRATED}, 1, {"quality.classification": "post"}),
        ({"blending": "maximum", **PREINTEGRATED}, 1, {"quality.classification": "post"}),
        ({"borders": "split"}, 1, {"quality.borders": "overlap"}),
        ({"jitter": True, **SURFACES}, 1, {"quality.jitter": False}),
        ({"renderer": "slices", **SURFACES}, 1, {"quality.renderer": "raycast"}),
        ({"jitter": True}, 1, {}),
        ({"filter": "hardware", "interpolation": "nearest"}, 1, {"quality.filter": "exact"}),
        ({"blending": "average", "early_termination": 0.01}, 1, {"quality.early_termination": 0.0}),
        ({"blending": "isosurface", "early_termination": 0.01, **SURFACES}, 1, {}),
        ({"blending": "minimum", "shade": True}, 1, {"volumes[0].shade": False}),
        ({"distribution": "replicated", "copies": 3}, 2, {"cluster.copies": 2}),
        ({"mode": "hybrid"}, 2, {"cluster.mode": "sort-last"}),
        ({"mode": "hybrid"}, 4, {}),
    ],
)
def test_what_is_changed_is_told(settings: dict[str, Any], ranks: int, told: dict[str, Any]) -> None:
    scene = scene_of(**settings)
    assert {change.key: change.used for change in changed_settings(scene, ranks)} == told
    assert told.get("quality.step", scene.quality.step) == step_of(
        scene.volumes[0], scene.quality.step, scene.quality.classification
    )


def test_of_several_volumes_the_one_that_is_changed_is_named() -> None:
    data = scene_of(**PREINTEGRATED).model_dump(mode="json", exclude_unset=True)
    nearest = data["volumes"][0] | {"interpolation": "nearest"}
    scene = Scene.model_validate(data | {"volumes": [data["volumes"][0], nearest]})
    assert [str(change).split(" (")[0] for change in changed_settings(scene, 1)] == [
        "quality.classification: post in volumes[1] is used instead of pre-integrated"
    ]


@pytest.mark.gl
def test_it_stands_in_the_statistics_and_rank_0_warns_once() -> None:
    scene = scene_of(step=8.0, **PREINTEGRATED)

    def drawn(channel: Any) -> list[Any]:
        with FrameLoop(scene, channel, options=Options(overlap=False)) as loop:
            return [loop.frame(number=number).statistics.as_json()["changes"] for number in range(2)]

    with pytest.warns(UserWarning, match=r"quality.step: 2.0 is used instead of 8.0") as caught:
        found = run_loopback(2, drawn)
    assert len(caught) == 1
    for changes in (one for each in found for one in each):
        assert [(change["key"], change["asked"], change["used"]) for change in changes] == [("quality.step", 8.0, 2.0)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with FrameLoop(scene_of(), LoopbackChannel()) as loop:
            assert loop.frame().statistics.changes == ()
