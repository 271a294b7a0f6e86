"""Session of a scene that a thread of this process draws, without a server.

Only this thread uses OpenGL. Messages of clients are text, as of a websocket, and so are the answers.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from pydantic_core import to_json

from clusterviz.comm import LoopbackChannel
from clusterviz.errors import ClustervizError, InputError
from clusterviz.frame.opening import Given
from clusterviz.scene.values import Scene
from clusterviz.viewer.encoding import Picture
from clusterviz.viewer.flow_control import FlowControl
from clusterviz.viewer.messages import Ack, Ping, pack, parse
from clusterviz.viewer.pace import Pace
from clusterviz.viewer.render_loop import RenderLoop
from clusterviz.viewer.session import Session

CLOSE_SECONDS = 10.0
"""Time for the frame that is being drawn when a session ends."""
BUDGET_MS = 50.0
"""Time of a picture while the view moves."""


class LocalSession:
    """Session that a thread of this process draws, until it is closed.

    `sources`: the data instead of the files that the scene names. Raises ClustervizError: the scene cannot be opened.
    """

    def __init__(self, scene: Scene, sources: Given = None) -> None:
        opened: Future[Session] = Future()
        self._encoder = ThreadPoolExecutor(1, "clusterviz-encoder")
        self._thread = threading.Thread(target=_draw, args=(scene, sources, opened), name="clusterviz", daemon=True)
        self._thread.start()
        self._session = opened.result()

    def connect(self, put_text: Callable[[str], None], put_binary: Callable[[bytes], None]) -> LocalConnection:
        """Add a client, whose messages go to two functions that any thread may call."""
        return LocalConnection(self._session, self._encoder, put_text, put_binary)

    def close(self) -> None:
        """End the session and its thread."""
        self._session.close("it was closed")
        self._encoder.shutdown(wait=False, cancel_futures=True)
        if threading.current_thread() is not self._thread:
            self._thread.join(CLOSE_SECONDS)


def _draw(scene: Scene, sources: Given, opened: Future[Session]) -> None:
    """Open a scene and draw its session until it ends; for a thread of its own."""
    try:
        loop = RenderLoop(scene, LoopbackChannel(), sources)
        session = Session(loop.scene, loop.content, budget_ms=BUDGET_MS, shared=True)
    except BaseException as error:
        opened.set_exception(error)
        return
    opened.set_result(session)
    try:
        loop.lead(session, Pace(BUDGET_MS / 1000))
    except ClustervizError as error:
        session.close(str(error))
    except BaseException as error:
        session.close(f"{type(error).__name__}: {error}")
        raise


class LocalConnection:
    """Client of a session in this process; its methods may be called from any thread.

    `encoder`: runs the encoding of pictures. `put_text`, `put_binary`: called with messages for the client.
    """

    def __init__(
        self,
        session: Session,
        encoder: ThreadPoolExecutor,
        put_text: Callable[[str], None],
        put_binary: Callable[[bytes], None],
    ) -> None:
        self._session, self._encoder = session, encoder
        self._put_text, self._put_binary = put_text, put_binary
        self._flow, self._lock = FlowControl(), threading.Lock()
        self._number = 0  # until the session has given one
        self._number = session.join(self)

    def receive(self, text: str) -> None:
        """Take a message of the client."""
        try:
            message = parse(text)
        except InputError as error:
            self.send({"type": "error", "message": str(error), "key": None})
            return
        match message:
            case Ack(picture=number):
                with self._lock:
                    self._flow.acknowledge(number, time.monotonic())
                self._encode()
            case Ping(time=sent):
                self.send({"type": "pong", "time": sent})
            case _:
                self._session.receive(self._number, message)

    def close(self) -> None:
        """Leave the session."""
        self._session.leave(self._number)

    def send(self, message: dict[str, Any]) -> None:
        """Send a JSON message; numbers that are not finite become null."""
        self._put_text(to_json(message, inf_nan_mode="null").decode())

    def send_file(self, save: int, name: str, media_type: str, content: bytes) -> None:
        """Send a file, the answer to a `save`."""
        self._put_binary(pack({"kind": "file", "save": save, "name": name, "media_type": media_type}, content))

    def show(self, picture: Picture) -> None:
        """Send a picture, unless a newer one comes before the client can take it."""
        with self._lock:
            self._flow.offer(picture)
        self._encode()

    def _encode(self) -> None:
        with suppress(RuntimeError):  # the session has been closed
            self._encoder.submit(self._send_pictures)

    def _send_pictures(self) -> None:
        while True:
            with self._lock:
                taken = self._flow.take(time.monotonic())
            if taken is None:
                return
            picture, encoding = taken
            data = picture.message(encoding, self._number)
            self._put_binary(data)
            with self._lock:
                self._flow.sent(picture, encoding, len(data), time.monotonic())
