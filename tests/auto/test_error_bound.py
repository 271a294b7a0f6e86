"""Error bound: held against the float64 reference, alike on any ranks, and followed from frame to frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.auto.calibration import FOLLOWED, SmallPicture, calibrate
from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.composite import rounding_bound
from clusterviz.data import open_source
from clusterviz.errors import SceneError
from clusterviz.frame import FrameLoop, Options, Run, prepare, render_frame
from clusterviz.frame.loop import planned
from clusterviz.frame.work import Planning
from clusterviz.image import compare
from clusterviz.plan.accuracy import VERIFIED_FINEST, Aim
from clusterviz.reference import render_reference
from clusterviz.report.decisions import Accuracy
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.animation import scenes_along
from clusterviz.scene.overrides import with_settings

RAMP = "[[0.2, 0.0], [0.6, 0.5], [1.0, 0.1]]"
PEAK = "[[0.0, 0.0], [0.45, 0.0], [0.5, 0.8], [0.55, 0.0]]"
JUMP = "[[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [1.0, 0.5]]"
BOUND = 4 / 255

VIEW = ["automatic=false", "camera.position=[3.864, 3.864, 3.864]", "camera.focal_point=[0, 0, 0]"]


def scene_of(field: str, opacity: str, bound: float, *more: str) -> Scene:
    keys = ["image.size=[28,20]", "volumes.0.clim=[0,1]", f"volumes.0.opacity={opacity}", "cluster.brick=8"]
    return scene_of_data(f"field:{field}:16", [*VIEW, *keys, f"quality.max_error={bound}", *more])


def turned(loop: FrameLoop) -> list[Scene]:
    """A view along an axis, of which a few long slabs see all, and one that is turned away from it."""
    camera = loop.scene.camera
    x, y, z = camera.focal_point
    position = (x, y, z + float(np.linalg.norm(np.subtract(camera.position, camera.focal_point))))
    along = camera.model_copy(update={"position": position, "view_up": (0.0, 1.0, 0.0)})
    return scenes_along(loop.scene.model_copy(update={"camera": along}), 2, 45.0)


def drawn(channel: Channel, scene: Scene) -> list[Any]:
    with FrameLoop(scene, channel, options=Options(overlap=False)) as loop:
        scenes = [one.model_copy(update={"quality": scene.quality}) for one in turned(loop)]
        return [loop.frame(one, number) for number, one in enumerate(scenes)]


def accuracy_of(rendered: Any) -> Accuracy:
    assert rendered.statistics.accuracy is not None
    return rendered.statistics.accuracy  # type: ignore[no-any-return]


def largest_errors(frames: list[Any], truths: list[Any]) -> list[float]:
    return [float(np.abs(one.image - truth.image).max()) for one, truth in zip(frames, truths, strict=True)]


@pytest.mark.cover(
    "hydrogen-[[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [1.0, 0.5]]-0.00392156862745098",
    "marschner-lobb-[[0.0, 0.0], [0.45, 0.0], [0.5, 0.8], [0.55, 0.0]]-0.00784313725490196",
)
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
    one, other = chosen
    assert (other.step, other.classification) == (one.step, one.classification)
    errors = [each.error - (rounding_bound(each.pixel, 3) if each.pixel != "float32" else 0) for each in chosen]
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)


@pytest.mark.gl
@pytest.mark.parametrize(("ranks", "opacity", "found"), [(1, PEAK, "about"), (3, PEAK, "about"), (3, JUMP, "a jump")])
def test_a_bound_out_of_reach_is_refused_on_every_rank(ranks: int, opacity: Any, found: str) -> None:
    def refused(channel: Channel) -> str:
        with pytest.raises(SceneError, match=f"max_error: 1e-07 is out of reach; found {found} .* at least") as caught:
            render_frame(scene_of("hydrogen", opacity, 1e-7), channel)
        return str(caught.value)

    assert len(set(run_loopback(ranks, refused))) == 1


@pytest.mark.parametrize(("seen_at", "level", "holds"), [(6, 7, False), (8, -1, True)])
def test_a_blank_picture_says_nothing_of_what_its_steps_miss(seen_at: int, level: int, holds: bool) -> None:
    """A first view that shows nothing is drawn down to the shortest step, where a pixel may show something."""
    steps = list[float]()

    def draw(scene: Scene) -> Planning[SmallPicture]:
        yield from ()
        steps.append(scene.quality.step)
        image = np.zeros((*scene.image.size[::-1], 4), np.float32)
        image[3, 5] = max(2.0**-seen_at / scene.quality.step // 1, 0.0) / 50
        return SmallPicture(image, 1, 0.0, "exact", False, 1)

    scene = scene_of("gaussian", RAMP, BOUND)
    nothing: Any = None
    found = planned(nothing, calibrate(scene, Aim(BOUND, 560, ("post",)), LoopbackChannel(), draw))
    assert min(steps) == 2.0**-VERIFIED_FINEST
    assert found.choice.trial.level == level
    assert (found.choice.error <= BOUND) == holds


def test_what_draws_without_frames_refuses_to_choose() -> None:
    with pytest.raises(SceneError, match=r"quality.max_error: no settings are chosen here; found 0.001"):
        prepare(Run(LoopbackChannel(), Options()), scene_of("gaussian", RAMP, 1e-3))


@pytest.mark.gl
def test_the_bound_is_held_in_views_where_the_first_choice_breaks_it() -> None:
    scene = scene_of("marschner-lobb", PEAK, BOUND)
    followed = drawn(LoopbackChannel(), scene)
    fine = {"max_error": None, "classification": "pre-integrated", "step": 1 / 64}
    truths = drawn(LoopbackChannel(), with_settings(scene, fine))
    alone = drawn(LoopbackChannel(), scene.model_copy(update={"quality": followed[0].scene.quality}))
    assert max(largest_errors(alone, truths)) > BOUND
    found = [accuracy_of(one) for one in followed]
    for error, accuracy in zip(largest_errors(followed, truths), found, strict=True):
        assert error <= accuracy.error <= BOUND
    assert found[-1].step < found[0].step


@pytest.mark.gl
def test_any_number_of_ranks_follows_alike() -> None:
    scene = scene_of("marschner-lobb", PEAK, BOUND, "image.size=[20,14]")
    chosen = []
    for ranks in (1, 3, 5):
        every = run_loopback(ranks, lambda channel: [accuracy_of(one) for one in drawn(channel, scene)])
        settings = [[(one.step, one.classification) for one in found] for found in every]
        assert settings == [settings[0]] * ranks
        chosen.append(settings[0])
    assert chosen == [chosen[0]] * 3


@pytest.mark.gl
def test_following_costs_a_small_share_of_a_frame_and_a_view_that_was_seen_nothing() -> None:
    with FrameLoop(scene_of("gaussian", RAMP, 1e-3, "image.size=[192,160]"), LoopbackChannel()) as loop:
        scenes = scenes_along(loop.scene, 3, 30.0)
        first, _, third, again = (loop.frame(scenes[number]) for number in (0, 1, 2, 2))
    samples = sum(rank.samples for rank in third.statistics.per_rank)
    assert accuracy_of(first).pilot_samples > FOLLOWED * samples
    assert 0 < accuracy_of(third).pilot_samples < 1.2 * FOLLOWED * samples
    assert accuracy_of(again).pilot_samples == accuracy_of(again).pilot_pixels == 0
    assert accuracy_of(again).error == accuracy_of(third).error


@pytest.mark.gl
def test_another_transfer_function_is_followed_and_another_bound_is_not() -> None:
    with FrameLoop(scene_of("gaussian", RAMP, 2 / 255), LoopbackChannel()) as loop:
        other = with_settings(loop.scene, {"opacity": [[0.0, 0.0], [0.5, 0.0], [0.52, 0.9], [0.6, 0.0]]})
        found = [accuracy_of(loop.frame(scene)) for scene in (loop.scene, other)]
        bounded = accuracy_of(loop.frame(with_settings(other, {"max_error": 0.1})))
    assert found[1].step < found[0].step
    assert bounded.max_error == 0.1
    assert bounded.step > found[1].step


@pytest.mark.gl
def test_fewer_bits_are_taken_where_ranks_send_and_the_bound_has_room() -> None:
    scene = scene_of("gaussian", RAMP, 0.06)
    fine = {"max_error": None, "step": 1 / 40}
    truths = drawn(LoopbackChannel(), with_settings(scene, fine))
    for ranks, formats in ((1, {"float32"}), (3, {"float16", "uint8"})):
        frames = run_loopback(ranks, lambda channel: drawn(channel, scene))[0]
        for error, frame in zip(largest_errors(frames, truths), frames, strict=True):
            accuracy = accuracy_of(frame)
            assert frame.scene.quality.pixel == accuracy.pixel
            assert accuracy.pixel in formats
            assert error <= accuracy.error <= 0.06
            assert set(accuracy.reasons) == {"step", "classification", "filter", "early_termination", "pixel"}
            assert all(accuracy.reasons.values())


@pytest.mark.long
@pytest.mark.gl
def test_the_texture_unit_is_measured_where_opengl_draws() -> None:
    scene = scene_of("gaussian", RAMP, 0.02)
    with FrameLoop(scene, LoopbackChannel(), options=Options(device=0, overlap=False)) as loop:
        frames = [loop.frame(one, number) for number, one in enumerate(scenes_along(loop.scene, 2, 20.0))]
        truth = loop.frame(with_settings(frames[0].scene, {"step": 1 / 32, "filter": "exact"}), 2)
    first, second = map(accuracy_of, frames)
    assert "hardware adds about" in first.reasons["filter"]
    assert "of the time a sample" in first.reasons["filter"]
    assert second.filter == first.filter == frames[1].scene.quality.filter
    assert largest_errors([frames[0]], [truth])[0] <= first.error <= 0.02
