"""The frame loop: what it reports, in which order, and how it fails."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import pytest
from frame.views import ALL, CORE, HIDDEN, check_same, draw_all, on_ranks, pixels

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.content.volume import opening
from clusterviz.data.memory import ArraySource
from clusterviz.errors import ClustervizError, DataError, InputError, RankError
from clusterviz.frame import STEPS, Options, Rendered, compositing, render_frame
from clusterviz.render import opengl
from clusterviz.render.caster import Caster
from clusterviz.report.statistics import STAGES, statistics_file
from clusterviz.scene import Scene, Volume, scene_of_data
from clusterviz.scene.blend_modes import BLEND_MODES, Blending
from clusterviz.scene.overrides import with_settings

SCENE = scene_of_data("field:gaussian:16", ["automatic=false", "image.size=[24,18]", "cluster.brick=8"])


def draw(ranks: int, **options: Any) -> list[Rendered]:
    return run_loopback(ranks, lambda channel: render_frame(SCENE, channel, options=Options(**options)))


@pytest.mark.gl
def test_every_rank_hears_of_every_step_in_order() -> None:
    heard: dict[int, list[str]] = {}

    def render(channel: Any) -> None:
        steps = heard.setdefault(channel.rank, [])
        render_frame(SCENE, channel, options=Options(check=True, progress=lambda step, done=0.0: steps.append(step)))

    run_loopback(3, render)
    for steps in heard.values():
        assert list(dict.fromkeys(steps)) == list(STEPS)
        assert [STEPS.index(step) for step in steps] == sorted(STEPS.index(step) for step in steps)


@pytest.mark.gl
def test_statistics_name_every_stage_and_count_what_was_done() -> None:
    scene = with_settings(SCENE, {"transport": "messages"})
    rendered = run_loopback(3, lambda channel: render_frame(scene, channel))[0]
    report = statistics_file(rendered.scene.model_dump(mode="json"), [rendered.statistics], {"imports": 1.0})
    (told,) = report["frames"]
    assert (report["ranks"], report["size"]) == (3, [24, 18])
    assert report["renderer"]
    assert set(told["seconds"]) >= {*STAGES, "total"}
    assert sum(rank["voxels"] for rank in told["per_rank"]) >= 16**3
    assert sum(rank["bricks"] for rank in told["per_rank"]) == 8
    assert sum(rank["samples"] for rank in told["per_rank"]) > 0
    assert sum(rank["messages_sent"] for rank in told["per_rank"]) > 0
    assert told["imbalance"] >= 1
    for rank in told["per_rank"]:
        assert rank["seconds"]["render"] > 0
        spent = sum(seconds for name, seconds in rank["seconds"].items() if name != "total")
        assert spent <= rank["seconds"]["total"]


@pytest.mark.gl
def test_the_picture_is_given_to_write_on_rank_0_only() -> None:
    written: list[tuple[int, ...]] = []
    draw(3, write=lambda image, scene, made: written.append(image.shape))
    assert written == [(18, 24, 4)]


@pytest.mark.gl
def test_the_source_is_read_brick_by_brick_and_no_more_than_needed() -> None:
    """A rank that owns an eighth of the volume never asks for the whole."""
    boxes: dict[int, int] = {}

    class Counting(ArraySource):
        rank = 0

        def read(self, begin_zyx: Any, end_zyx: Any) -> Any:
            boxes[self.rank] = boxes.get(self.rank, 0) + int(np.prod(np.subtract(end_zyx, begin_zyx)))
            return super().read(begin_zyx, end_zyx)

    voxels = np.random.default_rng(0).random((33, 33, 33))
    scene = with_settings(Scene(volumes=(Volume(path="array"),)), {"size": (24, 18), "brick": 8, "opacity": 0.1})

    def render(channel: Any) -> None:
        source = Counting(voxels)
        source.rank = channel.rank
        render_frame(scene, channel, source)

    run_loopback(8, render)
    assert sorted(boxes) == list(range(8))
    # Two layers of bricks, 9 planes of samples each.
    assert max(boxes.values()) <= 2 * 9 * 17 * 17


@pytest.mark.gl
def test_check_tells_a_wrong_compositing_from_a_right_one(monkeypatch: pytest.MonkeyPatch) -> None:
    right = compositing.collect
    calls: list[int] = []

    def wrong(piece: Any, size: Any, channel: Any) -> Any:
        image = right(piece, size, channel)
        calls.append(1)
        if image is not None and len(calls) == 1:
            image[3, 4] += 0.5
        return image

    monkeypatch.setattr(compositing, "collect", wrong)
    with pytest.raises(ClustervizError, match=r"serial compositing disagree: .* row 3, column 4"):
        draw(1, check=True)


def test_what_all_ranks_find_wrong_comes_out_as_it_is() -> None:
    missing = scene_of_data("none.npy")
    with pytest.raises(DataError, match="no such file"):
        run_loopback(3, lambda channel: render_frame(missing, channel))


@pytest.mark.gl
def test_what_one_rank_finds_wrong_is_raised_on_all() -> None:
    raised: dict[int, str] = {}

    class Broken(ArraySource):
        def read(self, begin_zyx: Any, end_zyx: Any) -> Any:
            raise DataError("ends early", where="a.npy")

    def render(channel: Any) -> None:
        source = (Broken if channel.rank == 1 else ArraySource)(np.zeros((16, 16, 16)))
        try:
            render_frame(SCENE, channel, source)
        except RankError as error:
            raised[channel.rank] = str(error)

    run_loopback(3, render)
    assert raised == dict.fromkeys(range(3), "rank 1, frame 0, read: a.npy: ends early")


@pytest.mark.gl
def test_a_share_larger_than_the_memory_is_read_again_and_gives_the_same_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = draw(2)[0]
    monkeypatch.setattr(opening, "HELD_SHARE_OF_MEMORY", 0.0)
    np.testing.assert_array_equal(pixels(draw(2)[0]), pixels(plain))


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize("blending", ["maximum", "average", "local-maximum", "first-hit"])
def test_projections_are_composited_as_asked_and_give_one_picture(blending: Blending) -> None:
    look = {"blending": blending} | ({"threshold": 0.3} if BLEND_MODES[blending].threshold else {})
    scene = with_settings(SCENE, look)
    alone = pixels(render_frame(scene, LoopbackChannel()))
    for transport, algorithm in (("messages", "binary-swap"), ("messages", "tree"), ("shared", "auto")):
        asked = with_settings(scene, {"transport": transport, "compositing": algorithm})
        made = run_loopback(3, lambda channel: render_frame(asked, channel, options=Options(check=True)))[0]  # noqa: B023
        assert np.abs(pixels(made) - alone).max() <= (1e-5 if blending == "average" else 1e-6)
        told = [(rank.compositing["transport"], rank.compositing["algorithm"]) for rank in made.statistics.per_rank]
        assert told == [(transport, "direct-send" if algorithm == "auto" else algorithm)] * 3
        sent = sum(rank.messages_sent for rank in made.statistics.per_rank)
        assert (sent > 0) == (transport == "messages")


CAMERAS = ((60.0, 10.0, 5.0), (-40.0, 30.0, 9.0), (7.0, 7.0, -50.0), (8.0, 7.0, 6.0))
LOOKS = ({}, {"blending": "maximum"}, {"shade": True}, {"interpolation": "cubic", "filter": "exact"})


def scenes_of(look: dict[str, Any], path: str = "field:gaussian:16") -> list[Scene]:
    """Every camera; transfer functions that show nothing, little, all, with another range; another size and mode."""
    first = with_settings(
        scene_of_data(path, ["automatic=false", "image.size=[24,18]", "cluster.brick=8"]), {"clim": (0.0, 1.0)} | look
    )
    changes: list[dict[str, Any]] = [{"position": camera, "focal_point": (7.5, 7.5, 7.5)} for camera in CAMERAS]
    changes += [{"opacity": points} for points in (HIDDEN, CORE, ALL)]
    changes += [{"opacity": ALL, "clim": (0.2, 0.9), "cmap": "viridis"}, {"opacity": CORE}]
    changes += [{"size": (9, 13)}, {"blending": "minimum"}]
    return [with_settings(first, change) for change in changes]


def check_frames(frames: list[Rendered], scenes: list[Scene]) -> None:
    """Each is what is drawn alone."""
    check_same(frames, [render_frame(scene, LoopbackChannel()) for scene in scenes])


@pytest.mark.cover("{'interpolation': 'cubic', 'filter': 'exact'}-1")
@pytest.mark.gl
@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.parametrize("look", LOOKS, ids=str)
def test_every_frame_of_a_loop_is_what_is_drawn_alone(look: dict[str, Any], ranks: int) -> None:
    scenes = scenes_of(look)
    frames = on_ranks(ranks, scenes, keep_bricks=ranks == 3)
    check_frames(frames, scenes)
    assert [frame_.statistics.number for frame_ in frames] == list(range(len(scenes)))


@pytest.mark.gl
@pytest.mark.mpi(ranks=[1, 3], timeout=120)
def test_every_frame_of_a_loop_is_what_is_drawn_alone_over_mpi(mpi_ranks: int) -> None:
    channel = MpiChannel()
    scenes = scenes_of({})
    frames = draw_all(scenes, channel)
    assert len(frames[0].statistics.per_rank) == mpi_ranks
    if channel.rank == 0:
        check_frames(frames, scenes)
    channel.close()


@pytest.mark.gl
@pytest.mark.parametrize("device", ["0", ""], ids=["opengl", "cpu"])
def test_another_camera_reads_compiles_and_uploads_nothing(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLUSTERVIZ_EGL_DEVICE", device)
    done: list[str] = []
    for name in ("__init__", "load"):
        right = getattr(Caster, name)
        noted = lambda *a, name=name, right=right, **k: (done.append(name), right(*a, **k))[1]  # noqa: E731
        monkeypatch.setattr(Caster, name, noted)
    read = opening.read_bricks
    monkeypatch.setattr(opening, "read_bricks", lambda *a: (done.append("read"), read(*a))[1])
    scenes = scenes_of({})[: len(CAMERAS)]
    on_ranks(1, scenes)
    assert sorted(done) == ["__init__", "load", "read"]


@pytest.mark.gl
def test_chunks_are_ordered_anew_for_every_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bricks that need several buffers: each view has its own order of them."""
    monkeypatch.setenv("CLUSTERVIZ_EGL_DEVICE", "0")
    scenes = scenes_of({})[: len(CAMERAS)]
    alone = [render_frame(scene, LoopbackChannel()) for scene in scenes]
    monkeypatch.setattr(opengl, "capacity", lambda *_: 2)
    check_same(on_ranks(1, scenes), alone)


@pytest.mark.gl
def test_a_camera_that_sees_nothing_gives_a_blank_frame_and_the_next_is_right() -> None:
    scenes = scenes_of({})[:2]
    away = with_settings(scenes[0], {"position": (60.0, 10.0, 5.0), "focal_point": (90.0, 10.0, 5.0)})
    frames = on_ranks(3, [scenes[0], away, scenes[1]])
    assert not pixels(frames[1]).any()
    check_frames(frames, [scenes[0], away, scenes[1]])


@pytest.mark.gl
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"brick": 4}, "cluster.brick: was 8, is 4"),
        ({"spacing": (1.0, 1.0, 2.0)}, "volumes[0].spacing: was null, is [1.0, 1.0, 2.0]"),
        ({"shade": True}, "bricks lack the margin"),
    ],
)
def test_a_frame_that_differs_in_more_is_refused(change: dict[str, Any], said: str) -> None:
    first = scenes_of({})[0]
    with pytest.raises(InputError) as raised:
        on_ranks(2, [first, with_settings(first, change)])
    assert said in str(raised.value)


@pytest.mark.gl
def test_a_failure_names_the_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLUSTERVIZ_EGL_DEVICE", "0")
    scenes, right = scenes_of({})[:3], Caster.draw
    calls: list[int] = []

    def fail_later(*given: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == 3:
            raise ValueError("odd")
        return right(*given, **options)

    monkeypatch.setattr(Caster, "draw", fail_later)
    with pytest.raises(RankError, match="rank 0, frame 2, render: ValueError: odd"):
        on_ranks(1, scenes)


@pytest.mark.cover("0-0.1")
@pytest.mark.gl
@pytest.mark.parametrize(("device", "step"), [("cpu", 0.002), (0, 0.1)])
def test_drawing_tells_how_far_it_is(device: Any, step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A large picture is drawn in bands by OpenGL, which change nothing in it."""
    casting, threads = (import_module(f"clusterviz.{name}") for name in ("render.caster", "spmd.threads"))
    settings = ["image.size=[90, 70]", f"quality.step={step}", "cluster.brick=8"]
    scene = scene_of_data("field:marschner-lobb:20", settings)
    told: list[float] = []

    def tell(step: str, done: float = 0.0) -> None:
        told.extend([done] if step == "render" and done else [])

    at_once = render_frame(scene, LoopbackChannel(), None, Options(device=device))
    monkeypatch.setattr(threads, "REPORT_SECONDS", 0.0)
    monkeypatch.setattr(casting, "BAND_SECONDS", 0.0)
    monkeypatch.setattr(casting, "MOST_PIXELS_AT_ONCE", 1 << 10)
    in_parts = render_frame(scene, LoopbackChannel(), None, Options(device=device, progress=tell))
    assert np.array_equal(pixels(in_parts), pixels(at_once))
    assert len(told) > 1
    assert told == sorted(told)
    assert 0 < told[0] < told[-1] <= 1
