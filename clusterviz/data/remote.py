"""Ranges of bytes of files: on disk, at http and https URLs, and at what fsspec knows, such as s3://.

A request that fails by the network or the server is repeated, after waits that double. An answer has limits of its
bytes and of its time, and a least rate, so that no server makes a rank wait or grow without end. What was read from a
URL is kept in memory, up to a limit; ranks share nothing. A `Version` tells whether a file is still the one that was
read before.
"""

from __future__ import annotations

import os
import re
import socket
import time
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from threading import Lock, Timer
from typing import Any
from urllib.parse import unquote, urljoin, urlsplit

from clusterviz.data.files import library, readable
from clusterviz.errors import DataError, public_address

ATTEMPTS = 5
FIRST_WAIT_SECONDS = 0.25
LONGEST_WAIT_SECONDS = 10.0
TIMEOUT_SECONDS = 20.0
"""Without an answer, between two parts of one, and until its headers are complete."""
TRANSFER_SECONDS = 3600.0
"""Of an answer, at most."""
LEAST_RATE = 4096
"""Bytes a second of an answer that takes longer than `TIMEOUT_SECONDS`."""
PIECE_BYTES, DRAINED_BYTES = 1 << 20, 1 << 16
"""Of an answer: read at a time, and read to keep the connection though the answer is not needed."""
REDIRECTIONS = 5
CACHE_BYTES = 128 << 20
WHOLE_FILE_BYTES = 64 << 20
"""Largest file that is read as a whole, unless its reader says otherwise."""
CONNECTIONS = 16
_URL = re.compile(r"[a-z][a-z0-9+.-]+://", re.IGNORECASE)
_CONTENT_RANGE = re.compile(r"bytes (?:(\d+)-\d+|\*)/(\d+|\*)")
_REPEATED = {408, 425, 429, 500, 502, 503, 504}
_PACKAGES = {"s3": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "az": "adlfs", "abfs": "adlfs"}


@dataclass(frozen=True)
class RemotePath:
    """File or folder at a URL, with the part of `pathlib.Path` that stores use.

    Attributes
    ----------
    url : without query
    query : "?…" of the URL, which each of its files gets; or empty
    """

    url: str
    query: str = ""

    def __truediv__(self, name: str) -> RemotePath:
        return replace(self, url="/".join([self.url.rstrip("/"), *filter(None, name.split("/"))]))

    def __str__(self) -> str:
        """Return the URL without what may be secret, see `public_address`."""
        return public_address(self.url)

    def joinpath(self, *names: str) -> RemotePath:
        return self / "/".join(names)

    @property
    def name(self) -> str:
        return self.url.rstrip("/").rpartition("/")[2]

    @property
    def parent(self) -> RemotePath:
        return replace(self, url=self.url.rstrip("/").rpartition("/")[0])


FilePath = Path | RemotePath


@dataclass(frozen=True)
class Version:
    """State of a file; another one means that it was changed.

    Attributes
    ----------
    tag : inode and time of a file on disk, ETag or date of one on a server; empty if it sends none
    """

    size: int
    tag: str


def is_url(text: str) -> bool:
    return _URL.match(text) is not None


def remote_path(text: str) -> RemotePath:
    url, mark, query = text.partition("?")
    return RemotePath(url.rstrip("/"), mark + query)


def read_range(
    path: FilePath, begin: int = 0, count: int | None = None, version: Version | None = None, most: int | None = None
) -> tuple[bytes, Version]:
    """Read bytes of a file.

    Parameters
    ----------
    begin : of the first byte; below 0: from the end of the file
    count : bytes; None: to the end of the file. Fewer are returned at its end.
    version : that the file must have
    most : bytes that may be read; by default `count`, and of a whole file `WHOLE_FILE_BYTES`
    """
    found = find_range(path, begin, count, version, most=most)
    if found is None:
        with readable(path):
            raise FileNotFoundError
    return found


def find_range(
    path: FilePath,
    begin: int = 0,
    count: int | None = None,
    version: Version | None = None,
    fresh: bool = False,
    most: int | None = None,
) -> tuple[bytes, Version] | None:
    """Read bytes of a file; None if it is missing.

    Parameters
    ----------
    fresh : ask the server again
    """
    wanted = -begin if begin < 0 else count
    limits = [limit for limit in (wanted, most) if limit is not None] or [WHOLE_FILE_BYTES]
    part = _Part(begin, count, wanted, min(limits))
    found = _cache.read(path, part, fresh) if isinstance(path, RemotePath) else _read_local(path, part)
    if found and version is not None and found[1] != version:
        raise DataError("the file was changed while it was in use", where=str(path), allowed="start again")
    return found


@dataclass(frozen=True)
class _Part:
    """Part of a file: begin and count as of `find_range`, bytes that are asked for, None: to its end, and at most."""

    begin: int
    count: int | None
    wanted: int | None
    most: int

    def check(self, size: int, where: str) -> None:
        if size > self.most:
            raise DataError("too large a file, or part of one", where=where, allowed=f"up to {self.most} bytes")


def _read_local(path: Path, part: _Part) -> tuple[bytes, Version] | None:
    begin, count = part.begin, part.count
    with readable(path):
        try:
            with path.open("rb") as file:
                status = os.fstat(file.fileno())
                begin = begin if begin >= 0 else max(0, status.st_size + begin)
                left = max(0, status.st_size - begin)
                part.check(left if count is None else min(left, count), str(path))
                file.seek(begin)
                return file.read(count), Version(status.st_size, f"{status.st_ino} {status.st_mtime_ns}")
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None


class _Cache:
    """Ranges that were read from servers, the last used ones up to `CACHE_BYTES`."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Any, tuple[bytes, Version]] = OrderedDict()
        self._bytes, self._lock = 0, Lock()

    def read(self, path: RemotePath, wanted: _Part, fresh: bool) -> tuple[bytes, Version] | None:
        begin, count = wanted.begin, wanted.count
        part, whole = (path, begin, count), (path, 0, None)
        with self._lock:
            key = part if part in self._kept else whole
            found = None if fresh else self._kept.get(key)
            if found:
                self._kept.move_to_end(key)
        if not found:
            found = _repeated(path, wanted)
            if found is None:
                return None
            key = whole if 0 <= found[1].size == len(found[0]) else part
            self._keep(key, found)
        data, version = found
        if key == whole:
            data = data[begin:][: abs(begin) if begin < 0 else count]
        return data, version

    def _keep(self, key: Any, found: tuple[bytes, Version]) -> None:
        with self._lock:
            if key in self._kept:
                self._bytes -= len(self._kept.pop(key)[0])
            if len(found[0]) <= CACHE_BYTES:
                self._kept[key] = found
                self._bytes += len(found[0])
            while self._bytes > CACHE_BYTES:
                self._bytes -= len(self._kept.popitem(last=False)[1][0])


_cache = _Cache()


class _UnavailableError(Exception):
    """Failure of the network or the server that may pass; `seconds` is how long it asks to wait."""

    def __init__(self, what: str, seconds: float = 0.0) -> None:
        super().__init__(what)
        self.seconds = seconds


def _repeated(path: RemotePath, part: _Part) -> tuple[bytes, Version] | None:
    """Read a range, or the whole file if the server sends it, again after failures that may pass."""
    fetch = _fetch_http if urlsplit(path.url).scheme.lower() in ("http", "https") else _fetch_by_fsspec
    for attempt in range(ATTEMPTS):
        try:
            return fetch(path, part)
        except _UnavailableError as error:
            if attempt == ATTEMPTS - 1:
                raise DataError(f"{error}, {ATTEMPTS} times", where=str(path)) from error
            time.sleep(min(LONGEST_WAIT_SECONDS, max(error.seconds, FIRST_WAIT_SECONDS * 2**attempt)))
    raise AssertionError("the loop returns or raises")


def _fetch_http(path: RemotePath, part: _Part) -> tuple[bytes, Version] | None:
    urllib3, where, headers = library("urllib3", "store", str(path)), str(path), {"Accept-Encoding": "identity"}
    parts = urlsplit(path.url)
    if parts.username:
        names = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        headers |= urllib3.make_headers(basic_auth=names)
    if part.begin or part.count is not None:
        last = "" if part.count is None else str(part.begin + part.count - 1)
        headers["Range"] = f"bytes={part.begin}" if part.begin < 0 else f"bytes={part.begin}-{last}"
    try:
        answer, began = _answer(path.url + path.query, headers), time.monotonic()
        try:
            return _content(answer, where, part, began)
        finally:
            answer.close()
    except urllib3.exceptions.LocationValueError as error:
        raise DataError(f"not a URL: {error}", where=where) from error
    except urllib3.exceptions.HTTPError as error:
        raise _UnavailableError(_described(error)) from error


def _answer(address: str, headers: Mapping[str, str]) -> Any:
    """Return the answer to a request, after redirections; only its headers are read."""
    for _ in range(REDIRECTIONS + 1):
        options: dict[str, Any] = {"headers": headers, "timeout": TIMEOUT_SECONDS, "redirect": False}
        answer = _pool(_proxy(address)).request("GET", address, preload_content=False, decode_content=False, **options)
        # urllib3 would read all of an answer that redirects, however long it is.
        location = answer.get_redirect_location()
        if not location:
            return answer
        answer.close()
        there = urljoin(address, location)
        if urlsplit(there)[:2] != urlsplit(address)[:2]:  # another host does not get the password
            headers = {key: value for key, value in headers.items() if key.lower() != "authorization"}
        address = there
    raise _UnavailableError(f"more than {REDIRECTIONS} redirections")


def _content(answer: Any, where: str, part: _Part, began: float) -> tuple[bytes, Version] | None:
    """Return what a server answers to the request of a range: that, or the whole file."""
    status, sent, wanted = answer.status, answer.headers, part.wanted
    tag, length = sent.get("ETag") or sent.get("Last-Modified", ""), sent.get("Content-Length", "")
    if status in (404, 410):
        if length.isdecimal() and int(length) <= DRAINED_BYTES:
            _read_body(answer, DRAINED_BYTES, began)
        return None
    if status in _REPEATED:
        waited = sent.get("Retry-After", "")
        raise _UnavailableError(f"HTTP {status} {answer.reason}", float(waited) if waited.isdecimal() else 0.0)
    first, total = _CONTENT_RANGE.search(sent.get("Content-Range", "")), -1
    if first and first[2].isdecimal():
        total = int(first[2])
    if status == 416:  # begins behind the end of the file
        return b"", Version(total, tag)
    if status not in (200, 206):
        raise DataError(f"HTTP {status} {answer.reason}", where=where)
    if status == 206:
        expected = part.begin if part.begin >= 0 else max(0, total + part.begin)
        if not first or int(first[1] or -1) != expected or (wanted and length.isdecimal() and int(length) > wanted):
            raise DataError("the server sends another range", where=where, found=sent.get("Content-Range"))
    is_whole = status == 200 and wanted is not None
    most = WHOLE_FILE_BYTES if is_whole else part.most
    data = None if length.isdecimal() and int(length) > most else _read_body(answer, most, began)
    if data is None and is_whole:
        allowed = f"ranges, or files of up to {WHOLE_FILE_BYTES >> 20} MiB"
        raise DataError("the server sends no ranges of files", where=where, allowed=allowed)
    if data is None:
        raise DataError("the server sends more than there may be", where=where, allowed=f"up to {most} bytes")
    return data, Version(total if status == 206 else len(data), tag)


def _read_body(answer: Any, most: int, began: float) -> bytes | None:
    """Return the bytes of an answer; None if there are more than `most`. Slow ones are an `_UnavailableError`."""
    parts, count = list[bytes](), 0
    while piece := answer.read1(PIECE_BYTES):
        parts.append(piece)
        count += len(piece)
        if count > most:
            return None
        seconds = time.monotonic() - began
        if seconds > TIMEOUT_SECONDS and count < LEAST_RATE * seconds:
            raise _UnavailableError(f"slower than {LEAST_RATE} bytes a second")
        if seconds > TRANSFER_SECONDS:
            raise _UnavailableError(f"an answer of more than {TRANSFER_SECONDS:g} s")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _described(error: Exception) -> str:
    names = {
        "ConnectTimeoutError": f"no connection within {TIMEOUT_SECONDS:g} s",
        "ReadTimeoutError": f"no answer within {TIMEOUT_SECONDS:g} s",
        "TimeoutError": f"no answer within {TIMEOUT_SECONDS:g} s",
        "IncompleteRead": "the answer ends early",
        "ProtocolError": "the answer ends early",
        "NameResolutionError": "the host is not known",
        "SSLError": "no secure connection",
    }
    cause = getattr(error, "reason", None) or error
    kinds = [type(each).__name__ for each in (cause, error)]
    return next((names[kind] for kind in kinds if kind in names), f"no connection: {cause}")


def _proxy(address: str) -> str | None:
    from urllib.request import getproxies, proxy_bypass  # slow to import

    parts = urlsplit(address)
    return None if proxy_bypass(parts.hostname or "") else getproxies().get(parts.scheme.lower())


@cache
def _pool(proxy: str | None) -> Any:
    import urllib3  # which may be missing

    options: dict[str, Any] = {"retries": False, "maxsize": CONNECTIONS}
    pool: Any = urllib3.ProxyManager(proxy, **options) if proxy else urllib3.PoolManager(**options)
    pool.pool_classes_by_scheme = {
        scheme: type(kind.__name__, (kind,), {"ConnectionCls": _with_deadline(kind.ConnectionCls)})
        for scheme, kind in pool.pool_classes_by_scheme.items()
    }
    return pool


def _with_deadline(kind: Any) -> Any:
    """Return a class of connections on which the headers of an answer must arrive within `TIMEOUT_SECONDS`."""

    def getresponse(self: Any) -> Any:
        ended: list[bool] = []
        here = self.sock

        def end() -> None:
            ended.append(True)
            with suppress(OSError):
                socket.socket.shutdown(here, socket.SHUT_RDWR)

        timer = Timer(TIMEOUT_SECONDS, end)
        timer.daemon = True
        timer.start()
        try:
            answer = kind.getresponse(self)
        except Exception as error:
            if ended:
                raise TimeoutError from error
            raise
        finally:
            timer.cancel()
        if ended:  # headers that were cut off pass for whole ones
            raise TimeoutError
        return answer

    return type(kind.__name__, (kind,), {"getresponse": getresponse})


def _fetch_by_fsspec(path: RemotePath, part: _Part) -> tuple[bytes, Version] | None:
    begin, count = part.begin, part.count
    fsspec, scheme = library("fsspec", "store", str(path)), urlsplit(path.url).scheme.lower()
    try:
        files = fsspec.filesystem(scheme)
    except (ImportError, ValueError) as error:
        package = _PACKAGES.get(scheme)
        allowed = f"pip install {package}" if package else "http, https, s3, gs, and other file systems of fsspec"
        raise DataError(f"URLs of {scheme} cannot be read: {error}", where=str(path), allowed=allowed) from error
    try:
        status = files.info(path.url)
        if status.get("type") == "directory":
            return None
        size = int(status["size"])
        first = begin if begin >= 0 else max(0, size + begin)
        last = size if count is None else min(size, first + count)
        part.check(last - first, str(path))
        data = files.cat_file(path.url, first, last) if last > first else b""
        tag = next(
            (str(status[key]) for key in ("ETag", "etag", "mtime", "LastModified", "created") if key in status), ""
        )
        return data, Version(size, tag)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None
    except PermissionError as error:
        raise DataError(f"not allowed: {error}", where=str(path)) from error
    except (OSError, TimeoutError) as error:
        raise _UnavailableError(str(error) or type(error).__name__) from error
