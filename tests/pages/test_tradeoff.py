"""Trade-off pages: settings, ground truth, ratings, similarity, pictures and the verdict."""

from __future__ import annotations

import base64
import io
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from clusterviz.comm import LoopbackChannel
from clusterviz.content.complete import complete_scene
from clusterviz.content.geometry.section import MeshSection
from clusterviz.data import open_source
from clusterviz.errors import InputError
from clusterviz.image import compare
from clusterviz.pages.pictures import MAX_FACTOR, WIDTH, error_map_url, thumbnail_url
from clusterviz.pages.tradeoff import ground_truth
from clusterviz.pages.tradeoff.ground_truth import (
    COARSEST,
    GOAL,
    GroundTruth,
    Halving,
    converge,
    find_ground_truth,
)
from clusterviz.pages.tradeoff.knobs import (
    KNOBS,
    Setting,
    changed,
    exact_settings,
    parse_knobs,
    settings_of,
    value_of,
)
from clusterviz.pages.tradeoff.measure import Cost, measure
from clusterviz.pages.tradeoff.rating import (
    RatedSetting,
    by_rms,
    error_of,
    fastest_within,
    luminance,
    pareto_front,
    rate,
    ssim,
    verdict,
    with_front_numbers,
)
from clusterviz.pages.tradeoff.survey import Survey
from clusterviz.reference import render_reference
from clusterviz.scene import Cluster, Quality, Scene, Volume, VolumeInfo, scene_of_data
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.validation_messages import KEY_PATHS
from clusterviz.scene.values import ImageSettings

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


def test_a_lens_is_drawn_in_several_ways_and_a_pinhole_in_one() -> None:
    assert len(settings_of(SCENE, 1, ["lens"], 99)[0]) == 1
    seen = with_settings(SCENE, {"aperture": 0.1})
    tried = settings_of(seen, 1, ["lens"], 99)[0]
    assert [str(each) for each in tried[1:]] == [
        *(f"lens {count} sub images" for count in (8, 32)),  # 16 are the scene's own
        *(f"lens {count} eye points" for count in (16, 64)),
    ]
    assert changed(seen, tried[-1]).quality.lens.eye_points == 64


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


FACTS = VolumeInfo((9, 9, 9), (0.25,) * 3, 2.0 * np.mgrid[:2, :2, :2].reshape(3, -1).T - 1, 0.0, 1.0, 0.0, 1.0)


def test_of_geometry_only_what_applies_is_tried(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    alone = Scene(meshes=(MeshSection(path=str(path), opacity=0.5),), image=ImageSettings(size=(8, 8)))
    tried = {name for setting in settings_of(alone, 2, ALL, 99)[0] for name in setting.changes}
    controls = {"abuffer", "early_discarding", "codec", "transport", "brick"}
    assert tried == controls | {"early_termination", "pixel"}
    beside = alone.model_copy(update={"volumes": SCENE.volumes})
    more = {name for setting in settings_of(beside, 2, ALL, 99)[0] for name in setting.changes}
    assert more - tried == {"step", "classification", "renderer", "jitter", "max_error"}
    named = [str(setting) for setting in settings_of(alone, 1, ["abuffer"], 99)[0]]
    assert named[1:3] == ["abuffer dynamic and static", "abuffer fixed and optimised"]
    drawn = measure(changed(alone, settings_of(alone, 1, ["abuffer"], 99)[0][1]), LoopbackChannel(), 1, 0)
    assert drawn.image is not None
    assert drawn.image.any()
    assert ground_truth._reference_renderer(drawn.scene, 60.0)[0] is not None
    assert "s for a few pixels" in ground_truth._reference_renderer(drawn.scene, 0.0)[1]


def test_what_flows_become_has_a_reference() -> None:
    keys = {"flows": [{"path": "field:abc:6", "show": show} for show in ("lic", "streamlines")]}
    drawn = measure(Scene.model_validate(keys | {"image": {"size": (8, 8)}}), LoopbackChannel(), 1, 0)
    reference, why = ground_truth._reference_renderer(drawn.scene.model_copy(update={"volumes": (), "lines": ()}))
    assert reference is not None, why
    assert drawn.image is not None
    assert compare(drawn.image, reference(drawn.scene, drawn.scene.quality.step)).max < 1e-5


def scene(**settings: Any) -> Scene:
    plain = Scene(volumes=(Volume(path="field:gaussian:9", clim=(0.0, 1.0)),))
    return complete_scene(with_settings(plain, {"size": (12, 9)} | settings), FACTS)


def never(scene: Scene, step: float) -> Any:
    raise AssertionError("the renderer is not needed")


@pytest.mark.parametrize("order", [1, 2])
def test_the_estimate_is_no_smaller_than_the_error(order: int) -> None:
    limit = np.full((2, 2, 4), 0.5)
    picture, halvings = converge(lambda step: limit + 0.1 * step**order, 60)
    assert np.abs(picture - limit).max() <= halvings[-1].max * (1 + 1e-9) <= GOAL * (1 + 1e-9)
    assert [h.step for h in halvings] == [COARSEST / 2 ** (k + 1) for k in range(len(halvings))]


def test_it_ends_where_the_budget_does() -> None:
    calls: list[float] = []
    picture, halvings = converge(lambda step: calls.append(step) or np.full((1, 1, 4), step), 0)
    assert (calls, len(halvings), picture.max()) == ([0.25, 0.125], 1, 0.125)
    assert halvings[0].max == 0.125


def test_the_reference_is_taken_where_there_is_time() -> None:
    found = find_ground_truth(scene(), never, 60)
    assert (found.source, found.picture.shape, found.checked) == ("reference", (9, 12, 4), None)
    assert 0 < found.max <= GOAL
    assert found.picture.max() > 0.01
    assert "allowed" in found.why


def test_else_the_renderer_is_and_is_checked_against_float64() -> None:
    steps: list[tuple[tuple[int, int], float]] = []

    def renderer(of: Scene, step: float) -> Any:
        steps.append((of.image.size, step))
        exact = ground_truth._reference_renderer(of)[0]
        assert exact is not None
        return exact(of, step) + 1e-3

    found = find_ground_truth(scene(size=(80, 60)), renderer, 1e-9)
    assert found.source == "renderer"
    assert "more than" in found.why
    assert steps[0] == ((80, 60), 0.25)
    assert steps[-1][0] == (64, 48)
    assert found.checked is not None
    assert found.checked[0] == pytest.approx(1e-3)
    assert found.max == pytest.approx(found.halvings[-1].max + 1e-3)


@pytest.mark.parametrize("fault", ["large", "unknown"])
def test_what_the_reference_cannot_draw_is_said(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise InputError("no such look")

    if fault == "large":
        monkeypatch.setattr(ground_truth, "MAX_REFERENCE_BYTES", 100)
    else:
        monkeypatch.setattr(ground_truth, "render_lens", refuse)
    found = find_ground_truth(scene(), lambda of, step: np.full((9, 12, 4), 0.5, np.float32), 60)
    assert (found.source, found.checked, found.max) == ("renderer", None, 0)
    assert ("GiB" in found.why) if fault == "large" else ("no such look" in found.why)


LEVEL = 1 / 255
TRUTH = GroundTruth(np.full((12, 12, 4), 0.5), "reference", "", 0.1, 1e-5, 1e-6, (Halving(0.1, 1e-5, 1e-6),))
COST = Cost(0.01, 0.1, 0.1, 0.1, 1000, 1 << 20, 1 << 28, 0, 0)


def setting(seconds: float, error: float, **changes: Any) -> RatedSetting:
    kind = "alone" if changes else "scene"
    cost = replace(COST, total_seconds=seconds, total_seconds_min=seconds, total_seconds_max=seconds)
    return RatedSetting(Setting(changes, kind), cost, error, error / 10, 0, 1.0, np.zeros((1, 1, 4), np.float32))


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1))
def test_the_front_is_what_nothing_beats(points: list[tuple[int, int]]) -> None:
    front = pareto_front(points)
    best = {point for point, on in zip(points, front, strict=True) if on}
    for point, on in zip(points, front, strict=True):
        beaten = any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)
        assert on != beaten
    assert best
    assert len({x for x, _ in best}) == len(best)  # of one time only one error


@pytest.mark.parametrize(
    ("rated", "numbers"),
    [
        (
            [
                setting(0.2, 0.01),
                setting(0.1, 0.1, step=2),
                setting(0.3, 0.01, brick=32),
                setting(0.4, 0.001, step=0.5),
            ],
            [2, 1, 0, 3],
        ),
        # Below the truth's own error nothing is better.
        ([setting(0.2, 5e-6), setting(0.3, 1e-9, step=0.5), setting(0.4, 1.0, step=4.0)], [1, 0, 0]),
    ],
)
def test_the_front_is_numbered_from_the_fastest_on(rated: list[RatedSetting], numbers: list[int]) -> None:
    assert [one.front for one in with_front_numbers(rated, TRUTH)] == numbers


def test_errors_are_those_of_the_picture() -> None:
    image = np.full((12, 12, 4), 0.5, np.float32)
    image[3, 4, 1] += 0.25
    rated = rate(Setting({}, "scene"), COST, image, TRUTH, (0.0, 0.0, 0.0))
    assert (rated.max, rated.wrong_pixels) == (0.25, 1)
    assert rated.rms == pytest.approx(0.25 / np.sqrt(12 * 12 * 4))
    assert 0.5 < rated.ssim < 1
    exact = rate(Setting({}, "scene"), COST, TRUTH.picture.astype(np.float32), TRUTH, None)
    assert (exact.max, exact.wrong_pixels, exact.ssim) == (0, 0, pytest.approx(1))


def test_the_fastest_within_a_bound() -> None:
    rated = [setting(0.2, 0.01), setting(0.1, 0.1, step=2.0), setting(0.15, 0.01, brick=32)]
    assert fastest_within(rated, 0.05, TRUTH) is rated[2]
    assert fastest_within(rated, 1e-3, TRUTH) is None


SCENE_WINS = "No setting that was tried is faster at no larger error by more than the noise of the times, "
OF_8_BITS = [setting(0.2, 4 * LEVEL), setting(0.05, 4 * LEVEL, early_termination=0.01), setting(0.4, LEVEL, step=0.5)]
NOISY = replace(setting(0.2, 0.1), cost=replace(setting(0.2, 0.1).cost, total_seconds_min=0.1))
BUSY = [setting(0.2, 0.1), setting(0.12, 0.1, brick=32)]


@pytest.mark.parametrize(
    ("rated", "drift", "parts"),
    [
        (
            OF_8_BITS,
            1.0,
            [
                "takes 200 ms and errs by up to 4.1 levels of 255",
                "With early_termination 0.01 it is 4 times faster at no larger error.",
                "within 2 levels of 8 bits is step 0.5: 400 ms",
            ],
        ),
        (
            [setting(0.1, 8 * LEVEL), setting(0.2, 4 * LEVEL, step=0.5)],
            1.0,
            [SCENE_WINS, "None comes within 2 levels of 8 bits; step 0.5 comes closest, with up to 4.1 levels of 255"],
        ),
        (
            [setting(0.1, 8 * LEVEL), setting(0.2, 4 * LEVEL, step=0.5)],
            1.0,
            ["up to 4.1 levels of 255, and takes 200 ms"],
        ),
        ([NOISY, setting(0.15, 0.1, brick=32)], 1.0, [f"{SCENE_WINS}100 %."]),  # noise is no gain
        (BUSY, 1.1, ["1.7 times faster"]),
        (BUSY, 1.8, [f"{SCENE_WINS}80 %.", "took 1.8 times as long"]),
        # An error is claimed with the truth's own, and rounded up.
        ([setting(0.1, 1e-9)], 1.0, ["errs by up to 1.1e-05 of full scale."]),
        ([setting(0.1, 4.101 * LEVEL)], 1.0, ["errs by up to 4.2 levels of 255."]),
    ],
)
def test_the_verdict_names_what_is_faster_and_what_is_exact(
    rated: list[RatedSetting], drift: float, parts: list[str]
) -> None:
    text = " ".join(verdict(rated, TRUTH, drift))
    assert [part for part in parts if part not in text] == []


@pytest.mark.parametrize("known", [True, False])
def test_a_setting_with_a_larger_error_is_not_called_as_exact_however_little_the_truth_is_known(known: bool) -> None:
    truth = TRUTH if known else replace(TRUTH, max=0.7, rms=0.2)
    rated = [setting(0.2, 0.19), setting(0.1, 0.89, step=4.0)]
    assert SCENE_WINS in " ".join(verdict(rated, truth))


def test_where_single_pixels_are_not_known_rms_errors_judge() -> None:
    """`setting` has a tenth of its largest error as rms."""
    truth = replace(TRUTH, max=0.6, rms=1e-3)
    rated = [setting(0.2, 0.5), setting(0.1, 0.05, step=0.5), setting(0.05, 0.7, step=4.0)]
    assert [one.front for one in with_front_numbers(rated, TRUTH)] == [0, 2, 1]
    assert [one.front for one in with_front_numbers(rated, truth)] == [0, 2, 1]
    assert [one.front for one in with_front_numbers(rated, replace(truth, rms=0.1))] == [0, 0, 1]
    text = " ".join(verdict(rated, truth))
    assert "errs by up to 14 levels of 255, rms" in text
    assert "not known well enough to judge by" in text
    assert "With step 0.5 it is 2 times faster at no larger error." in text


RNG = np.random.default_rng(3)


def window_by_window(x: np.ndarray, y: np.ndarray) -> float:
    """Equations 13 and 14 to 16 of the paper, one window after another, in two dimensions."""
    offset = np.arange(11) - 5
    weight = np.exp(-(offset[:, None] ** 2 + offset**2) / (2 * 1.5**2))
    weight /= weight.sum()
    found = []
    for row in range(x.shape[0] - 10):
        for column in range(x.shape[1] - 10):
            a, b = (picture[row : row + 11, column : column + 11] for picture in (x, y))
            mean_a, mean_b = (weight * a).sum(), (weight * b).sum()
            var_a, var_b = (weight * (a - mean_a) ** 2).sum(), (weight * (b - mean_b) ** 2).sum()
            cov = (weight * (a - mean_a) * (b - mean_b)).sum()
            above = (2 * mean_a * mean_b + 1e-4) * (2 * cov + 9e-4)
            found.append(above / ((mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4)))
    return float(np.mean(found))


def test_against_the_definition() -> None:
    x, y = RNG.random((14, 17)), RNG.random((14, 17))
    for a, b in ((x, y), (x, 0.9 * x + 0.05), (x, 1 - x)):
        assert ssim(a, b) == pytest.approx(window_by_window(a, b), abs=1e-12)


def test_equal_pictures_are_alike_and_opposite_ones_are_not() -> None:
    x = RNG.random((20, 20))
    assert ssim(x, x) == pytest.approx(1, abs=1e-12)
    assert ssim(x, 1 - x) < -0.5


def test_flat_pictures_differ_by_luminance_alone() -> None:
    assert ssim(np.full((12, 12), 0.2), np.full((12, 12), 0.6)) == pytest.approx(0.2401 / 0.4001, abs=1e-9)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (5, 3), (11, 11)])
def test_pictures_smaller_than_the_window(shape: tuple[int, int]) -> None:
    x = RNG.random(shape)
    assert ssim(x, x) == pytest.approx(1, abs=1e-12)
    assert ssim(x, 1 - x) < 0.99


def test_luminance_of_white_is_one_and_green_counts_most() -> None:
    grey = luminance(np.array([[[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]]))
    assert grey[0] == pytest.approx([1, 0.299, 0.587, 0.114])


def pixels(url: str) -> np.ndarray:
    head, _, data = url.partition(",")
    assert head == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_a_single_wrong_pixel_survives_being_made_smaller() -> None:
    difference = np.zeros((37, 3 * WIDTH + 1, 4))
    difference[36, 3 * WIDTH, 2] = -0.004
    url, factor = error_map_url(difference)
    seen = pixels(url)
    assert factor == 200
    assert seen.shape[1] <= WIDTH
    assert seen[-1, -1].tolist() == [255, 255, 102]  # 0.8 of full scale: red, green, and 0.4 of blue
    assert np.count_nonzero(seen.any(axis=2)) == 1


@pytest.mark.parametrize(
    ("error", "factor"), [(0.0, 1), (1.0, 1), (0.5, 2), (0.3, 2), (0.011, 50), (1e-12, MAX_FACTOR)]
)
def test_the_factor_is_round_and_makes_the_error_seen(error: float, factor: float) -> None:
    found = error_map_url(np.full((4, 4, 4), error))[1]
    assert found == pytest.approx(factor, rel=1e-12)


def test_errors_rise_from_black_to_white() -> None:
    error = np.zeros((1, 101, 4))
    error[0, :, 3] = np.linspace(0, 1, 101)
    brightness = pixels(error_map_url(error)[0]).sum(axis=2)[0].astype(int)
    assert (brightness[0], brightness[-1]) == (0, 3 * 255)
    assert (np.diff(brightness) >= 0).all()


def test_a_picture_lies_over_its_background() -> None:
    half = np.full((3, 5, 4), 0.5)
    assert pixels(thumbnail_url(half, (1.0, 0.0, 0.0)))[0, 0].tolist() == [255, 128, 128]
    assert pixels(thumbnail_url(half, None)).shape == (3, 5, 4)


@pytest.mark.gl
def test_rays_that_start_by_the_last_frame_are_timed_on_the_way_to_the_camera() -> None:
    keys = ["volumes.0.clim=[0,1]", "volumes.0.opacity=[[0,0],[0.4,0],[0.7,0.3],[1,0.9]]", "image.size=[60,50]"]
    plain = scene_of_data("field:gaussian:33", keys)
    whole, frame_coherence = (
        measure(with_settings(plain, {"frame_coherence": each}), LoopbackChannel(), frames=2) for each in (False, True)
    )
    assert frame_coherence.scene.camera == whole.scene.camera
    assert frame_coherence.image is not None
    assert whole.image is not None
    assert np.array_equal(frame_coherence.image, whole.image), "no start is too late, and places are those of windows"
    assert frame_coherence.cost.samples < whole.cost.samples


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


@pytest.mark.cover("several, lit-0.0")
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
