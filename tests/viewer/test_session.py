"""The session alone, without drawing: what is shown, who steers, and what is asked for next."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.errors import ClustervizError
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.complete import VolumeInfo, complete_scene
from clusterviz.viewer.describe import Content
from clusterviz.viewer.encoding import Picture
from clusterviz.viewer.messages import Edit, Pick, Pose, Preset, Redo, Reset, Save, Size, Steer, Undo, View
from clusterviz.viewer.session import ALONE_SECONDS, MOST_PENDING, REST_SECONDS, Job, Request, Session

CORNERS = np.array([[x, y, z] for z in (0, 7) for y in (0, 7) for x in (0, 7)], float)
INFO = VolumeInfo((8, 8, 8), (1.0, 1.0, 1.0), CORNERS, 0.0, 1.0, 0.1, 0.9, histogram=np.arange(4))
PIXELS = np.zeros((2, 2, 4), np.float32)


class Clock:
    """Time that passes only when a test says so."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


class Recorder:
    """Client that keeps what it gets."""

    def __init__(self) -> None:
        self.messages: list[dict[str, Any]] = []
        self.pictures: list[Picture] = []

    def send(self, message: dict[str, Any]) -> None:
        self.messages.append(message)

    def show(self, picture: Picture) -> None:
        self.pictures.append(picture)

    def send_file(self, save: int, name: str, media_type: str, content: bytes) -> None:
        self.messages.append({"type": "file", "save": save})

    def last(self, kind: str) -> dict[str, Any]:
        return [each for each in self.messages if each["type"] == kind][-1]


class Room:
    """Session with some clients, and the requests that it makes."""

    def __init__(self, clients: int = 1, **options: Any) -> None:
        scene: Scene = scene_of_data("a.npy", ["volumes=[{path: a.npy}, {path: b.npy}]", "image.size=[200, 100]"])
        content = Content((INFO, INFO))
        self.clock = Clock()
        self.session = Session(complete_scene(scene, content.infos), content, clock=self.clock, **options)
        self.clients = [Recorder() for _ in range(clients)]
        self.numbers = [self.session.join(client) for client in self.clients]
        self.inputs = 0

    def next(self) -> Request:
        request = self.session.next_request(0.0)
        assert isinstance(request, Request)
        return request

    def draw(self) -> Request:
        request = self.next()
        self.session.finished(request, PIXELS, 0.01, None)
        return request

    def view(self, x: float, moving: bool = True, client: int = 0) -> None:
        self.inputs += 1
        pose = Pose(position=(x, 20.0, 30.0), focal_point=(0.0, 0.0, 0.0), view_up=(0.0, 0.0, 1.0))
        self.session.receive(self.numbers[client], View(camera=pose, moving=moving, input=self.inputs))

    def edit(self, changes: dict[str, Any], merge: str | None = None, client: int = 0) -> None:
        self.inputs += 1
        message = Edit(changes=changes, moving=False, merge=merge, input=self.inputs)
        self.session.receive(self.numbers[client], message)

    @property
    def step(self) -> float:
        return self.session.completed.quality.step


def test_the_newest_view_is_drawn_and_then_a_still_picture() -> None:
    room = Room()
    assert not room.draw().moving
    assert room.session.next_request(0.0) is None
    for x in range(10_000):
        room.view(float(x))
    request = room.draw()
    assert request.moving
    assert request.scene.camera.position == (9999.0, 20.0, 30.0)
    assert room.clients[0].pictures[-1].inputs == {1: 10_000}
    assert not room.clients[0].pictures[-1].still
    assert room.session.next_request(0.0) is None
    room.clock.now += REST_SECONDS + 0.01
    assert not room.draw().moving
    assert room.clients[0].pictures[-1].still
    assert room.session.next_request(0.0) is None


def test_input_during_a_still_picture_is_seen_at_once() -> None:
    room = Room()
    room.next()
    assert not room.session.has_input()
    room.session.receive(1, Pick(x=0.5, y=0.5, pick=1))
    assert not room.session.has_input(), "a pick does not change what is shown"
    room.view(1.0)
    assert room.session.has_input()


def test_what_changes_nothing_does_not_end_a_still_picture() -> None:
    room = Room()
    room.session.receive(1, Size(width=640, height=480))
    room.view(1.0)
    room.draw()
    room.view(1.0, moving=False)
    request = room.next()
    assert not request.moving
    assert request.inputs == {1: 2}
    room.view(1.0, moving=False)
    room.session.receive(1, Size(width=640, height=480))
    assert not room.session.has_input()
    room.session.finished(request, PIXELS, 0.01, None)
    assert room.clients[0].pictures[-1].inputs == {1: 3}
    assert room.session.next_request(0.0) is None


def test_edits_are_undone_and_redone_without_the_camera() -> None:
    room = Room()
    before = room.step
    room.edit({"quality.step": 0.25})
    room.edit({"volumes.1.opacity": [[0, 0], [1, 1]], "quality.adaptive": None})
    room.view(3.0)
    room.draw()
    assert room.step == 0.25
    assert room.session.scene.volumes[1].opacity == ((0.0, 0.0), (1.0, 1.0))
    for _ in range(3):
        room.session.receive(1, Undo())
    room.draw()
    assert room.step == before
    assert room.session.scene.camera.position == (3.0, 20.0, 30.0)
    room.session.receive(1, Redo())
    room.draw()
    assert room.step == 0.25
    state = room.session._state
    assert (state["can_undo"], state["can_redo"]) == (True, True)
    room.session.receive(1, Reset())
    assert room.draw().scene.camera.position != (3.0, 20.0, 30.0)
    assert room.step == before


def test_edits_with_one_tag_are_one_step() -> None:
    room = Room()
    before = room.step
    for step in (0.5, 0.6, 0.7):
        room.edit({"quality.step": step}, "drag")
        room.draw()
    room.session.receive(1, Undo())
    room.draw()
    assert room.step == before


@pytest.mark.parametrize(
    ("changes", "key", "said"),
    [
        ({"volumes.0.clim": "x", "volumes.1.clim": [0, 1]}, "volumes.0.clim", "not a list"),
        ({"volumes.0.pathh": 1}, "volumes.0.pathh", "did you mean path"),
        ({"volumes.7.clim": [0, 1]}, "volumes.7.clim", "no such item"),
        ({"step": 0.5}, "step", "not a full path"),
        ({"volumes.0.cmap": "nothing like this"}, "volumes.0.cmap", "colour map"),
        ({"hidden": ["volumes.9"]}, "hidden", "volumes.0, volumes.1"),
    ],
)
def test_a_wrong_edit_leaves_the_scene(changes: dict[str, Any], key: str, said: str) -> None:
    room = Room()
    before = room.draw().scene
    room.edit(changes)
    assert room.session.next_request(0.0) is None
    error = room.clients[0].last("error")
    assert error["key"] == key
    assert error["input"] == 1
    assert said in error["message"]
    assert room.session.scene == before


def test_a_scene_that_cannot_be_drawn_is_taken_back() -> None:
    room = Room()
    room.draw()
    room.edit({"quality.step": 0.25})
    room.session.failed(room.next(), ClustervizError("no memory"))
    assert room.clients[0].last("error")["message"] == "no memory"
    room.draw()
    assert room.step != 0.25
    room.session.receive(1, Undo())
    assert room.session.next_request(0.0) is None


def test_one_client_steers_and_others_ask() -> None:
    room = Room(3)
    room.session.receive(2, Size(width=640, height=480))
    room.edit({"quality.step": 0.5}, client=0)
    assert room.clients[0].last("error")["message"] == "client 2 steers"
    assert room.draw().scene.image.size == (640, 480)
    room.session.receive(1, Steer(action="ask"))
    room.session.receive(3, Steer(action="grant", client=1))
    assert room.clients[2].last("state")["asking"] == [1]
    room.session.receive(2, Steer(action="grant", client=1))
    assert room.clients[2].last("state")["steering"] == 1
    room.edit({"quality.step": 0.5}, client=0)
    room.draw()
    assert room.step == 0.5
    room.session.leave(1)
    assert room.clients[2].last("state")["steering"] is None
    shared = Room(2, shared=True)
    for client, step in enumerate((0.5, 0.6)):
        shared.edit({"quality.step": step}, client=client)
    assert shared.draw().inputs == {1: 1, 2: 2}
    assert shared.step == 0.6


def test_hidden_entries_are_not_drawn_and_keep_their_numbers() -> None:
    room = Room()
    room.edit({"hidden": ["volumes.0"], "volumes.1.cmap": "hot"})
    request = room.draw()
    assert [volume.path.rpartition("/")[2] for volume in request.scene.volumes] == ["b.npy"]
    assert request.completed.volumes[0].cmap == "hot"
    state = room.clients[0].last("state")
    assert (state["hidden"], len(state["volumes"]), len(state["scene"]["volumes"])) == (["volumes.0"], 2, 2)
    assert state["volumes"][1]["histogram"]["counts"] == [0, 1, 2, 3]


def test_a_preset_sets_the_keys_of_a_volume() -> None:
    room = Room()
    room.session.receive(1, Preset(volume=1, name="bone"))
    volumes = room.draw().scene.volumes
    assert (volumes[0].cmap, volumes[1].cmap) == ("viridis", "bone")
    for volume, name in ((1, "nothing"), (2, "bone")):
        room.session.receive(1, Preset(volume=volume, name=name))
        assert room.session.next_request(0.0) is None
        assert "preset" in room.clients[0].last("error")["message"]


def test_only_so_many_messages_wait() -> None:
    room = Room()
    for _ in range(MOST_PENDING + 10):
        room.edit({"quality.step": 0.5})
    assert room.clients[0].last("error")["message"] == "too many messages at a time"
    room.draw()
    assert room.step == 0.5


def test_jobs_come_after_input_and_the_last_pick_counts() -> None:
    room = Room()
    room.draw()
    for number in range(5):
        room.session.receive(1, Pick(x=0.5, y=0.5, pick=number))
    room.session.receive(1, Save(what="scene", save=7))
    room.view(1.0)
    assert isinstance(room.session.next_request(0.0), Request)
    jobs = [room.session.next_request(0.0) for _ in range(2)]
    assert [job.message for job in jobs if isinstance(job, Job)] == [
        Pick(x=0.5, y=0.5, pick=4),
        Save(what="scene", save=7),
    ]


def test_a_client_that_joins_gets_what_is_shown_and_the_end() -> None:
    room = Room(0)
    room.draw()
    late = Recorder()
    room.session.join(late)
    assert [each["type"] for each in late.messages] == ["hello", "state"]
    assert len(late.pictures) == 1
    assert late.last("hello")["keys"]["quality.step"]["above"] == 0
    assert late.last("hello")["keys"]["lights.0.color"]["description"]
    room.session.close("the job has failed")
    assert late.last("ended") == {"type": "ended", "message": "the job has failed"}
    assert room.session.is_ended
    assert room.session.next_request(0.0) is None


def test_a_session_may_end_after_the_last_client() -> None:
    room = Room(1, ends_alone=True)
    room.draw()
    room.session.leave(1)
    assert room.session.next_request(0.0) is None
    assert not room.session.is_ended
    room.clock.now += ALONE_SECONDS + 1
    assert room.session.next_request(0.0) is None
    assert room.session.is_ended
