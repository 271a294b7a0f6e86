"""State of a live session: what is shown, who steers, and what is drawn next.

Clients call `receive` from any thread; it only stores the message. The drawing thread takes requests: it applies the
messages that have come since, of which newer ones replace older ones of the same kind, so that nothing queues.
"""

from __future__ import annotations

import copy
import re
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from clusterviz.comm.agree import describe
from clusterviz.content.flow.expansion import without_flows
from clusterviz.content.flow.section import FlowSection
from clusterviz.errors import ClustervizError, SceneError, public_address
from clusterviz.scene.background import background_rgb
from clusterviz.scene.files import change_paths, check_scene, public_data
from clusterviz.scene.overrides import apply_changes
from clusterviz.scene.values import Camera, Scene
from clusterviz.viewer.describe import Content
from clusterviz.viewer.encoding import Picture
from clusterviz.viewer.limits import LISTS, Limits, dotted
from clusterviz.viewer.messages import (
    PROTOCOL,
    Edit,
    Message,
    Pick,
    Pose,
    Preset,
    Redo,
    Reset,
    Save,
    Size,
    Steer,
    Undo,
    View,
)

Data = dict[str, Any]

REST_SECONDS = 0.25
"""Time without input after which a view counts as still, whatever the client said."""
ALONE_SECONDS = 10.0
"""Time in which a client may join again, as by a reload."""
MOST_PENDING = 256
"""Messages that wait to be applied, at most."""
MOST_UNDO = 200
"""Edits that can be undone."""
STATE_SECONDS = 0.2
"""Least time between two states while the scene is edited."""
STATISTICS_SECONDS = 0.5
"""Least time between two statistics while the view moves."""
Change = View | Edit | Undo | Redo | Reset | Preset | Size
"""Messages that change what is shown; only the client that steers may send them."""
HIDDEN = "hidden"
"""Key of edits, beside those of a scene: list of the entries that are not drawn, such as volumes.1."""
CAMERA = ("position", "focal_point", "view_up", "view_angle", "parallel_scale")
"""Keys of the camera that clients are told."""
LENS = ("window_center", "aperture", "focal_distance")
"""Keys of the camera that stay as it moves."""


class Client(Protocol):
    """Browser or notebook; its methods are called from any thread and do not block."""

    def send(self, message: Data) -> None:
        """Send a message."""
        ...

    def show(self, picture: Picture) -> None:
        """Show a picture, unless a newer one comes before."""
        ...

    def send_file(self, save: int, name: str, media_type: str, content: bytes) -> None:
        """Send a file that the client asked for by the number `save`."""
        ...


@dataclass(frozen=True)
class Request:
    """Picture to draw.

    Attributes
    ----------
    scene : as the user gave it, with a camera, without what is hidden
    hidden : entries that are left out, such as volumes.1
    revision : of the scene without its camera
    inputs : number of the last input of each client that the picture shows
    moving : whether the view is changing
    """

    number: int
    scene: Scene
    completed: Scene
    revision: int
    inputs: Mapping[int, int]
    moving: bool
    hidden: tuple[str, ...] = ()


@dataclass(frozen=True)
class Job:
    """Other work for the drawing thread: a pick or a file."""

    client: int
    message: Pick | Save
    request: Request


@dataclass
class _Member:
    """Client that has joined."""

    client: Client
    size: Size | None = None


@dataclass(frozen=True)
class _Undo:
    """Scene data that an edit has replaced; consecutive edits with one tag are one step."""

    data: Data
    tag: str | None = None


@dataclass
class _Shown:
    """What is shown; changed by the drawing thread only."""

    data: Data
    scene: Scene
    completed: Scene
    hidden: tuple[str, ...] = ()
    undo: list[_Undo] = field(default_factory=list)
    redo: list[Data] = field(default_factory=list)


class Session:
    """Session of all clients; `next_request`, `finished` and `failed` are called by one thread, the rest by any.

    Parameters
    ----------
    scene : completed
    budget_ms : time of a picture while the view moves
    shared : whether all clients steer
    ends_alone : whether the session ends `ALONE_SECONDS` after the last client has left
    clock : seconds
    folders : of the files that clients may name, see `Limits`
    """

    def __init__(
        self,
        scene: Scene,
        content: Content,
        ranks: int = 1,
        budget_ms: float = 50.0,
        shared: bool = False,
        ends_alone: bool = False,
        clock: Callable[[], float] = time.monotonic,
        folders: Sequence[Path] | None = None,
    ) -> None:
        self._lock = threading.Condition()
        self._content, self._clock, self._shared, self._ends_alone = content, clock, shared, ends_alone
        self._about = {"ranks": ranks, "budget_ms": budget_ms}
        data = _data_of(scene)
        self._opened, self._limits = data, Limits(data, folders)
        self._shown = _Shown(data, Scene.model_validate(data), scene)
        self._drawn_data = data
        self._members: dict[int, _Member] = {}
        self._joined, self._left = 0, 0.0
        self._steering: int | None = None
        self._asking: list[int] = []
        self._pending: list[tuple[int, Change]] = []
        self._jobs: list[tuple[int, Pick | Save]] = []
        self._number, self._drawn = 1, 0
        self._revision, self._inputs = 1, dict[int, int]()
        self._moving, self._was_moving, self._is_busy = False, False, False
        self._newest_pose: Pose | None = None
        self._newest_size: Size | None = None
        self._last_input = -REST_SECONDS
        self._picture: Picture | None = None
        self._pictures = 0
        self._warnings: tuple[str, ...] = ()
        self._statistics: Data | None = None
        self._state_sent, self._statistics_sent, self._state_revision = -STATE_SECONDS, -STATISTICS_SECONDS, 0
        self._ended: str | None = None
        self._state = self._described()

    @property
    def scene(self) -> Scene:
        """The scene as it is shown, with camera and size: `render` of it gives the still picture."""
        return visible(self._shown.scene, self._shown.hidden)

    @property
    def completed(self) -> Scene:
        """The scene with all keys."""
        return visible(self._shown.completed, self._shown.hidden)

    def join(self, client: Client) -> int:
        """Add a client, send it the state and the newest picture, and return its number."""
        with self._lock:
            self._joined += 1
            number = self._joined
            self._members[number] = _Member(client)
            about = {**self._about, **self._content.hello()}
            client.send({"type": "hello", "protocol": PROTOCOL, "client": number, **about})
            self._send_state()
            if self._picture is not None:
                client.show(self._picture)
            if self._statistics is not None:
                client.send(self._statistics)
            if self._ended is not None:
                client.send({"type": "ended", "message": self._ended})
            return number

    def leave(self, number: int) -> None:
        """Remove a client; if it steered, nobody does."""
        with self._lock:
            self._members.pop(number, None)
            self._left = self._clock()
            self._asking = [each for each in self._asking if each != number]
            if self._steering == number:
                self._steering = None
            self._send_state()

    def receive(self, number: int, message: Message) -> None:
        """Take a checked message of a client; this never waits for drawing."""
        with self._lock:
            member = self._members.get(number)
            if member is None or self._ended is not None:
                return
            match message:
                case Steer():
                    self._steer(number, message)
                case Pick():
                    self._jobs = [each for each in self._jobs if not isinstance(each[1], Pick)]
                    self._jobs.append((number, message))
                case Save():
                    self._jobs = [*self._jobs, (number, message)][-MOST_PENDING:]
                case View() | Edit() | Undo() | Redo() | Reset() | Preset() | Size():
                    self._change(number, member, message)
            self._lock.notify_all()

    def _change(self, number: int, member: _Member, message: Change) -> None:
        if isinstance(message, Size):
            member.size = message
            if message == self._newest_size:
                return
        if self._steering is None and not self._shared:
            self._give(number)
        if self._shared or self._steering == number:
            self._put(number, message)
        elif not isinstance(message, Size):
            member.client.send(_error(f"client {self._steering} steers", message))

    def next_request(self, timeout: float) -> Request | Job | None:
        """Wait for something to draw, at most `timeout` seconds; None if there is nothing."""
        end = self._clock() + timeout
        with self._lock:
            while self.is_idle:
                now = self._clock()
                if self._ends_alone and self._joined and not self._members and now > self._left + ALONE_SECONDS:
                    self._ended = "the last client has left"
                    return None
                wake = min(end, self._last_input + REST_SECONDS) if self._was_moving else end
                if now >= end:
                    return None
                self._lock.wait(max(1e-3, wake - now))
            pending, self._pending = self._pending, []
            job = self._jobs.pop(0) if self._jobs and not pending else None
        if self._ended:
            return None
        for number, message in pending:
            self._apply(number, message)
        if job is not None:
            return Job(*job, self._request(False))
        return self._request(self._is_moving) if self._wants_picture else None

    def has_input(self) -> bool:
        """Return whether something has come that changes what is shown."""
        return bool(self._pending) or self._ended is not None

    @property
    def is_idle(self) -> bool:
        """Whether there is nothing to draw."""
        return not (self._pending or self._jobs or self._wants_picture or self._ended)

    def present(self) -> Request | None:
        """Return what is shown, as a still picture; None if nobody watches."""
        return self._request(False) if self._members else None

    def tell(self, message: Data) -> None:
        """Send a message to all clients."""
        with self._lock:
            self._send_all(message)

    def finished(
        self, request: Request, picture: Any, seconds: float, statistics: Data | None, warnings: tuple[str, ...] = ()
    ) -> None:
        """Show a picture to all clients.

        Parameters
        ----------
        picture : float32 (h, w, 4), premultiplied
        warnings : texts about the scene
        """
        camera = _camera_of(request.completed.camera)
        still, now = not request.moving, self._clock()
        with self._lock:
            self._pictures += 1
            background = background_rgb(request.completed.image.background)
            about = self._pictures, request.revision, dict(request.inputs), still, camera, seconds
            self._picture = shown = Picture(picture, background, *about)
            self._drawn, self._was_moving, self._drawn_data = request.number, request.moving, self._shown.data
            if still:
                self._warnings = warnings
            for member in self._members.values():
                member.client.show(shown)
            if self._is_busy:
                self._is_busy = False
                self._send_all({"type": "busy", "message": ""})
            changed = self._state_revision != request.revision or (still and self._state["warnings"] != list(warnings))
            if changed and (still or now - self._state_sent >= STATE_SECONDS):
                self._send_state()
            if statistics is not None and (still or now - self._statistics_sent >= STATISTICS_SECONDS):
                self._statistics_sent = now
                self._statistics = {"type": "statistics", "picture": self._pictures, **statistics}
                self._send_all(self._statistics)

    def failed(self, request: Request, error: ClustervizError) -> None:
        """Report that a scene cannot be drawn, and show the last one that could."""
        with self._lock:
            self._send_all(_error(str(error)))
            self._drawn, self._was_moving = request.number, False
        if self._shown.data is not self._drawn_data:
            with self._lock:
                self._shown.undo = [each for each in self._shown.undo if each.data is not self._drawn_data]
            self._show(self._drawn_data)

    def busy(self, text: str) -> None:
        """Tell all clients why the next picture takes long; its arrival ends that."""
        with self._lock:
            self._is_busy = True
            self._send_all({"type": "busy", "message": text})

    def reopened(self, content: Content) -> None:
        """Take what is known of the data of a scene with other files or grids."""
        self._content = content

    def answer(self, client: int, send: Callable[[Client], None]) -> None:
        """Call a function with a client, if it has not left."""
        with self._lock:
            if client in self._members:
                send(self._members[client].client)

    def close(self, reason: str) -> None:
        """End the session: every client is told, and `next_request` returns None."""
        with self._lock:
            if self._ended is None:
                self._ended = reason
                self._send_all({"type": "ended", "message": reason})
            self._lock.notify_all()

    @property
    def is_ended(self) -> bool:
        """Whether the session has been closed."""
        return self._ended is not None

    @property
    def _is_moving(self) -> bool:
        return self._moving and self._clock() < self._last_input + REST_SECONDS

    @property
    def _wants_picture(self) -> bool:
        return self._drawn < self._number or (self._was_moving and not self._is_moving)

    def _request(self, moving: bool) -> Request:
        scenes = self.scene, self.completed
        return Request(self._number, *scenes, self._revision, self._inputs, moving, self._shown.hidden)

    def _put(self, number: int, message: Change) -> None:
        """Store a message in place of earlier ones of the same kind, unless it changes nothing."""
        self._last_input = self._clock()
        self._moving = isinstance(message, (View, Edit)) and message.moving
        if isinstance(message, View) and message.camera == self._newest_pose:
            # In place, so that a picture that is being drawn has it, too.
            self._inputs[number] = message.input
            return
        if isinstance(message, Size):
            self._newest_size = message
        else:
            self._newest_pose = message.camera if isinstance(message, View) else None
        key = _replaces(message)
        if key is not None:
            self._pending = [each for each in self._pending if _replaces(each[1]) != key]
        if len(self._pending) >= MOST_PENDING:
            self._members[number].client.send(_error("too many messages at a time", message))
            return
        self._pending.append((number, message))

    def _apply(self, number: int, message: Change) -> None:
        """Apply a message to what is shown; an error, whatever it is, is answered and leaves it as it is."""
        try:
            match message:
                case View(camera=camera):
                    kept = {key: one for key, one in self._shown.data["camera"].items() if key not in CAMERA}
                    self._show({**self._shown.data, "camera": {**kept, **camera.model_dump(mode="json")}}, view=True)
                case Size():
                    self._resize(message)
                case Edit(changes=changes, merge=tag):
                    self._edit(changes, tag)
                case Preset(volume=volume, name=name):
                    self._edit(self._content.preset(volume, name), None)
                case Undo():
                    self._undo()
                case Redo():
                    self._redo()
                case Reset():
                    self._reset()
        except Exception as error:
            found = _error(describe(error), message)
            self.answer(number, lambda client: client.send(found))
        if isinstance(message, (View, Edit)):
            self._inputs = {**self._inputs, number: max(message.input, self._inputs.get(number, 0))}

    def _resize(self, message: Size) -> None:
        size = [message.width, message.height]
        if size != list(self._shown.completed.image.size):
            self._show({**self._shown.data, "image": {**self._shown.data["image"], "size": size}})

    def _undo(self) -> None:
        shown = self._shown
        if shown.undo:
            before = shown.data
            self._show(self._with_view(shown.undo[-1].data))
            shown.undo.pop()
            shown.redo.append(before)

    def _redo(self) -> None:
        shown = self._shown
        if shown.redo:
            before = shown.data
            self._show(self._with_view(shown.redo[-1]))
            shown.redo.pop()
            shown.undo.append(_Undo(before))

    def _reset(self) -> None:
        before = self._shown.data
        self._show({**self._with_view(self._opened), "camera": self._opened["camera"]})
        self._remember(before, None)

    def _edit(self, changes: Mapping[str, Any], tag: str | None) -> None:
        before = self._shown.data
        data = apply_changes(before, {key: value for key, value in changes.items() if key != HIDDEN})
        if HIDDEN in changes:
            data[HIDDEN] = changes[HIDDEN] or []
        self._show(data)
        if self._shown.data != before:
            self._remember(before, tag)

    def _remember(self, before: Data, tag: str | None) -> None:
        """Note scene data that an edit has replaced."""
        shown = self._shown
        if tag is None or not shown.undo or shown.undo[-1].tag != tag or shown.redo:
            shown.undo = [*shown.undo, _Undo(before, tag)][-MOST_UNDO:]
        shown.redo = []

    def _with_view(self, data: Data) -> Data:
        """Return earlier scene data with the present camera and size."""
        image = {**data.get("image", {}), "size": list(self._shown.completed.image.size)}
        return {**data, "camera": self._shown.data["camera"], "image": image}

    def _show(self, data: Data, view: bool = False) -> None:
        """Check scene data, and show them.

        Raises
        ------
        InputError
            They are not a scene within the limits; what is shown stays.
        """
        given = self._limits.admit(_scene_part(data))
        scene = check_scene(given, "scene", {})
        self._limits.check(scene)
        hidden = _checked_entries(data.get(HIDDEN, []), scene)
        completed = self._content.complete(scene)
        data = _with_view_of(given | ({HIDDEN: list(hidden)} if HIDDEN in data else {}), completed)
        with self._lock:
            self._shown.data, self._shown.scene, self._shown.completed = data, scene, completed
            self._shown.hidden = hidden
            self._number += 1
            self._revision += not view

    def _steer(self, number: int, message: Steer) -> None:
        action, other = message.action, message.client
        if action == "ask" and self._steering is None:
            self._give(number)
        elif action == "ask" and number != self._steering and number not in self._asking:
            self._asking.append(number)
        elif action == "release" and number == self._steering:
            self._steering = None
            if self._asking:
                self._give(self._asking[0])
        elif action in ("grant", "refuse") and number == self._steering and other in self._asking:
            self._asking.remove(other)
            if action == "grant":
                self._give(other)
        self._send_state()

    def _give(self, number: int) -> None:
        """Let a client steer, whose size the picture gets."""
        self._steering, self._asking = number, [each for each in self._asking if each != number]
        size = self._members[number].size
        if size is not None:
            self._put(number, size)
        self._send_state()

    def _described(self) -> Data:
        shown = self._shown
        return {
            "type": "state",
            "revision": self._revision,
            "scene": public_data(shown.completed),
            "given": change_paths(_scene_part(shown.data), public_address),
            "hidden": list(shown.hidden),
            "steering": self._steering,
            "clients": list(self._members),
            "asking": list(self._asking),
            "can_undo": bool(shown.undo),
            "can_redo": bool(shown.redo),
            "warnings": list(self._warnings),
            **self._content.state(shown.completed),
        }

    def _send_state(self) -> None:
        self._state = self._described()
        self._state_sent, self._state_revision = self._clock(), self._revision
        for number, member in self._members.items():
            member.client.send({**self._state, "input": self._inputs.get(number, 0)})

    def _send_all(self, message: Data) -> None:
        for member in self._members.values():
            member.client.send(message)


def visible(scene: Scene, hidden: Collection[str]) -> Scene:
    """Return a scene without hidden entries, such as "volumes.1"."""
    if not hidden:
        return scene
    scene = without_flows(scene, {key for key in scene.entries if dotted(key) in hidden})
    kept = {
        name: tuple(one for n, one in enumerate(getattr(scene, name)) if f"{name}.{n}" not in hidden) for name in LISTS
    }
    kept["flows"] = tuple(_on_shown_surfaces(flow, hidden) for flow in kept["flows"])
    found = scene.model_copy(update=kept)
    if found.surface_keys:
        return found
    return found.model_copy(update={"flows": tuple(flow for flow in found.flows if flow.show != "surface-lic")})


def _on_shown_surfaces(flow: FlowSection, hidden: Collection[str]) -> FlowSection:
    """Return a flow whose surfaces have the numbers that are left without hidden entries."""
    if flow.surfaces is None:
        return flow
    found = []
    for name, number in (key.rstrip("]").split("[") for key in flow.surfaces):
        before = sum(f"{name}.{n}" in hidden for n in range(int(number)))
        found += [f"{name}[{int(number) - before}]"] if f"{name}.{number}" not in hidden else []
    return flow.model_copy(update={"surfaces": tuple(found)})


def _checked_entries(hidden: Any, scene: Scene) -> tuple[str, ...]:
    known = list(map(dotted, scene.entries))
    if not isinstance(hidden, list) or any(name not in known for name in hidden):
        raise SceneError("not a list of entries", where=HIDDEN, found=hidden, allowed=", ".join(known))
    return tuple(dict.fromkeys(hidden))


def _data_of(scene: Scene) -> Data:
    """Return a completed scene as data with the keys that were set or chosen, and a whole camera."""
    data = scene.model_dump(mode="json", exclude_unset=True)
    data.pop("automatic", None)
    return _with_view_of(data, scene)


def _with_view_of(data: Data, completed: Scene) -> Data:
    """Return scene data with the whole camera and the size of a completed scene, whatever they leave out."""
    lens = completed.camera.model_dump(mode="json", include=set(LENS), exclude_defaults=True)
    image = {**data.get("image", {}), "size": list(completed.image.size)}
    return {**data, "camera": {**_camera_of(completed.camera), **lens}, "image": image}


def _scene_part(data: Data) -> Data:
    """Return a copy of scene data without what is hidden."""
    return copy.deepcopy({key: value for key, value in data.items() if key != HIDDEN})


def _camera_of(camera: Camera) -> Data:
    return camera.model_dump(mode="json", include=set(CAMERA))


def _replaces(message: Change) -> Any:
    """Return what a message has in common with those that it replaces; None if it replaces none."""
    if isinstance(message, Edit) and message.merge is not None:
        return message.merge, frozenset(message.changes)
    return type(message) if isinstance(message, (View, Size)) else None


def _error(text: str, message: Change | None = None) -> Data:
    """Return the message of an error; its key is the changed one that the text names."""
    changes = list(message.changes) if isinstance(message, Edit) else []
    named = (key for key in changes if key in text or re.sub(r"\.(\d+)", r"[\1]", key) in text)
    key = next(named, changes[0] if len(changes) == 1 else None)
    found = {"type": "error", "message": text, "key": key}
    return found | ({"input": message.input} if isinstance(message, (View, Edit)) else {})
