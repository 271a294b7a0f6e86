"""Quality settings alone and in combinations, none twice."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from clusterviz.errors import InputError
from clusterviz.report.pages.tradeoff.knobs import (
    KNOBS,
    changed,
    exact_settings,
    parse_knobs,
    settings_of,
    value_of,
)
from clusterviz.scene import Cluster, Quality, Scene, Volume
from clusterviz.scene.validation_messages import KEY_PATHS

SCENE = Scene(volumes=(Volume(path="field:ramp:8"),))
ALL = [knob.name for knob in KNOBS]


def test_every_key_of_quality_is_a_knob() -> None:
    assert set(Quality.model_fields) <= set(ALL)
    assert set(ALL) <= set(KEY_PATHS)


def test_names_come_from_the_scenes_own_types() -> None:
    choices = {knob.name: knob.choices for knob in KNOBS}
    assert choices["filter"] == get_args(Quality.model_fields["filter"].annotation)
    assert set(choices["transport"]) == set(get_args(Cluster.model_fields["transport"].annotation)) - {"auto"}
    assert set(choices["codec"]) <= set(get_args(Cluster.model_fields["codec"].annotation))


def test_the_scene_comes_first_then_each_value_alone_then_combinations() -> None:
    settings, left_out = settings_of(SCENE, 2, ["step", "filter", "early_termination", "brick"], 1000)
    kinds = [setting.kind for setting in settings]
    assert (kinds[0], left_out) == ("scene", 0)
    assert kinds == sorted(kinds, key=["scene", "alone", "control", "together"].index)
    alone = {str(setting) for setting in settings if setting.kind == "alone"}
    assert {"step 0.5", "filter hardware", "early_termination 1/255"} <= alone
    assert "step 1" not in alone  # the scene's own
    together = [dict(setting.changes) for setting in settings if setting.kind == "together"]
    assert {"step": 2.0, "filter": "hardware", "early_termination": 1 / 255} in together
    assert all("brick" not in changes for changes in together)
    bounds = [setting for setting in settings_of(SCENE, 1, ALL, 1000)[0] if "max_error" in setting.changes]
    assert bounds
    assert all(setting.kind == "alone" for setting in bounds)
    assert len({str(setting) for setting in settings}) == len(settings)


def test_what_only_several_ranks_do_is_not_tried_on_one() -> None:
    assert not [setting for setting in settings_of(SCENE, 1, ALL, 1000)[0] if "codec" in setting.changes]
    assert [setting for setting in settings_of(SCENE, 2, ALL, 1000)[0] if "codec" in setting.changes]


def test_combinations_of_many_changes_are_left_out_first() -> None:
    every, _ = settings_of(SCENE, 1, ALL, 1000)
    some, left_out = settings_of(SCENE, 1, ALL, len(every) - 2)
    assert (len(some), left_out) == (len(every) - 2, 2)
    assert max(len(s.changes) for s in every[-2:]) >= max(len(s.changes) for s in some)
    singles = [setting for setting in every if setting.kind != "together"]
    assert settings_of(SCENE, 1, ALL, 1)[0] == singles


def test_a_setting_is_in_the_scene_that_it_changes() -> None:
    for setting in settings_of(SCENE, 2, ALL, 1000)[0]:
        scene = changed(SCENE, setting)
        assert {name: value_of(scene, name) for name in setting.changes} == dict(setting.changes)
        assert scene.volumes == SCENE.volumes


def test_the_exact_values_are_values_of_their_knobs() -> None:
    scene = changed(SCENE, type(settings_of(SCENE, 1, ALL, 1)[0][0])(exact_settings(), "alone"))
    assert scene.quality.early_termination == 0
    assert scene.quality.filter == "exact"


def test_unknown_knobs() -> None:
    assert parse_knobs("step, brick") == ["step", "brick"]
    assert parse_knobs(None) == ALL
    with pytest.raises(InputError, match="--knobs: unknown knob; found stepp; allowed step"):
        parse_knobs("stepp")


@pytest.mark.parametrize(
    ("look", "idle"),
    [
        ({"blending": "maximum"}, {"classification", "borders", "early_termination"}),
        ({"interpolation": "nearest"}, {"classification", "borders", "filter"}),
        ({"isosurfaces": (0.5,)}, {"classification", "borders", "jitter"}),
    ],
)
def test_what_does_nothing_to_a_look_is_not_tried(look: dict[str, Any], idle: set[str]) -> None:
    scene = SCENE.model_copy(update={"volumes": (SCENE.volumes[0].model_copy(update=look),)})
    tried = {name for setting in settings_of(scene, 1, ALL, 1000)[0] for name in setting.changes}
    assert idle == {"classification", "borders", "early_termination", "filter", "jitter"} - tried


def test_steps_that_slabs_between_ends_cannot_have_are_not_tried() -> None:
    tried = [setting.changes for setting in settings_of(SCENE, 1, ALL, 1000)[0]]
    assert {"step": 4.0} in tried
    assert {"step": 2.0, "classification": "pre-integrated"} in tried
    assert {"step": 4.0, "classification": "pre-integrated"} not in tried


def test_what_several_volumes_refuse_is_not_tried() -> None:
    scene = SCENE.model_copy(update={"volumes": SCENE.volumes * 2})
    tried = [setting.changes for setting in settings_of(scene, 1, ALL, 1000)[0]]
    assert {"step": 0.5} in tried
    assert {"jitter": True} in tried
    assert not [changes for changes in tried if changes.get("filter") == "hardware"]
