"""Connection of one browser: its messages to the session, in order, and its queue of messages and pictures.

Messages of the client are read no faster than they are handled, and of consecutive views only the last is handled.
Messages to the client are never left out; one whose queue is full is closed. Pictures follow `FlowControl`.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from typing import Any

from pydantic_core import to_json
from starlette.websockets import WebSocket, WebSocketDisconnect

from clusterviz.comm.agree import describe
from clusterviz.errors import InputError
from clusterviz.viewer.encoding import Picture
from clusterviz.viewer.flow_control import FlowControl
from clusterviz.viewer.messages import Ack, Ping, pack, parse
from clusterviz.viewer.session import Session

MAX_MALFORMED = 10
"""Malformed messages after which a client is closed."""
MAX_QUEUED, MAX_QUEUED_BYTES = 1024, 32 << 20
"""Messages that wait for a client, and their bytes without the last one's."""
MAX_PENDING = 64
"""Messages of a client that wait for the session."""
MAX_READ, MAX_HANDLED = 20_000, 2000
"""Messages of a client that are read in a second, and that are handled."""
WRITE_SECONDS, CLOSE_SECONDS = 20.0, 2.0
"""Time for a client to take a message, and to answer the end of the connection."""
VIEW_PREFIX = '{"type":"view"'
GOING_AWAY, UNSUPPORTED, ABNORMAL, POLICY = 1001, 1003, 1006, 1008
"""Codes with which websockets are closed, RFC 6455, section 7.4.1."""


class RateLimit:
    """Limit of messages a second, as a token bucket that holds those of a fiftieth of a second."""

    def __init__(self, per_second: float) -> None:
        self._seconds, self._free_at = 1 / per_second, 0.0

    async def wait(self) -> None:
        """Count a message; wait while there are too many."""
        now = time.monotonic()
        self._free_at = max(self._free_at + self._seconds, now - 0.02)
        if self._free_at > now:
            await asyncio.sleep(self._free_at - now)


class ClosedError(Exception):
    """End of a connection by the server. `reason`: short text for the client."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code, self.reason = code, reason


class Connection:
    """Client of a session at the other end of a websocket.

    Parameters
    ----------
    websocket : accepted; its state has the `transport`
    encoders : runs the encoding of pictures

    Notes
    -----
    `send`, `send_file` and `show` may be called from any thread. They never block, and do nothing after the end.
    """

    def __init__(self, websocket: WebSocket, encoders: Executor) -> None:
        self._websocket, self._encoders = websocket, encoders
        self._loop = asyncio.get_running_loop()
        self._flow = FlowControl()
        self._wants_picture = asyncio.Event()
        self._queue: deque[str | bytes] = deque()
        self._queued_bytes = 0
        self._has_queued = asyncio.Event()
        self._pending: deque[str] = deque()
        self._has_pending, self._has_room = asyncio.Event(), asyncio.Event()
        self._malformed = 0
        self._closing: asyncio.Future[ClosedError] = self._loop.create_future()
        self._is_finishing, self._has_ended = False, asyncio.Event()

    def send(self, message: dict[str, Any]) -> None:
        """Send a JSON message; numbers that are not finite become null."""
        self._call(self._put, to_json(message, inf_nan_mode="null").decode())

    def send_file(self, save: int, name: str, media_type: str, content: bytes) -> None:
        """Send a file, the answer to a `save`."""
        header = {"kind": "file", "save": save, "name": name, "media_type": media_type}
        self._call(self._put, pack(header, content))

    def show(self, picture: Picture) -> None:
        """Send a picture, unless a newer one comes before the client can take it."""
        self._call(self._offer, picture)

    async def serve(self, session: Session) -> None:
        """Exchange messages until one side ends the connection."""
        self._number, closing = session.join(self), None
        try:
            async with asyncio.TaskGroup() as group:
                for part in self._read, self._write_queued, self._write_pictures, self._wait_for_closing:
                    group.create_task(part())
                group.create_task(self._handle(session))
        except* WebSocketDisconnect:
            pass
        except* ClosedError as found:
            closing = found.exceptions[0]
        finally:
            session.leave(self._number)
            self._has_ended.set()
        if isinstance(closing, ClosedError):
            await self._close(closing)

    async def finish(self) -> None:
        """Send what is queued and end the connection."""
        self._is_finishing = True
        self._has_queued.set()
        await self._has_ended.wait()

    def _call(self, function: Callable[..., None], value: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(function, value)

    def _offer(self, picture: Picture) -> None:
        self._flow.offer(picture)
        self._wants_picture.set()

    def _put(self, data: str | bytes) -> None:
        if len(self._queue) >= MAX_QUEUED or self._queued_bytes > MAX_QUEUED_BYTES:
            self._end(ClosedError(POLICY, "the client does not read its messages"))
            return
        self._queue.append(data)
        self._queued_bytes += len(data)
        self._has_queued.set()

    def _end(self, closing: ClosedError) -> None:
        if not self._closing.done():
            self._closing.set_result(closing)

    async def _wait_for_closing(self) -> None:
        raise await self._closing

    async def _read(self) -> None:
        limit = RateLimit(MAX_READ)
        while True:
            await limit.wait()
            event = await self._websocket.receive()
            if event["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(event.get("code", 1005))
            text = event.get("text")
            if text is None:
                raise ClosedError(UNSUPPORTED, "messages are text")
            if self._pending and text.startswith(VIEW_PREFIX) and self._pending[-1].startswith(VIEW_PREFIX):
                self._pending[-1] = text
                continue
            while len(self._pending) >= MAX_PENDING:
                self._has_room.clear()
                await self._has_room.wait()
            self._pending.append(text)
            self._has_pending.set()

    async def _handle(self, session: Session) -> None:
        limit = RateLimit(MAX_HANDLED)
        while True:
            await self._has_pending.wait()
            while self._pending:
                await limit.wait()
                self._has_room.set()
                self._handle_one(session, self._pending.popleft())
            self._has_pending.clear()

    def _handle_one(self, session: Session, text: str) -> None:
        try:
            message = parse(text)
        except InputError as error:
            self.send({"type": "error", "message": str(error), "key": None})
            self._malformed += 1
            if self._malformed >= MAX_MALFORMED:
                raise ClosedError(POLICY, "too many malformed messages") from None
            return
        match message:
            case Ack(picture=shown):
                self._flow.acknowledge(shown, time.monotonic())
                self._wants_picture.set()
            case Ping(time=sent):
                self.send({"type": "pong", "time": sent})
            case _:
                try:
                    session.receive(self._number, message)
                except Exception as error:  # whatever it is, it is the client's
                    found = getattr(message, "input", None)
                    self.send({"type": "error", "message": describe(error), "key": None, "input": found})

    async def _write_queued(self) -> None:
        while True:
            await self._has_queued.wait()
            while self._queue:
                data = self._queue.popleft()
                self._queued_bytes -= len(data)
                await self._write(data)
            self._has_queued.clear()
            if self._is_finishing:
                raise ClosedError(GOING_AWAY, "the session has ended")

    async def _write_pictures(self) -> None:
        while True:
            await self._wants_picture.wait()
            while taken := self._flow.take(time.monotonic()):
                picture, encoding = taken
                data = await self._loop.run_in_executor(self._encoders, picture.message, encoding, self._number)
                if picture.still and self._flow.has_newer:
                    continue
                await self._write(data)
                self._flow.sent(picture, encoding, len(data), time.monotonic())
            self._wants_picture.clear()

    async def _write(self, data: str | bytes) -> None:
        kind = "text" if isinstance(data, str) else "bytes"
        try:
            async with asyncio.timeout(WRITE_SECONDS):
                await self._websocket.send({"type": "websocket.send", kind: data})
        except TimeoutError:
            raise ClosedError(POLICY, "the client does not read") from None
        except RuntimeError:  # another task has found that the client has left
            raise WebSocketDisconnect(ABNORMAL) from None

    async def _close(self, closing: ClosedError) -> None:
        """Close the websocket, and the connection below it if the client does not answer."""
        self._loop.call_later(CLOSE_SECONDS, self._websocket.state.transport.abort)
        with suppress(WebSocketDisconnect, RuntimeError, TimeoutError):
            async with asyncio.timeout(CLOSE_SECONDS):
                await self._websocket.close(closing.code, closing.reason)
