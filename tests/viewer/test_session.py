"""The session alone, without drawing: what is shown, who steers, and what is asked for next."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from fuzz.messages import run

from clusterviz.content.complete import complete_scene
from clusterviz.content.volume.info import VolumeInfo
from clusterviz.errors import ClustervizError, SceneError
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.blend_modes import BLEND_MODES, Blending, BlendModeTraits
from clusterviz.scene.overrides import with_settings
from clusterviz.viewer.describe import Content
from clusterviz.viewer.encoding import Picture
from clusterviz.viewer.limits import Limits
from clusterviz.viewer.messages import Edit, Pick, Pose, Preset, Redo, Reset, Save, Size, Steer, Undo, View
from clusterviz.viewer.server import STATIC
from clusterviz.viewer.session import ALONE_SECONDS, MOST_PENDING, REST_SECONDS, Job, Request, Session

CORNERS = np.array([[x, y, z] for z in (0, 7) for y in (0, 7) for x in (0, 7)], float)
INFO = VolumeInfo((8, 8, 8), (1.0, 1.0, 1.0), CORNERS, 0.0, 1.0, 0.1, 0.9, histogram=np.arange(4))
PIXELS = np.zeros((2, 2, 4), np.float32)
POSE = Pose(position=(7.0, 20.0, 30.0), focal_point=(0.0, 0.0, 0.0), view_up=(0.0, 0.0, 1.0))


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


@pytest.mark.parametrize(
    "changes",
    [
        {"volumes": None},
        {"volumes": []},
        {"volumes.1": None},
        {"volumes": [{"path": "a.npy"}] * 3},
        *({name: [{"path": "a"}]} for name in ("meshes", "lines", "points", "grids", "flows")),
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_an_edit_that_changes_the_number_of_entries_is_refused(changes: dict[str, Any]) -> None:
    room = Room()
    before = room.draw().completed
    room.edit(changes)
    for message in (Undo(), Redo()):
        room.session.receive(1, message)
    assert room.session.next_request(0.0) is None
    assert "entries cannot be added, removed" in room.clients[0].last("error")["message"]
    room.session.receive(1, Reset())
    assert room.draw().completed == before


def test_the_kind_of_a_flow_stays() -> None:
    opened = scene_of_data("a.npy", ["flows=[{path: a.vti, show: streamlines}]", "volumes=[]"])
    limits = Limits(opened.model_dump(mode="json"))
    limits.check(opened)
    with pytest.raises(SceneError, match=r"flows\.0\.show: .*; found glyphs; allowed streamlines"):
        limits.check(with_settings(opened, {"flows.0.show": "glyphs"}))


@pytest.mark.parametrize(
    "changes", [{"camera": None}, {"camera": {}}, {"camera.position": None, "camera.view": "front"}]
)
@pytest.mark.parametrize("after", [Undo(), Reset(), View(camera=POSE, moving=False, input=9)])
def test_a_camera_that_is_left_out_is_fitted_and_can_be_moved(changes: dict[str, Any], after: Any) -> None:
    room = Room()
    opened = room.draw().completed.camera.position
    room.view(3.0)
    room.draw()
    room.edit(changes)
    fitted = room.draw().completed.camera.position
    assert fitted not in (None, (3.0, 20.0, 30.0))
    room.session.receive(1, after)
    expected = {Undo: fitted, Reset: opened, View: POSE.position}[type(after)]
    assert room.draw().completed.camera.position == expected
    assert "error" not in [each["type"] for each in room.clients[0].messages]


@pytest.mark.parametrize(("size", "is_shown"), [([4096, 16], True), ([4097, 16], False), ([16384, 16384], False)])
def test_an_edit_makes_no_larger_picture_than_a_window(size: list[int], is_shown: bool) -> None:
    room = Room()
    room.draw()
    room.edit({"image.size": size})
    assert (room.session.next_request(0.0) is not None) == is_shown
    assert list(room.session.completed.image.size) == (size if is_shown else [200, 100])


def test_any_exception_of_a_message_is_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    room = Room()
    before = room.draw().scene
    monkeypatch.setattr(Content, "complete", lambda *_: {}["nothing"])
    for message in (Undo(), Reset(), Size(width=300, height=200), Preset(volume=0, name="bone")):
        room.session.receive(1, message)
    room.edit({"quality.step": 0.5})
    room.view(1.0)
    assert room.session.next_request(0.0) is None
    said = [each["message"] for each in room.clients[0].messages if each["type"] == "error"]
    assert said == ["KeyError: 'nothing'"] * 5
    assert room.session.scene == before


class Files:
    """A folder of a session, and what lies around it."""

    def __init__(self, folder: Path) -> None:
        self.inside, self.outside = folder / "scene", folder / "outside"
        for each in (self.inside / "slices", self.inside / "leading", self.outside):
            each.mkdir(parents=True)
        for each in (self.inside / "b.npy", self.inside / "b.h5", self.inside / "slices/1.png", self.outside / "c.npy"):
            each.write_text("PRIVATE content")
        os.mkfifo(self.inside / "fifo.npy")
        (self.inside / "leading/1.png").symlink_to(self.outside / "c.npy")
        (self.inside / "link.npy").symlink_to(self.outside / "c.npy")
        (self.inside / "folder").symlink_to(self.outside)
        (self.inside / "to_b.npy").symlink_to("b.npy")

    def change(self, key: str, name: str, *more: Path) -> tuple[Any, str]:
        """The value of a key after an edit, and what was said."""
        room = Room(folders=[self.inside, *more])
        room.draw()
        room.edit({key: name.format(inside=self.inside, outside=self.outside)})
        room.session.next_request(0.0)
        said = [each["message"] for each in room.clients[0].messages if each["type"] == "error"]
        section = room.session.scene.volumes[0]
        return getattr(section, key.rpartition(".")[2]), "".join(said)


@pytest.fixture
def files(tmp_path: Path) -> Files:
    return Files(tmp_path)


@pytest.mark.parametrize(
    ("name", "opened"),
    [
        ("b.npy", "{inside}/b.npy"),
        ("slices/../to_b.npy", "{inside}/to_b.npy"),
        ("{inside}/slices", "{inside}/slices"),
        ("b.h5:/group/data", "{inside}/b.h5:/group/data"),
        ("missing.npy", "{inside}/missing.npy"),
        ("b.*", "{inside}/b.*"),
        ("field:gaussian:8", "field:gaussian:8"),
    ],
)
def test_clients_may_name_files_of_the_folder(files: Files, name: str, opened: str) -> None:
    assert files.change("volumes.0.path", name) == (opened.format(inside=files.inside), "")


@pytest.mark.parametrize(
    "name",
    [
        *("/etc/passwd", "../outside/c.npy", "{outside}/c.npy", "{outside}", "link.npy", "folder", "folder/c.npy"),
        *(
            "leading",
            "{outside}/*.npy",
            "../outside/missing.npy",
            "..",
            "/",
            "{outside}/c.h5:/x",
            "b.h5:/../../../x",
            "\0",
        ),
        *("http://localhost/a.zarr", "file:///etc/passwd", "s3://b/c"),
    ],
)
@pytest.mark.parametrize("key", ["volumes.0.path", "volumes.0.shader"])
def test_clients_may_name_no_other_files(files: Files, key: str, name: str) -> None:
    value, said = files.change(key, name)
    assert "not a file that the live view may open" in said
    assert value in (None, Room().session.scene.volumes[0].path)
    assert "PRIVATE" not in said


def test_what_is_no_file_is_not_opened(files: Files) -> None:
    assert "not a regular file" in files.change("volumes.0.path", "fifo.npy")[1]
    assert files.change("volumes.0.path", "{outside}/c.npy", files.outside)[1] == ""


def test_clients_see_no_secrets_of_addresses_and_need_not_send_them() -> None:
    opened = scene_of_data("http://me:secret@host/a.zarr?sig=secret", ["image.size=[20, 10]"])
    content = Content((INFO,))
    session, client = Session(complete_scene(opened, content.infos), content, folders=[]), Recorder()
    number = session.join(client)
    assert "secret" not in str(client.last("state"))
    given = client.last("state")["given"]["volumes"]
    assert given[0]["path"] == "http://host/a.zarr"
    session.receive(number, Edit(changes={"volumes": given}, moving=False, input=1))
    assert isinstance(session.next_request(0.0), Request)
    assert session.scene.volumes[0].path == "http://me:secret@host/a.zarr?sig=secret"


@pytest.mark.parametrize(("count", "draws"), [(400, False), (40, True)])
def test_strange_messages_are_followed_or_answered(count: int, draws: bool) -> None:
    outcomes, errors = run(count, 34, draws)
    assert min(outcomes[name] for name in ("followed", "refused")) > count / 20
    assert not [each for each in errors if "Error: " in each]


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


def test_the_page_takes_what_it_knows_of_blend_modes_from_their_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BLEND_MODES, cast("Blending", "own"), BlendModeTraits("", "", threshold=True))
    told = Content(()).hello()["blend_modes"]
    assert told["own"] == {"threshold": True, "surfaces": "refused"}
    assert told.keys() == BLEND_MODES.keys()
    code = "".join(path.read_text() for path in STATIC.glob("*.js"))
    assert [name for name in BLEND_MODES if f'"{name}"' in code] == []


def test_a_session_may_end_after_the_last_client() -> None:
    room = Room(1, ends_alone=True)
    room.draw()
    room.session.leave(1)
    assert room.session.next_request(0.0) is None
    assert not room.session.is_ended
    room.clock.now += ALONE_SECONDS + 1
    assert room.session.next_request(0.0) is None
    assert room.session.is_ended
