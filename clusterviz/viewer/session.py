"""State of a live session: what is shown, who steers, and what is drawn next.

Clients call `receive` from any thread; it only stores the message. The drawing thread takes requests: it applies the
messages that have come since, of which newer ones replace older ones of the same kind, so that nothing queues.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from clusterviz.comm.agree import describe
from clusterviz.errors import ClustervizError, public_address
from clusterviz.scene.background import background_rgb
from clusterviz.scene.files import change_paths, public_data
from clusterviz.scene.values import Scene
from clusterviz.viewer.describe import Content
from clusterviz.viewer.encoding import Picture
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
from clusterviz.viewer.shown import Data, Shown, camera_of

REST_SECONDS = 0.25
"""Time without input after which a view counts as still, whatever the client said."""
ALONE_SECONDS = 10.0
"""Time in which a client may join again, as by a reload."""
MOST_PENDING = 256
"""Messages that wait to be applied, at most."""
STATE_SECONDS = 0.2
"""Least time between two states while the scene is edited."""
STATISTICS_SECONDS = 0.5
"""Least time between two statistics while the view moves."""
Change = View | Edit | Undo | Redo | Reset | Preset | Size
"""Messages that change what is shown; only the client that steers may send them."""


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
    """Picture to draw."""

    number: int
    scene: Scene  # as the user gave it, with a camera, without what is hidden
    completed: Scene
    revision: int  # of the scene without its camera
    inputs: Mapping[int, int]  # number of the last input of each client that the picture shows
    moving: bool  # whether the view is changing
    hidden: tuple[str, ...] = ()  # entries that are left out, such as volumes.1


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
        self._clock, self._shared, self._ends_alone = clock, shared, ends_alone
        self._about = {"ranks": ranks, "budget_ms": budget_ms}
        self._shown = Shown(scene, content, self._lock, folders)
        self._drawn_data = self._shown.data
        self._members: dict[int, _Member] = {}
        self._joined, self._left = 0, 0.0
        self._steering: int | None = None
        self._asking: list[int] = []
        self._pending: list[tuple[int, Change]] = []
        self._jobs: list[tuple[int, Pick | Save]] = []
        self._drawn, self._inputs = 0, dict[int, int]()
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
        return self._shown.scene

    @property
    def completed(self) -> Scene:
        """The scene with all keys."""
        return self._shown.completed

    def join(self, client: Client) -> int:
        """Add a client, send it the state and the newest picture, and return its number."""
        with self._lock:
            self._joined += 1
            number = self._joined
            self._members[number] = _Member(client)
            about = {**self._about, **self._shown.content.hello()}
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

        `picture`: float32 (h, w, 4), premultiplied. `warnings`: texts about the scene.
        """
        camera = camera_of(request.completed.camera)
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
            self._shown.go_back(self._drawn_data)

    def busy(self, text: str) -> None:
        """Tell all clients why the next picture takes long; its arrival ends that."""
        with self._lock:
            self._is_busy = True
            self._send_all({"type": "busy", "message": text})

    def reopened(self, content: Content) -> None:
        """Take what is known of the data of a scene with other files or grids."""
        self._shown.content = content

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
        return self._drawn < self._shown.number or (self._was_moving and not self._is_moving)

    def _request(self, moving: bool) -> Request:
        shown = self._shown
        about = shown.revision, self._inputs, moving, shown.hidden
        return Request(shown.number, shown.scene, shown.completed, *about)

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
        shown = self._shown
        try:
            match message:
                case View(camera=camera):
                    shown.look(camera)
                case Size(width=width, height=height):
                    shown.resize((width, height))
                case Edit(changes=changes, merge=tag):
                    shown.edit(changes, tag)
                case Preset(volume=volume, name=name):
                    shown.edit(shown.content.preset(volume, name), None)
                case Undo():
                    shown.undo()
                case Redo():
                    shown.redo()
                case Reset():
                    shown.reset()
        except Exception as error:
            found = _error(describe(error), message)
            self.answer(number, lambda client: client.send(found))
        if isinstance(message, (View, Edit)):
            self._inputs = {**self._inputs, number: max(message.input, self._inputs.get(number, 0))}

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
            "revision": shown.revision,
            "scene": public_data(shown.whole),
            "given": change_paths(shown.scene_data(), public_address),
            "hidden": list(shown.hidden),
            "steering": self._steering,
            "clients": list(self._members),
            "asking": list(self._asking),
            "can_undo": shown.can_undo,
            "can_redo": shown.can_redo,
            "warnings": list(self._warnings),
            **shown.content.state(shown.whole),
        }

    def _send_state(self) -> None:
        self._state = self._described()
        self._state_sent, self._state_revision = self._clock(), self._shown.revision
        for number, member in self._members.items():
            member.client.send({**self._state, "input": self._inputs.get(number, 0)})

    def _send_all(self, message: Data) -> None:
        for member in self._members.values():
            member.client.send(message)


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
