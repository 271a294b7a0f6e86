"""HTTP and websocket server of the viewer: one port for the page, its files and its messages.

It runs in a thread with an event loop of its own. Requests need the session's token: `/?token=…` sets it as a cookie,
programs send `Authorization: Bearer …`, where it may be quoted as in the URL. A connection that has not shown it is
closed after `HEADER_SECONDS`, or where there are too many, the oldest first. If the socket is bound to the loopback
interface, `Host` must name that, so no foreign name that resolves to it is served (DNS rebinding). The `Origin` of a
websocket must be the server's own.
"""

from __future__ import annotations

import asyncio
import os
import resource
import socket
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from hmac import compare_digest
from ipaddress import ip_address
from pathlib import Path
from threading import Thread
from typing import Any, cast
from urllib.parse import quote, unquote_to_bytes, urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from clusterviz.errors import InputError
from clusterviz.viewer.connection import CLOSE_SECONDS, Connection
from clusterviz.viewer.messages import MAX_TEXT_BYTES
from clusterviz.viewer.session import Session

STATIC = Path(__file__).parent / "static"
MEDIA_TYPES = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".png": "image/png",
}
LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
MAX_CLIENTS = 64
HEADER_SECONDS = 10.0
"""Time for a connection to send a request with the token."""
MAX_WAITING, FILES_A_WAITING = 64, 8
"""Connections that have not shown the token, at most: this number, or a share of the files that may be open."""
BACKLOG = 64
"""Connections that are accepted at a time, and that the system keeps until then."""
MAX_PORT = 65535
TRY_LATER = 1013
REFUSED = 400
"""First status of requests that are not followed."""


def open_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens; port 0 takes a free port.

    Raises InputError: the port is in use or not allowed, or the host is not of this machine.
    """
    try:
        if not 0 <= port <= MAX_PORT:  # the system's functions take it modulo 65536
            raise OverflowError("no such port")
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family, backlog=128)
    except (OSError, OverflowError) as error:
        number = getattr(error, "errno", None)
        reason = (os.strerror(number) if number and number > 0 else str(error)).lower()
        allowed = "a free --port (0 takes any), a --host of this machine"
        raise InputError(f"cannot listen: {reason}", where=f"{host}:{port}", allowed=allowed) from error


class Server:
    """Server of one session in a thread of its own.

    `token`: secret that requests must know. `origins`: further origins of pages, such as https://hub.example, for
    proxies that change `Host`.
    """

    def __init__(self, session: Session, listening: socket.socket, token: str, *, origins: Sequence[str] = ()) -> None:
        self._session, self._socket = session, listening
        self.host, self.port = listening.getsockname()[:2]
        self._connections: set[Connection] = set()
        self._encoders = ThreadPoolExecutor(4, "encoder")
        routes = [Route("/", _page), Route("/static/{name}", _static), WebSocketRoute("/ws", self._serve_client)]
        config = uvicorn.Config(
            Guard(Starlette(routes=routes), token, self.host, self.port, origins),
            loop="asyncio",
            http=_HttpProtocol,
            backlog=BACKLOG,
            ws=_WebSocketProtocol,
            ws_max_size=MAX_TEXT_BYTES,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            log_level="error",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._run, name="server", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Send what is queued, end all connections and the thread."""
        if self._thread.is_alive():
            with suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(lambda: self._loop.create_task(self._finish()))
            self._thread.join(2 * CLOSE_SECONDS + 2)
        self._socket.close()
        self._encoders.shutdown(wait=False, cancel_futures=True)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.set_exception_handler(_report)
        try:
            self._loop.run_until_complete(self._server.serve(sockets=[self._socket]))
        finally:
            self._loop.close()

    async def _finish(self) -> None:
        ends = [asyncio.create_task(connection.finish()) for connection in self._connections]
        if ends:
            await asyncio.wait(ends, timeout=CLOSE_SECONDS)
        self._server.should_exit = True

    async def _serve_client(self, websocket: WebSocket) -> None:
        await websocket.accept()
        if len(self._connections) >= MAX_CLIENTS:
            await websocket.close(TRY_LATER, "too many clients")
            return
        connection = Connection(websocket, self._encoders)
        self._connections.add(connection)
        try:
            await connection.serve(self._session)
        finally:
            self._connections.discard(connection)


class Waiting:
    """Connections that have not shown the token: each is closed in time, and the oldest if there are too many."""

    def __init__(self) -> None:
        self._timers: dict[asyncio.Transport, asyncio.TimerHandle] = {}
        self._most = max(1, min(MAX_WAITING, resource.getrlimit(resource.RLIMIT_NOFILE)[0] // FILES_A_WAITING))

    def add(self, transport: asyncio.Transport) -> None:
        """Add a new connection."""
        self._timers[transport] = asyncio.get_running_loop().call_later(HEADER_SECONDS, self._close, transport)
        if len(self._timers) > self._most:
            self._close(next(iter(self._timers)))

    def discard(self, transport: asyncio.Transport) -> None:
        """Remove a connection that has shown the token, or has ended."""
        if timer := self._timers.pop(transport, None):
            timer.cancel()

    def _close(self, transport: asyncio.Transport) -> None:
        self.discard(transport)
        transport.abort()


class Guard:
    """ASGI middleware that serves only those who know the token, under an own name and to pages of an own origin.

    `waiting`: connections that have not shown the token.
    """

    def __init__(self, app: ASGIApp, token: str, host: str, port: int, origins: Sequence[str]) -> None:
        self._app, self._token, self._origins = app, token.encode(), frozenset(each.rstrip("/") for each in origins)
        self._cookie = f"clusterviz-{port}"
        names = LOOPBACK_NAMES | {host} | {urlsplit(each).hostname for each in origins}
        self._names = names if ip_address(host).is_loopback else None
        self.waiting = Waiting()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        answer = self._answer(HTTPConnection(scope))
        if answer is None or answer.status_code < REFUSED:
            self.waiting.discard(scope["state"]["transport"])
        if scope["type"] == "websocket":
            with suppress(WebSocketDisconnect):  # the client did not wait for the answer
                websocket = WebSocket(scope, receive, send)
                await (websocket.send_denial_response(answer) if answer else self._app(scope, receive, send))
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await (answer or self._app)(scope, receive, send_with_headers)

    def _answer(self, request: HTTPConnection) -> Response | None:
        """Return the answer to a request that is refused, or that sets the cookie."""
        headers, is_websocket = request.headers, request.scope["type"] == "websocket"
        host, origin = headers.get("host", ""), headers.get("origin")
        if self._names is not None and _hostname(host) not in self._names:
            return PlainTextResponse("421: this is not a name of the server; pages of a proxy need --origin\n", 421)
        if not is_websocket and request.scope["path"] == "/" and "token" in request.query_params:
            return self._login(request) if self._is_token(request.query_params["token"]) else _unauthorized()
        has_bearer = self._is_token(headers.get("authorization", "").removeprefix("Bearer "))
        if not has_bearer and not any(self._is_token(value) for value in self._cookies(headers.get("cookie", ""))):
            return _unauthorized()
        is_own = bool(host) and origin in (f"http://{host}", f"https://{host}")
        if is_websocket and not is_own and origin not in self._origins and (origin or not has_bearer):
            return PlainTextResponse("403: a page of another origin; those of a proxy need --origin\n", 403)
        return None

    def _login(self, request: HTTPConnection) -> Response:
        """Return a redirection to the page without the token, which sets the cookie."""
        # A browser sends a strict cookie along with a redirection only if no other site led it here.
        is_foreign = request.headers.get("sec-fetch-site") == "cross-site"
        response = Response(headers={"Refresh": "0; url=./"}) if is_foreign else RedirectResponse("./", 303)
        response.set_cookie(self._cookie, quote(self._token, safe=""), path=None, httponly=True, samesite="strict")
        return response

    def _cookies(self, header: str) -> list[str]:
        pairs = (part.strip().partition("=") for part in header.split(";"))
        return [value for name, _, value in pairs if name == self._cookie]

    def _is_token(self, text: str) -> bool:
        """Return whether a text of a header, or of the query, is the token, as it is or quoted as in a URL."""
        given = text.encode("latin-1", "replace"), text.encode(), unquote_to_bytes(text)
        return any(compare_digest(each, self._token) for each in given)


class _HttpProtocol(H11Protocol):
    """Protocol whose connections wait until the guard has seen the token."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.app_state = {**self.app_state, "transport": transport}
        cast(Guard, self.app).waiting.add(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        cast(Guard, self.app).waiting.discard(self.transport)
        super().connection_lost(exc)


class _WebSocketProtocol(WebSocketsSansIOProtocol):
    """Protocol of clients; the application has its transport, and ends those that do not read."""

    def connection_lost(self, exc: Exception | None) -> None:
        cast(Guard, self.app).waiting.discard(self.transport)
        super().connection_lost(exc)

    async def send(self, message: Any) -> None:
        if self.transport.is_closing():  # the client has left, which the protocol is told later
            raise ClientDisconnected
        await super().send(message)
        if message["type"] == "websocket.http.response.body":
            self.handshake_complete = True  # it was refused; else that counts as a fault of the application

    def keepalive_timeout(self) -> None:
        # Closing in order would wait for the client to read what is buffered.
        self.transport.abort()


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report a fault in a callback of the loop, but not those of connections, which their clients make."""
    if not isinstance(context.get("exception"), OSError):
        loop.default_exception_handler(context)


def _hostname(host: str) -> str | None:
    """Return the name in a `Host` header, without port and brackets; None if there is none."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _unauthorized() -> Response:
    text = "401: open the address that `clusterviz view` printed, with its token\n"
    return PlainTextResponse(text, 401, {"Connection": "close"})


async def _page(request: Request) -> Response:
    return _file("index.html")


async def _static(request: Request) -> Response:
    return _file(request.path_params["name"])


def _file(name: str) -> Response:
    """Return a file of the page; only names in the folder are known, so no path leads out of it."""
    path = {path.name: path for path in STATIC.glob("*") if path.suffix in MEDIA_TYPES}.get(name)
    if path is None:
        return PlainTextResponse("404: no such file\n", 404)
    return Response(path.read_bytes(), media_type=MEDIA_TYPES[path.suffix])
