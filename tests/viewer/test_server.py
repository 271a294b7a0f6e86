"""The viewer's server refuses strangers and survives bad clients; the session behind it is a fake that draws none."""

from __future__ import annotations

import asyncio
import http.client
import io
import json
import logging
import secrets
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from typing import Any, cast
from urllib.parse import quote

import numpy as np
import pytest
from PIL import Image
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from clusterviz.cli.view import TOKEN_VARIABLE, _announce, _token
from clusterviz.errors import InputError
from clusterviz.viewer import connection, flow_control, server
from clusterviz.viewer.connection import MAX_MALFORMED, MAX_QUEUED, Connection
from clusterviz.viewer.encoding import Picture
from clusterviz.viewer.messages import MAX_TEXT_BYTES, Edit, Message, Undo, View, unpack
from clusterviz.viewer.server import Server, open_socket

TOKEN = secrets.token_urlsafe(16)
BEARER = {"Authorization": f"Bearer {TOKEN}"}
CAMERA = {"position": [0, 0, 5], "focal_point": [0, 0, 0], "view_up": [0, 1, 0]}
SMALL = np.full((2, 2, 4), 0.5, np.float32)
PATIENCE = 30.0
"""Seconds until a test fails that waits in vain."""


class Session:
    """Session that shows a picture for each view at once, and keeps the messages."""

    def __init__(self) -> None:
        self.clients: dict[int, Connection] = {}
        self.messages: list[tuple[int, Message]] = []
        self._joined = 0
        self.rgba = SMALL

    def join(self, client: Connection) -> int:
        self._joined += 1
        self.clients[self._joined] = client
        client.send({"type": "hello", "client": self._joined})
        return self._joined

    def leave(self, number: int) -> None:
        del self.clients[number]

    def receive(self, number: int, message: Message) -> None:
        self.messages.append((number, message))
        if isinstance(message, View):
            self.show(message.input, still=not message.moving)
        if isinstance(message, Undo):
            raise InputError("nothing to undo", where="undo")

    def show(self, number: int, still: bool = False) -> None:
        picture = Picture(self.rgba, (0, 0, 0), number, 0, dict.fromkeys(self.clients, number), still, {}, 0.0)
        for client in list(self.clients.values()):
            client.show(picture)


class Served:
    """Server with its session, and what a client does."""

    def __init__(self, token: str = TOKEN, **options: Any) -> None:
        self.session = Session()
        self.server = Server(self.session, open_socket("127.0.0.1", 0), token, **options)
        self.address = f"127.0.0.1:{self.server.port}"
        self.cookie = {"Cookie": f"clusterviz-{self.server.port}={TOKEN}"}
        self.server.start()

    def get(self, path: str, headers: dict[str, str], method: str = "GET") -> http.client.HTTPResponse:
        """The answer to a request, whose path is sent as it is."""
        with closing(http.client.HTTPConnection(self.address, timeout=PATIENCE)) as client:
            client.request(method, path, headers=headers)
            answer = client.getresponse()
            answer.text = answer.read().decode()  # type: ignore[attr-defined]
            return answer

    def connect(self, port: int = 0, **headers: str) -> AbstractContextManager[ClientConnection]:
        return connect(
            f"ws://127.0.0.1:{port or self.server.port}/ws",
            additional_headers=headers or BEARER,
            compression=None,
            max_size=None,
            open_timeout=PATIENCE,
        )


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    """A server that all tests share, which harmless clients alone visit."""
    found = Served(origins=["https://hub.example/"])
    yield found
    found.server.close()


@contextmanager
def serving(token: str = TOKEN) -> Iterator[Served]:
    """A server of one test."""
    found = Served(token)
    try:
        yield found
    finally:
        found.server.close()


def text(message: dict[str, Any]) -> str:
    return json.dumps(message, separators=(",", ":"))


def view(number: int, moving: bool = True) -> str:
    return text({"type": "view", "camera": CAMERA, "moving": moving, "input": number})


def received(client: ClientConnection) -> dict[str, Any]:
    """The next message, or the header of the next picture, which is acknowledged."""
    data = client.recv(timeout=PATIENCE)
    found: dict[str, Any] = json.loads(data) if isinstance(data, str) else unpack(data)[0]
    if found.get("kind") == "picture":
        client.send(text({"type": "ack", "picture": found["picture"]}))
    return found


def until(holds: Callable[[], bool]) -> None:
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.005)


def closed(client: ClientConnection) -> tuple[int, str]:
    """The code and the reason with which the server closes, after what it still sends."""
    with pytest.raises(ConnectionClosed) as end:
        list(iter(lambda: client.recv(timeout=PATIENCE), None))
    assert end.value.rcvd is not None
    return end.value.rcvd.code, end.value.rcvd.reason


@contextmanager
def slow_link(port: int, delay: float, megabits: float) -> Iterator[int]:
    """Port of a relay to another over a link with a delay to each side and a bandwidth."""

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop, free = asyncio.get_running_loop(), 0.0
        while data := await reader.read(16384):
            free = max(free, loop.time()) + len(data) / (megabits * 125_000)
            loop.call_at(free + delay, writer.write, data)
            await asyncio.sleep(free - loop.time())
        loop.call_at(free + delay, writer.close)

    async def relay(near: asyncio.StreamReader, back: asyncio.StreamWriter) -> None:
        far, there = await asyncio.open_connection("127.0.0.1", port, limit=16384)
        await asyncio.gather(carry(near, there), carry(far, back))

    async def serve() -> None:
        await asyncio.start_server(relay, sock=listening)
        await ended.wait()

    listening, ended, loop = open_socket("127.0.0.1", 0), asyncio.Event(), asyncio.new_event_loop()
    thread = threading.Thread(target=lambda: asyncio.Runner(loop_factory=lambda: loop).run(serve()))
    thread.start()
    yield listening.getsockname()[1]
    loop.call_soon_threadsafe(ended.set)
    thread.join()


OWN: Any = "own"
REQUESTS = {
    "no-token": ("/", {}, 401),
    "wrong-token": ("/?token=wrong", {}, 401),
    "empty-token": ("/?token=", {}, 401),
    "foreign-letters": ("/?token=%C3%A9%00", {}, 401),
    "token-elsewhere": (f"/static/viewer.css?token={TOKEN}", {}, 401),
    "wrong-bearer": ("/", {"Authorization": "Bearer wrong"}, 401),
    "bearer": ("/", BEARER, 200),
    "cookie": ("/", OWN, 200),
    "other-cookies": ("/", {"Cookie": f"a=b; clusterviz-1={TOKEN}; clusterviz-{TOKEN}=1"}, 401),
    "wrong-token-with-cookie": ("/?token=wrong", OWN, 401),
    "login": (f"/?token={TOKEN}", {}, 303),
    "file": ("/static/viewer.css", OWN, 200),
    "file-without": ("/static/viewer.css", {}, 401),
    "unknown-file": ("/static/none.css", OWN, 404),
    "folder": ("/static/", OWN, 404),
    "traversal": ("/static/../server.py", OWN, 404),
    "encoded-traversal": ("/static/%2e%2e%2fserver.py", OWN, 404),
    "twice-encoded": ("/static/%252e%252e%252fserver.py", OWN, 404),
    "backslashes": ("/static/..%5cserver.py", OWN, 404),
    "absolute": ("/static//etc/passwd", OWN, 404),
    "root": ("//etc/passwd", OWN, 404),
    "null": ("/static/viewer.css%00.js", OWN, 404),
    "other-host": ("/", {**BEARER, "Host": "evil.example"}, 421),
    "other-host-that-resolves-here": ("/", {**BEARER, "Host": "127.0.0.1.evil.example:80"}, 421),
    "no-host": ("/", {**BEARER, "Host": ""}, 421),
    "odd-host": ("/", {**BEARER, "Host": "[::1"}, 421),
    "tunnel": ("/", {**BEARER, "Host": "localhost:9999"}, 200),
    "proxy": ("/", {**BEARER, "Host": "hub.example"}, 200),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_requests(served: Served, name: str) -> None:
    path, headers, status = REQUESTS[name]
    answer = served.get(path, served.cookie if headers is OWN else dict(headers))
    assert answer.status == status
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert "default-src 'none'; script-src 'self';" in answer.headers["Content-Security-Policy"]
    assert answer.headers["Cache-Control"] == "no-store"
    assert "import" not in answer.text.split("\n")[0]  # type: ignore[attr-defined]


@pytest.mark.parametrize("site", ["none", "same-origin", "cross-site"])
def test_token_becomes_a_cookie(served: Served, site: str) -> None:
    assert {served.get("/", BEARER, method).status for method in ("POST", "PUT", "DELETE")} == {405}
    answer = served.get(f"/?token={TOKEN}", {"Sec-Fetch-Site": site})
    name, _, attributes = answer.headers["Set-Cookie"].partition("=")
    assert name == f"clusterviz-{served.server.port}"
    assert {each.strip().lower() for each in attributes.split(";")} == {TOKEN.lower(), "httponly", "samesite=strict"}
    assert answer.headers["Location" if site != "cross-site" else "Refresh"].endswith("./")
    assert served.get("/", {"Cookie": answer.headers["Set-Cookie"].partition(";")[0]}).status == 200


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 401),
        ({"Authorization": "Bearer wrong", "Origin": OWN}, 401),
        ({"Origin": OWN}, 401),
        ({"Cookie": OWN}, 403),
        ({"Cookie": OWN, "Origin": "http://evil.example"}, 403),
        ({"Cookie": OWN, "Origin": "http://localhost:1"}, 403),
        ({"Cookie": OWN, "Origin": "null"}, 403),
        ({"Cookie": OWN, "Origin": "http://["}, 403),
        ({**BEARER, "Origin": "http://evil.example"}, 403),
        ({**BEARER, "Host": "evil.example", "Origin": "http://evil.example"}, 421),
        ({"Cookie": OWN, "Origin": OWN}, 101),
        ({"Cookie": OWN, "Origin": "https://hub.example"}, 101),
        (BEARER, 101),
    ],
)
def test_websockets_are_for_own_pages(served: Served, headers: dict[str, str], status: int) -> None:
    own = {"Origin": f"http://{served.address}", **served.cookie}
    sent = {name: own[name] if value is OWN else value for name, value in headers.items()}
    if "Host" in sent:  # the client's library adds its own
        sent = {**sent, "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
        answer = served.get("/ws", {**sent, "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="})
        assert answer.status == status
        return
    if status == 101:
        with served.connect(**sent) as client:
            assert received(client)["type"] == "hello"
        return
    with pytest.raises(InvalidStatus) as refused, served.connect(**(sent or {"X": "y"})):
        pass
    assert refused.value.response.status_code == status


def test_view_is_answered_with_its_picture(served: Served) -> None:
    with served.connect() as client:
        number = received(client)["client"]
        client.send(view(3, moving=False))
        data = client.recv(timeout=PATIENCE)
        assert isinstance(data, bytes)
        header, file = unpack(data)
        assert (header["input"], header["still"], header["format"]) == (3, True, "png")
        assert (np.asarray(Image.open(io.BytesIO(file))) == 128).all()
        client.send(text({"type": "ping", "time": 1.5}))
        assert received(client) == {"type": "pong", "time": 1.5}
        client.send(text({"type": "undo"}))
        assert received(client) == {"type": "error", "message": "undo: nothing to undo", "key": None, "input": None}
    assert [type(each) for owner, each in served.session.messages if owner == number] == [View, Undo]


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        (b"binary", 1003),
        ("x" * (MAX_TEXT_BYTES + 1), 1009),
        *[(message, 1008) for message in ("", "[]", "{", '{"type":"shell"}', '{"type":"size","width":NaN,"height":1}')],
    ],
    ids=["binary", "oversized", "empty", "list", "half", "unknown", "nan"],
)
def test_malformed_messages_are_answered_until_there_are_too_many(served: Served, sent: str | bytes, code: int) -> None:
    with served.connect() as client:
        received(client)
        if code == 1008:
            for _ in range(MAX_MALFORMED - 1):
                client.send(sent)
                assert received(client)["type"] == "error"
            client.send(text({"type": "ping", "time": 0}))
            assert received(client)["type"] == "pong"
        client.send(sent)
        assert closed(client)[0] == code


def test_messages_arrive_in_order_from_any_thread(served: Served) -> None:
    with served.connect() as client:
        end = served.session.clients[received(client)["client"]]

        def send(thread: int) -> None:
            for number in range(50):
                end.send({"type": "text", "thread": thread, "number": number, "value": float("nan")})
            end.send_file(thread, "scene.yaml", "text/yaml", b"volumes: []")

        with ThreadPoolExecutor(4) as threads:
            list(threads.map(send, range(4)))
        messages = [received(client) for _ in range(4 * 51)]
    for thread in range(4):
        own = [each for each in messages if thread in (each.get("thread"), each.get("save"))]
        assert [each.get("number") for each in own] == [*range(50), None]
        assert own[-1] == {"kind": "file", "save": thread, "name": "scene.yaml", "media_type": "text/yaml"}
    assert {each.get("value", None) for each in messages} == {None}


def test_client_gets_the_newest_picture_once_it_has_shown_two() -> None:
    with serving() as served, served.connect() as client:
        received(client)
        for number in range(1, 11):
            client.send(view(number, moving=number < 10))
            until(lambda last=number: len(served.session.messages) == last)  # type: ignore[misc]
            if number <= 2:
                assert unpack(client.recv(timeout=PATIENCE))[0]["input"] == number  # type: ignore[arg-type]
        client.send(text({"type": "ping", "time": 0}))
        assert received(client)["type"] == "pong"
        client.send(text({"type": "ack", "picture": 2}))
        assert received(client)["input"] == 10


def test_ten_thousand_messages_a_second_delay_nobody() -> None:
    with serving() as served, served.connect() as flood, served.connect() as other:
        received(flood)
        received(other)
        count = 10_000

        def send() -> None:
            for number in range(1, count + 1):
                flood.send(view(number))

        sender = threading.Thread(target=send)
        sender.start()
        pongs = 0
        while sender.is_alive():
            other.send(text({"type": "ping", "time": pongs}))
            while received(other).get("type") != "pong":
                pass
            pongs += 1
        while received(flood).get("input") != count:
            pass
        handled = len(served.session.messages)
        assert pongs >= 10
        assert handled < count / 2


@pytest.mark.parametrize("count", [25, pytest.param(100, marks=pytest.mark.long)])
def test_slow_link_shows_eight_pictures_a_second(count: int) -> None:
    """The link has 10 Mb/s and 100 ms of delay; 25 pictures a second of 76 kB are drawn, more than it takes."""
    blocks = np.random.default_rng(1).random((75, 100, 4), np.float32)
    with serving() as served, slow_link(served.server.port, 0.05, 10) as port, served.connect(port) as client:
        received(client)
        served.session.rgba = np.kron(blocks, np.ones((8, 8, 1), np.float32))
        shown, number = 0, 0

        def draw() -> None:
            for number in range(1, count + 1):
                served.session.show(number, still=number == count)
                time.sleep(0.04)

        drawing = threading.Thread(target=draw)
        drawing.start()
        while number < count:
            number, shown = received(client)["picture"], shown + 1
        assert shown >= 8 * 0.04 * count  # drawing them takes so many seconds, and more where the machine is busy
        drawing.join()


def test_edits_are_not_left_out() -> None:
    with serving() as served, served.connect() as client:
        received(client)
        for number in range(300):
            client.send(text({"type": "edit", "changes": {"k": number}, "moving": True, "input": number}))
            client.send(view(number))
        until(lambda: len([1 for _, each in served.session.messages if isinstance(each, Edit)]) == 300)
        edits = [each.input for _, each in served.session.messages if isinstance(each, Edit)]
        assert edits == list(range(300))


@contextmanager
def after(function: Callable[[Any], Any], argument: Any) -> Iterator[None]:
    """Context that calls a function first."""
    function(argument)
    yield


@contextmanager
def silent(served: Served) -> Iterator[socket.socket]:
    """A client that asks for a websocket and never reads."""
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect(("127.0.0.1", served.server.port))
        lines = ["GET /ws HTTP/1.1", f"Host: {served.address}", f"Authorization: Bearer {TOKEN}", "Connection: Upgrade"]
        lines += ["Upgrade: websocket", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="]
        known = len(served.session.clients)
        client.sendall("\r\n".join([*lines, "", ""]).encode())
        until(lambda: len(served.session.clients) == known + 1)
        yield client


@pytest.mark.parametrize("sent", ["pictures", "messages", "nothing"])
def test_client_that_does_not_read_is_closed_alone(sent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "WRITE_SECONDS", 0.3)
    monkeypatch.setattr(connection, "CLOSE_SECONDS", 0.1)
    monkeypatch.setattr(flow_control, "ACK_SECONDS", 0.1)
    noise = np.random.default_rng(1).random((600, 800, 4), np.float32)
    with serving() as served, served.connect() as other, after(received, other), silent(served):
        served.session.rgba = noise
        stuck = served.session.clients[2]
        for number in range(1, 4000):
            if sent == "pictures":
                served.session.show(number, still=True)
                assert received(other)["input"] == number
            elif sent == "messages":
                stuck.send({"type": "text", "text": "x" * 20_000})
            if 2 not in served.session.clients or (sent == "nothing" and number == 5):
                break
            assert len(stuck._queue) <= MAX_QUEUED
            time.sleep(0.001)
        if sent != "nothing":
            until(lambda: 2 not in served.session.clients)
        other.send(text({"type": "ping", "time": 0}))
        assert received(other)["type"] == "pong"
        assert set(served.session.clients) == ({1} if sent != "nothing" else {1, 2})


def test_huge_picture_delays_no_message() -> None:
    with serving() as served, served.connect() as client:
        received(client)
        served.session.rgba = np.broadcast_to(np.array([0.2, 0.1, 0.0, 0.5], np.float32), (4096, 2048, 4))
        client.send(view(1, moving=False))
        client.send(text({"type": "ping", "time": 0}))
        assert received(client)["type"] == "pong"
        header = received(client)
        assert (header["width"], header["height"], header["still"]) == (2048, 4096, True)


def test_end_is_told() -> None:
    with serving() as served, served.connect() as client, after(received, client), silent(served):
        served.session.clients[1].send({"type": "ended", "message": "rank 2 died"})
        served.server.close()
        assert received(client) == {"type": "ended", "message": "rank 2 died"}
        assert closed(client) == (1001, "the session has ended")
        assert served.session.clients == {}
        with pytest.raises(OSError, match="refused"):
            socket.create_connection(("127.0.0.1", served.server.port), PATIENCE)
        served.server.close()


def test_too_many_clients_are_asked_to_come_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clusterviz.viewer.server.MAX_CLIENTS", 1)
    with serving() as served, served.connect() as first, served.connect() as second:
        assert received(first)["type"] == "hello"
        assert closed(second) == (1013, "too many clients")


def test_token_is_in_no_log(caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]) -> None:
    caplog.set_level(logging.DEBUG)
    caplog.set_level(logging.INFO, "websockets.client")
    with serving() as served:
        for path in (f"/?token={TOKEN}", f"/none?token={TOKEN}", f"/ws?token={TOKEN}", f"/\x7f?token={TOKEN}"):
            with socket.create_connection(("127.0.0.1", served.server.port), PATIENCE) as client:
                client.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
                assert client.recv(100).startswith(b"HTTP/1.1 ")
        with served.connect() as websocket:
            received(websocket)
    assert TOKEN not in caplog.text + "".join(capfd.readouterr())


@pytest.mark.parametrize(
    "token", ["with spaces & a = b", ';#%20%"?/\\+,', "ünïcödé ✓ letters", "ends in a line\n", "a" * 300]
)
def test_any_token_logs_in_by_the_address_that_is_printed(token: str, capsys: pytest.CaptureFixture[str]) -> None:
    with serving(token) as served:
        _announce("127.0.0.1", served.server.port, token)
        address = capsys.readouterr().out.rstrip("\n")
        assert address.startswith(f"http://{served.address}/?token=")
        assert address.isascii()
        answer = served.get(address.removeprefix(f"http://{served.address}"), {})
        assert answer.status == 303
        assert served.get("/", {"Cookie": answer.headers["Set-Cookie"].partition(";")[0]}).status == 200
        assert served.get("/?token=" + quote(token[1:]), {}).status == 401
        quoted = address.partition("token=")[2]
        bearers = [quoted] if "\n" in token else [quoted, token.encode().decode("latin-1")]
        assert {served.get("/", {"Authorization": f"Bearer {each}"}).status for each in bearers} == {200}
        with served.connect(Authorization=f"Bearer {quoted}") as client:
            assert received(client)["type"] == "hello"


@pytest.mark.parametrize(("token", "what"), [("fifteen letters", "too short; found 15"), ("\udcff" * 20, "not UTF-8")])
def test_tokens_that_protect_nothing_are_refused(token: str, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.environ", {TOKEN_VARIABLE: token})
    with pytest.raises(InputError, match=f"{TOKEN_VARIABLE}: {what}") as refused:
        _token()
    assert token not in str(refused.value)


def half_open(served: Served, count: int) -> list[socket.socket]:
    """Connections that begin a request and wait."""
    clients = [socket.create_connection(("127.0.0.1", served.server.port), PATIENCE) for _ in range(count)]
    for client in clients:
        with suppress(ConnectionError):
            client.sendall(b"GET / HTTP/1.1\r\nHo")
    return clients


def is_ended(client: socket.socket) -> bool:
    """Whether the server has closed a connection, or does so before the time-out."""
    try:
        return client.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionError:
        return True


def test_connections_without_a_token_keep_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MAX_WAITING", 4)
    with serving() as served, served.connect() as early, ExitStack() as stack:
        received(early)
        clients = [stack.enter_context(client) for client in half_open(served, 20)]
        assert all(map(is_ended, clients[:16]))
        assert served.get("/", BEARER).status == 200
        with served.connect() as late:
            assert received(late)["type"] == "hello"
        early.send(text({"type": "ping", "time": 0}))
        assert received(early)["type"] == "pong"


def test_few_connections_wait_where_few_files_can_be_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resource.getrlimit", lambda _: (64, 4096))
    assert server.Waiting()._most == 64 // server.FILES_A_WAITING


def test_connections_without_a_token_end_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "HEADER_SECONDS", 0.1)
    with serving() as served, served.connect() as known, ExitStack() as stack:
        received(known)
        address = "127.0.0.1", served.server.port
        idle = stack.enter_context(socket.create_connection(address, PATIENCE))
        body = stack.enter_context(socket.create_connection(address, PATIENCE))
        body.sendall(f"POST / HTTP/1.1\r\nHost: {served.address}\r\nContent-Length: 9999\r\n\r\n".encode())
        assert body.recv(12) == b"HTTP/1.1 401"
        while body.recv(4096):
            pass
        assert is_ended(idle)
        assert all(is_ended(stack.enter_context(client)) for client in half_open(served, 3))
        known.send(text({"type": "ping", "time": 0}))
        assert received(known)["type"] == "pong"


@pytest.mark.parametrize(
    "refused", [{}, {"Authorization": "Bearer wrong"}, {**BEARER, "Origin": "http://evil.example"}]
)
def test_a_refused_websocket_leaves_no_trace(
    refused: dict[str, str], capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with serving() as served:
        for _ in range(3):
            with pytest.raises(InvalidStatus), served.connect(**(refused or {"X": "y"})):
                pass
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


def test_clients_that_leave_in_the_midst_leave_no_trace(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with serving() as served:
        served.session.rgba = np.random.default_rng(1).random((300, 400, 4), np.float32)
        for number in range(1, 20):
            with silent(served) as client:
                for _ in range(20):
                    served.session.clients[number].send({"type": "text", "text": "x" * 20_000})
                served.session.show(1, still=True)
                served.session.show(2, still=True)
                # Closed with what was not read, the system answers the server's next message by a reset.
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            until(lambda: not served.session.clients)
        assert served.get("/", BEARER).status == 200
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


def test_two_tasks_may_find_that_a_client_has_left() -> None:
    """One finds it while it sends; then the library refuses the other's message as a fault of the program."""

    class Leaving:
        """Websocket whose client leaves while a message and a picture are on their way."""

        has_left = asyncio.Event()

        async def receive(self) -> None:
            await asyncio.Event().wait()

        async def send(self, message: dict[str, Any]) -> None:
            if "text" in message:
                await self.has_left.wait()
                raise WebSocketDisconnect
            self.has_left.set()
            await asyncio.sleep(0)
            raise RuntimeError('Cannot call "send" once a close message has been sent.')

    class Showing(Session):
        def join(self, client: Connection) -> int:
            number = super().join(client)
            self.show(1)
            return number

    async def serve() -> None:
        session = Showing()
        await Connection(cast(WebSocket, Leaving()), encoders).serve(session)
        assert not session.clients

    with ThreadPoolExecutor(1) as encoders:
        asyncio.run(serve())


@pytest.mark.parametrize("port", ["taken", -1, 70_000])
def test_unusable_ports_and_hosts_are_refused(port: Any) -> None:
    with pytest.raises(InputError, match=r"192\.0\.2\.1:0: cannot listen"):
        open_socket("192.0.2.1", 0)
    with open_socket("127.0.0.1", 0) as taken:
        number = taken.getsockname()[1] if port == "taken" else port
        with pytest.raises(InputError, match=rf"127\.0\.0\.1:{number}: cannot listen: .*; allowed a free --port"):
            open_socket("127.0.0.1", number)
