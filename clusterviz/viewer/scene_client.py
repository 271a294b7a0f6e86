"""The kernel's own client of a session: the scene and the camera for Python, edits, and pictures of full quality.

Each change counts as one of a moving view, since others may follow at once: from a slider, or from a linked view.
"""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from clusterviz.errors import ClustervizError, SceneError
from clusterviz.image.picture import Image
from clusterviz.scene.background import background_rgb
from clusterviz.scene.values import Camera, Scene
from clusterviz.viewer.messages import unpack

Data = dict[str, Any]


class Connection(Protocol):
    """Client's end of a session; its methods may be called from any thread."""

    def receive(self, text: str) -> None:
        """Take a message of the client."""

    def close(self) -> None:
        """Leave the session."""


class NotebookSession(Protocol):
    """Session of a notebook, drawn by a thread of this process or by ranks of a job."""

    def connect(self, put_text: Callable[[str], None], put_binary: Callable[[bytes], None]) -> Connection:
        """Add a client, whose messages go to two functions; other threads call them."""

    def close(self) -> None:
        """End the session."""


@dataclass
class _Answers:
    """What has come from the session; guarded by the client's lock."""

    scene: Scene | None = None  # that is shown, with edits that the session has not confirmed yet
    told: Scene | None = None  # the session's newest
    camera: Data = field(default_factory=dict)  # of the newest picture, or set since
    given: Data = field(default_factory=dict)  # keys that were set, of the newest scene
    files: dict[int, bytes] = field(default_factory=dict)
    failures: dict[int, str] = field(default_factory=dict)
    refused: str | None = None  # reason why the session did not take an edit
    ended: str | None = None


class SceneClient:
    """Client of a session that reads and changes the scene from Python.

    Raises ClustervizError: the session has ended before it began.
    """

    def __init__(self, session: NotebookSession) -> None:
        self._changed: Callable[[], None] = lambda: None
        self._news, self._answers = threading.Condition(), _Answers()
        self._input, self._shown_input, self._saves = 0, 0, 0
        self._connection = session.connect(self._take_text, self._take_binary)
        with self._news:
            self._news.wait_for(lambda: self._answers.scene is not None or self._answers.ended is not None)
        if self._answers.scene is None:
            raise ClustervizError(self._answers.ended)

    def on_change(self, changed: Callable[[], None]) -> None:
        """Let a function be called after the scene or the camera has changed, by any thread."""
        self._changed = changed

    @property
    def scene(self) -> Scene:
        """The completed scene that is shown."""
        assert self._answers.scene is not None, "a session begins with its scene"
        return self._answers.scene

    @property
    def camera(self) -> Data:
        """The camera of the newest picture: position, focal_point, view_up, view_angle, parallel_scale."""
        return self._answers.camera

    def set_camera(self, camera: Data) -> None:
        """Move the camera."""
        with self._news:
            self._take_camera(camera, True)
        self._send({"type": "view", "camera": camera, "moving": True, "input": self._next_input()})

    def edit(self, scene: Scene) -> None:
        """Change those keys in which another scene differs from `scene`."""
        self._change(changed_keys(_data_of(self.scene), _data_of(scene)), scene)

    def show(self, scene: Scene) -> None:
        """Show another scene at the size of the views; keys that it does not set get their defaults."""
        given, wanted = self._answers.given, _data_of(scene)
        wanted["image"] = {"size": given["image"]["size"], **wanted.get("image", {})}
        self._change(changed_keys(given, {"camera": {}, **wanted}), scene)

    def picture(self, size: tuple[int, int] | None) -> Image:
        """Return the picture of full quality that `clusterviz.render` makes of the scene.

        Raises SceneError: an edit was refused. Raises ClustervizError: the picture cannot be drawn, or the session has
        ended.
        """
        self._saves += 1
        number = self._saves
        sides = {} if size is None else {"width": size[0], "height": size[1]}
        self._send({"type": "save", "what": "picture", "format": "npz", "save": number, **sides})
        answers = self._answers
        with self._news:
            self._news.wait_for(lambda: answers.ended or number in answers.files or number in answers.failures)
            refused, answers.refused = answers.refused, None
            content, failure = answers.files.pop(number, None), answers.failures.pop(number, None)
        if refused is not None:
            raise SceneError(refused)
        if content is None:
            raise ClustervizError(failure or answers.ended)
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            layers = {name: file[name] for name in file.files}
        return Image(layers.pop("rgba"), background_rgb(self.scene.image.background), layers)

    def close(self) -> None:
        """Leave the session."""
        self._connection.close()

    def _change(self, changes: Data, scene: Scene) -> None:
        if changes:
            with self._news:
                self._answers.scene = scene
            self._send({"type": "edit", "changes": changes, "moving": True, "input": self._next_input()})

    def _next_input(self) -> int:
        self._input += 1
        return self._input

    def _send(self, message: Data) -> None:
        self._connection.receive(json.dumps(message))

    def _take_text(self, text: str) -> None:
        message, answers = json.loads(text), self._answers
        with self._news:
            match message["type"]:
                case "state":
                    answers.told, answers.given = Scene.model_validate(message["scene"]), message["given"]
                    answers.camera = answers.camera or answers.given["camera"]
                    if message["input"] >= self._input:
                        answers.scene = answers.told
                case "error" if "save" in message:
                    answers.failures[message["save"]] = message["message"]
                case "error" if "input" in message or self._shown_input < self._input:
                    answers.refused, answers.scene = message["message"], answers.told
                case "ended":
                    answers.ended = message["message"]
            self._news.notify_all()
        if message["type"] in ("state", "error"):
            self._changed()

    def _take_binary(self, data: bytes) -> None:
        header, content = unpack(data)
        if header["kind"] == "picture":
            self._send({"type": "ack", "picture": header["picture"]})
        with self._news:
            if header["kind"] == "file":
                self._answers.files[header["save"]] = content
            elif header["input"] >= self._input:
                self._take_camera(header["camera"], header["still"])
            self._shown_input = header.get("input", self._shown_input)
            self._news.notify_all()
        self._changed()

    def _take_camera(self, camera: Data, still: bool) -> None:
        answers, self._answers.camera = self._answers, camera
        if still and answers.scene is not None:
            answers.scene = answers.scene.model_copy(update={"camera": Camera.model_validate(camera)})


def changed_keys(before: Mapping[str, Any], after: Mapping[str, Any], path: str = "") -> Data:
    """Return the values of keys that differ by their full paths; None where a key was removed.

    Items of lists have paths of their own where both lists are equally long and hold sections.
    """
    found: Data = {}
    for name in dict.fromkeys([*before, *after]):
        key, old, new = f"{path}{name}", before.get(name), after.get(name)
        if isinstance(old, dict) and isinstance(new, dict):
            found |= changed_keys(old, new, f"{key}.")
        elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new) and _are_sections([*old, *new]):
            for number, pair in enumerate(zip(old, new, strict=True)):
                found |= changed_keys(*pair, f"{key}.{number}.")
        elif old != new:
            found[key] = new
    return found


def _are_sections(items: list[Any]) -> bool:
    return all(isinstance(item, dict) for item in items)


def _data_of(scene: Scene) -> Data:
    data: Data = scene.model_dump(mode="json", exclude_unset=True)
    return data
