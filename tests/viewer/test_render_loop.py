"""The session's pictures on some ranks of this process: stills are those of `render`, and newer input ends them."""

from __future__ import annotations

import shlex
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz.comm import Channel, run_loopback
from clusterviz.data import open_scene
from clusterviz.errors import ClustervizError
from clusterviz.frame import FrameLoop, Options, render_frame
from clusterviz.image import read_image
from clusterviz.scene import Scene
from clusterviz.scene.animation import load_path
from clusterviz.spmd import threads
from clusterviz.viewer import render_loop
from clusterviz.viewer.encoding import Picture
from clusterviz.viewer.messages import Edit, KeyPose, Pick, Pose, Save, View
from clusterviz.viewer.pace import Pace
from clusterviz.viewer.render_loop import AbandonedError, Abandoning, RenderLoop
from clusterviz.viewer.saving import OpenedAs
from clusterviz.viewer.session import Session

FIELD = "field:gaussian:24"
OVERRIDES = (
    *("automatic=false", "size=[60, 44]", "clim=[0, 1]", "opacity=[[0.2, 0], [1, 0.6]]", "brick=8"),
    *("position=[4, 1, 2]", "focal_point=[0, 0, 0]", "view_up=[0, 0, 1]"),
)
CPU = Options("cpu")
"""Pictures of the CPU's kernels, which the scenes of this file share."""
PATIENCE = 60.0
Pixels = NDArray[np.float32]


class Viewer:
    """Client that waits for what it has asked for."""

    def __init__(self, session: Session) -> None:
        self._session, self._news = session, threading.Condition()
        self.messages: list[dict[str, Any]] = []
        self.pictures: list[Picture] = []
        self.stills: list[tuple[Scene, Pixels]] = []
        self._inputs = 0
        self.number = session.join(self)

    def send(self, message: dict[str, Any]) -> None:
        self._put(self.messages, message)

    def show(self, picture: Picture) -> None:
        self._put(self.pictures, picture)

    def send_file(self, save: int, name: str, media_type: str, content: bytes) -> None:
        self._put(self.messages, {"type": "file", "name": name, "content": content})

    def _put(self, to: list[Any], what: Any) -> None:
        with self._news:
            to.append(what)
            self._news.notify_all()

    def wait(self, condition: Callable[[], bool]) -> None:
        with self._news:
            assert self._news.wait_for(condition, PATIENCE), self.messages[-1]

    def receive(self, message: Any) -> None:
        self._session.receive(self.number, message)

    def still(self) -> None:
        """Keep the next still picture, and the scene that it is of."""
        wanted = {self.number: self._inputs} if self._inputs else {}
        self.wait(lambda: bool(self.pictures) and self.pictures[-1].still and self.pictures[-1].inputs == wanted)
        self.stills.append((self._session.scene, self.pictures[-1].rgba))

    def view(self, x: float, moving: bool = False) -> None:
        self._inputs += 1
        pose = Pose(position=(x, 1.0, 2.0), focal_point=(0.0, 0.0, 0.0), view_up=(0.0, 0.0, 1.0))
        self.receive(View(camera=pose, moving=moving, input=self._inputs))

    def edit(self, **changes: Any) -> None:
        self._inputs += 1
        named = {key.replace("__", "."): value for key, value in changes.items()}
        self.receive(Edit(changes=named, moving=False, input=self._inputs))

    def ask(self, message: Pick | Save, kind: str) -> dict[str, Any]:
        before = len(self.messages)
        self.receive(message)
        self.wait(lambda: any(each["type"] in (kind, "error") for each in self.messages[before:]))
        return next(each for each in self.messages[before:] if each["type"] in (kind, "error"))


def watch(
    ranks: int, act: Callable[[Viewer], None], overrides: Sequence[str] = OVERRIDES
) -> tuple[Viewer, list[Pixels | None]]:
    """Let a viewer act; return it, and what `render_frame` draws of the scenes of its still pictures."""
    scene, viewers, failures = open_scene(FIELD, overrides), list[Viewer](), list[BaseException]()

    def job(channel: Channel) -> list[Pixels | None]:
        loop = RenderLoop(scene, channel, options=CPU, opened_as=OpenedAs(FIELD, tuple(overrides)))
        if channel.rank:
            loop.follow()
        else:
            session = Session(loop.scene, loop.content, channel.size)
            viewers.append(Viewer(session))

            def user() -> None:
                try:
                    act(viewers[0])
                except BaseException as error:
                    failures.append(error)
                session.close("done")

            thread = threading.Thread(target=user)
            thread.start()
            loop.lead(session, Pace(0.05))
            thread.join()
        scenes = channel.broadcast([scene for scene, _ in viewers[0].stills] if channel.rank == 0 else [])
        return [render_frame(each, channel, options=CPU).image for each in scenes]

    fresh = run_loopback(ranks, job)[0]
    if failures:
        raise failures[0]
    return viewers[0], fresh


def check_same(viewer: Viewer, fresh: list[Pixels | None], count: int) -> None:
    """Compare the still pictures with those of `render_frame`, bit for bit."""
    assert len(fresh) == count
    for (_, shown), expected in zip(viewer.stills, fresh, strict=True):
        assert expected is not None
        assert expected.max() > 0.1
        np.testing.assert_array_equal(shown, expected)


@pytest.mark.parametrize("ranks", [1, 3])
def test_still_pictures_have_the_bits_of_render(ranks: int) -> None:
    def act(viewer: Viewer) -> None:
        viewer.still()
        for x in (3.0, 2.0, 1.0):
            before = len(viewer.pictures)
            viewer.view(x, moving=True)
            viewer.wait(lambda before=before: len(viewer.pictures) > before)  # type: ignore[misc]
        viewer.still()
        viewer.edit(volumes__0__opacity=[[0.5, 0.0], [1.0, 0.3]], image__size=[50, 50])
        viewer.still()
        viewer.edit(cluster__brick=6)
        viewer.still()

    viewer, fresh = watch(ranks, act)
    check_same(viewer, fresh, 4)
    assert {picture.still for picture in viewer.pictures} == {True, False}
    assert all(len(each["per_rank"]) == ranks for each in viewer.messages if each["type"] == "statistics")
    boxes = next(each for each in viewer.messages if each["type"] == "statistics")["boxes"]
    assert {box["rank"] for box in boxes} == set(range(ranks))
    assert np.abs([box["corners"] for box in boxes]).max() == pytest.approx(1.0)


@pytest.mark.cover
@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("volumes__0__path", "/nowhere.npy", "/nowhere.npy: no such file"),
        ("volumes__0__time", "all", "a picture shows one time step"),
        ("volumes__0__path", "field:gaussian:nothing", "gaussian:nothing"),
    ],
)
def test_a_scene_that_cannot_be_drawn_is_an_error_on_all_ranks_and_the_session_goes_on(
    key: str, value: str, text: str
) -> None:
    def act(viewer: Viewer) -> None:
        viewer.still()
        viewer.edit(**{key: value})
        viewer.wait(lambda: any(each["type"] == "error" for each in viewer.messages))
        viewer.edit(volumes__0__opacity=0.3)
        viewer.still()

    viewer, fresh = watch(3, act)
    check_same(viewer, fresh, 2)
    error = next(each for each in viewer.messages if each["type"] == "error")
    assert text in error["message"]


def test_any_exception_of_a_frame_is_answered_on_one_rank(monkeypatch: pytest.MonkeyPatch) -> None:
    suits = FrameLoop.suits

    def failing(loop: FrameLoop, scene: Scene) -> bool:
        if scene.volumes[0].opacity == 0.7:
            raise ZeroDivisionError("in the midst")
        return suits(loop, scene)

    def act(viewer: Viewer) -> None:
        viewer.still()
        viewer.edit(volumes__0__opacity=0.7)
        viewer.wait(lambda: any(each["type"] == "error" for each in viewer.messages))
        viewer.edit(volumes__0__opacity=0.3)
        viewer.still()

    monkeypatch.setattr(FrameLoop, "suits", failing)
    viewer, fresh = watch(1, act)
    check_same(viewer, fresh, 2)
    assert [each["message"] for each in viewer.messages if each["type"] == "error"] == [
        "ZeroDivisionError: in the midst"
    ]


def test_a_still_picture_is_abandoned_on_all_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    """While each rank draws, the test sends newer input and waits until rank 0 has seen it."""
    polls, abandoned = list[int](), list[int]()
    poll = Abandoning.poll
    armed = threading.Event()

    def slow_poll(self: Abandoning) -> None:
        if armed.is_set() and self._is_open and self._channel.rank == 0:
            armed.clear()
            viewers[0].view(2.5)
        polls.append(self._channel.rank)
        try:
            poll(self)
        except AbandonedError:
            abandoned.append(self._channel.rank)
            raise

    viewers: list[Viewer] = []
    monkeypatch.setattr(Abandoning, "poll", slow_poll)
    # Drawing of a small picture is faster than the first look for input.
    monkeypatch.setattr(threads, "REPORT_SECONDS", 0.0)

    def act(viewer: Viewer) -> None:
        viewers.append(viewer)
        viewer.still()
        before = len(viewer.pictures)
        armed.set()
        viewer.view(3.5)
        viewer.wait(lambda: len(viewer.pictures) > before and viewer.pictures[-1].inputs == {viewer.number: 2})
        assert not any(each.still and each.inputs == {viewer.number: 1} for each in viewer.pictures), "it was abandoned"
        viewer.still()

    viewer, fresh = watch(3, act, (*OVERRIDES, "quality.step=0.01", "size=[200, 200]"))
    check_same(viewer, fresh, 2)
    assert 0 in abandoned
    assert set(polls) == {0, 1, 2}


def test_picks_and_files_are_of_what_is_shown(tmp_path: Any) -> None:
    def act(viewer: Viewer) -> None:
        viewer.view(4.0)
        viewer.still()
        found.append(viewer.ask(Pick(x=0.5, y=0.5, pick=3), "picked"))
        found.append(viewer.ask(Pick(x=0.01, y=0.01, pick=4), "picked"))
        viewer.edit(volumes__0__opacity=[[0.4, 0.0], [1.0, 0.5]])
        viewer.still()
        found.extend(viewer.ask(Save(what=what, save=1), "file") for what in ("scene", "command", "picture"))
        pose = Pose(position=(3.0, 1.0, 2.0), focal_point=(0.0, 0.0, 0.0), view_up=(0.0, 0.0, 1.0))
        keys = tuple(KeyPose(time=float(n), camera=pose) for n in range(2))
        found.append(viewer.ask(Save(what="path", keys=keys, save=2), "file"))
        viewer.edit(hidden=["volumes.0"])
        viewer.wait(lambda: not viewer.pictures[-1].rgba.any())
        found.append(viewer.ask(Save(what="command", save=9), "file"))

    found: list[dict[str, Any]] = []
    viewer, fresh = watch(1, act)
    check_same(viewer, fresh, 2)
    hit, missed, scene, command, picture, path, refused = found
    assert (refused["type"], refused["save"]) == ("error", 9)
    assert "hidden" in refused["message"]
    distance = float(np.linalg.norm(hit["position"]))
    assert hit["name"] == "volumes.0"
    assert 0.0 < distance < 0.75
    assert hit["value"] == pytest.approx(np.exp(-(distance**2) / 0.32), abs=0.01)
    assert np.cross(hit["position"], (4.0, 1.0, 2.0)) == pytest.approx((0, 0, 0), abs=1e-6), "on the ray"
    assert (missed["position"], missed["value"], missed["pick"]) == (None, None, 4)
    for name, one in (("scene.yaml", scene), ("path.yaml", path), ("picture.png", picture)):
        (tmp_path / name).write_bytes(one["content"])
    words = shlex.split(command["content"].decode())
    assert words[:3] == ["clusterviz", "render", FIELD]
    options = [words[n + 1] for n, word in enumerate(words) if word == "-D"]
    assert len(options) == len(OVERRIDES) + 1, "only what differs"
    for again in (open_scene(str(tmp_path / "scene.yaml")), open_scene(FIELD, options)):
        image = run_loopback(1, lambda channel, again=again: render_frame(again, channel, options=CPU).image)[0]  # type: ignore[misc]
        np.testing.assert_array_equal(image, fresh[-1])
    assert load_path(tmp_path / "path.yaml").times == (0.0, 1.0)
    assert read_image(tmp_path / "picture.png").shape == (44, 60, 4)


def test_costs_and_errors_of_settings_are_measured_while_nothing_else_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(render_loop, "IDLE_SECONDS", 0.01)

    def act(viewer: Viewer) -> None:
        viewer.edit(quality__step=3.0)
        viewer.wait(lambda: viewer.messages[-1]["type"] == "knobs")
        viewer.still()

    viewer, fresh = watch(3, act)
    check_same(viewer, fresh, 1)
    step, ends = next(each["items"] for each in viewer.messages if each["type"] == "knobs")
    assert (step["key"], step["value"]) == ("quality.step", 3.0)
    errors = [each["error"] for each in sorted(step["choices"], key=lambda each: each["value"])]
    assert errors[0] == 0.0
    assert errors == sorted(errors), "the longer the step, the larger the error"
    assert 3.0 in [each["value"] for each in step["choices"]]
    assert all(each["seconds"] > 0 for each in (*step["choices"], *ends["choices"]))


def test_rank_0_decides_once_for_all_ranks() -> None:
    def job(channel: Channel) -> list[bool]:
        answers = iter((False, True, True))
        abandoning, found = Abandoning(channel, lambda: next(answers)), []
        for polls in (1, 2, 0):
            abandoning.begin()
            try:
                for _ in range(polls):
                    abandoning.poll()
                    time.sleep(0.001)
            except ClustervizError:
                pass
            found.append(abandoning.end())
        return found

    assert run_loopback(3, job) == [[False, True, False]] * 3
