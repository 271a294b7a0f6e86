"""Ranges of bytes of files: on disk, at http and https URLs, and at what fsspec knows, such as s3://.

A request that fails by the network or the server is repeated, after waits that double. What was read from a URL is kept
in memory, up to a limit; ranks share nothing. A `Version` tells whether a file is still the one that was read before.
"""

from __future__ import annotations

import os
import re
import time
from collections import OrderedDict
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import unquote, urlsplit

from clusterviz.data.files import readable
from clusterviz.errors import DataError, installation, public_address

ATTEMPTS = 5
FIRST_WAIT_SECONDS = 0.25
LONGEST_WAIT_SECONDS = 10.0
TIMEOUT_SECONDS = 20.0
"""Without an answer, or between two parts of one."""
CACHE_BYTES = 128 << 20
WHOLE_FILE_BYTES = 64 << 20
"""Largest file that is read as a whole from a server that does not send ranges."""
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
        """Return the path of a file below this one."""
        return self / "/".join(names)

    @property
    def name(self) -> str:
        """Last part of the path."""
        return self.url.rstrip("/").rpartition("/")[2]

    @property
    def parent(self) -> RemotePath:
        """Folder that holds it."""
        return replace(self, url=self.url.rstrip("/").rpartition("/")[0])


FilePath = Path | RemotePath


@dataclass(frozen=True)
class Version:
    """State of a file; another one means that it was changed.

    Attributes
    ----------
    size : bytes
    tag : inode and time of a file on disk, ETag or date of one on a server; empty if it sends none
    """

    size: int
    tag: str


def is_url(text: str) -> bool:
    """Return whether the path of data is a URL."""
    return _URL.match(text) is not None


def remote_path(text: str) -> RemotePath:
    """Return the path of a URL."""
    url, mark, query = text.partition("?")
    return RemotePath(url.rstrip("/"), mark + query)


def read_range(
    path: FilePath, begin: int = 0, count: int | None = None, version: Version | None = None
) -> tuple[bytes, Version]:
    """Read bytes of a file.

    Parameters
    ----------
    begin : of the first byte; below 0: from the end of the file
    count : bytes; None: to the end of the file. Fewer are returned at its end.
    version : that the file must have

    Raises
    ------
    DataError
        Missing, unreadable, not of the version, or the server does not send it.
    """
    found = find_range(path, begin, count, version)
    if found is None:
        with readable(path):
            raise FileNotFoundError
    return found


def find_range(
    path: FilePath, begin: int = 0, count: int | None = None, version: Version | None = None, fresh: bool = False
) -> tuple[bytes, Version] | None:
    """Read bytes of a file; None if it is missing.

    Parameters
    ----------
    fresh : ask the server again

    Raises
    ------
    DataError
        As of `read_range`.
    """
    found = _cache.read(path, begin, count, fresh) if isinstance(path, RemotePath) else _read_local(path, begin, count)
    if found and version is not None and found[1] != version:
        raise DataError("the file was changed while it was in use", where=str(path), allowed="start again")
    return found


def _read_local(path: Path, begin: int, count: int | None) -> tuple[bytes, Version] | None:
    with readable(path):
        try:
            with path.open("rb") as file:
                status = os.fstat(file.fileno())
                file.seek(begin if begin >= 0 else max(0, status.st_size + begin))
                return file.read(count), Version(status.st_size, f"{status.st_ino} {status.st_mtime_ns}")
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None


class _Cache:
    """Ranges that were read from servers, the last used ones up to `CACHE_BYTES`."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Any, tuple[bytes, Version]] = OrderedDict()
        self._bytes, self._lock = 0, Lock()

    def read(self, path: RemotePath, begin: int, count: int | None, fresh: bool) -> tuple[bytes, Version] | None:
        part, whole = (path, begin, count), (path, 0, None)
        with self._lock:
            key = part if part in self._kept else whole
            found = None if fresh else self._kept.get(key)
            if found:
                self._kept.move_to_end(key)
        if not found:
            found = _repeated(path, begin, count)
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


def _repeated(path: RemotePath, begin: int, count: int | None) -> tuple[bytes, Version] | None:
    """Read a range, or the whole file if the server sends it, again after failures that may pass."""
    fetch = _fetch_http if urlsplit(path.url).scheme.lower() in ("http", "https") else _fetch_by_fsspec
    for attempt in range(ATTEMPTS):
        try:
            return fetch(path, begin, count)
        except _UnavailableError as error:
            if attempt == ATTEMPTS - 1:
                raise DataError(f"{error}, {ATTEMPTS} times", where=str(path)) from error
            time.sleep(min(LONGEST_WAIT_SECONDS, max(error.seconds, FIRST_WAIT_SECONDS * 2**attempt)))
    raise AssertionError("the loop returns or raises")


def _fetch_http(path: RemotePath, begin: int, count: int | None) -> tuple[bytes, Version] | None:
    """Read a range by one request."""
    urllib3, where, headers = _require("urllib3", path), str(path), {"Accept-Encoding": "identity"}
    parts = urlsplit(path.url)
    if parts.username:
        names = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        headers |= urllib3.make_headers(basic_auth=names)
    if begin or count is not None:
        last = "" if count is None else str(begin + count - 1)
        headers["Range"] = f"bytes={begin}" if begin < 0 else f"bytes={begin}-{last}"
    try:
        address = path.url + path.query
        answer = _pool(_proxy(address)).request(
            "GET", address, headers=headers, preload_content=False, decode_content=False, timeout=TIMEOUT_SECONDS
        )
        try:
            return _content(answer, where, begin, count)
        finally:
            answer.close()
    except urllib3.exceptions.LocationValueError as error:
        raise DataError(f"not a URL: {error}", where=where) from error
    except urllib3.exceptions.HTTPError as error:
        raise _UnavailableError(_described(error)) from error


def _content(answer: Any, where: str, begin: int, count: int | None) -> tuple[bytes, Version] | None:
    """Return what a server answers to the request of a range: that, or the whole file."""
    status, sent = answer.status, answer.headers
    tag, length = sent.get("ETag") or sent.get("Last-Modified", ""), sent.get("Content-Length", "")
    if status in (404, 410):
        answer.drain_conn()
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
    wanted = abs(begin) if begin < 0 else count
    if status == 206:
        expected = begin if begin >= 0 else max(0, total + begin)
        if not first or int(first[1] or -1) != expected or (wanted and length.isdecimal() and int(length) > wanted):
            raise DataError("the server sends another range", where=where, found=sent.get("Content-Range"))
        return answer.read(), Version(total, tag)
    if wanted is not None and not (length.isdecimal() and int(length) <= WHOLE_FILE_BYTES):
        allowed = f"ranges, or files of up to {WHOLE_FILE_BYTES >> 20} MiB"
        raise DataError("the server sends no ranges of files", where=where, allowed=allowed)
    data = answer.read()
    return data, Version(len(data), tag)


def _described(error: Exception) -> str:
    """Return a failure of a request in a few words."""
    names = {
        "ConnectTimeoutError": f"no connection within {TIMEOUT_SECONDS:g} s",
        "ReadTimeoutError": f"no answer within {TIMEOUT_SECONDS:g} s",
        "IncompleteRead": "the answer ends early",
        "ProtocolError": "the answer ends early",
        "NameResolutionError": "the host is not known",
        "SSLError": "no secure connection",
    }
    cause = getattr(error, "reason", None) or error
    kinds = [type(each).__name__ for each in (cause, error)]
    return next((names[kind] for kind in kinds if kind in names), f"no connection: {cause}")


def _proxy(address: str) -> str | None:
    """Return the proxy of a URL by the environment."""
    from urllib.request import getproxies, proxy_bypass  # slow to import

    parts = urlsplit(address)
    return None if proxy_bypass(parts.hostname or "") else getproxies().get(parts.scheme.lower())


@cache
def _pool(proxy: str | None) -> Any:
    """Return connections that are kept open."""
    import urllib3

    repeats = urllib3.Retry(total=5, connect=0, read=0, status=0, other=0, redirect=5)
    options: dict[str, Any] = {"retries": repeats, "maxsize": CONNECTIONS}
    return urllib3.ProxyManager(proxy, **options) if proxy else urllib3.PoolManager(**options)


def _fetch_by_fsspec(path: RemotePath, begin: int, count: int | None) -> tuple[bytes, Version] | None:
    fsspec, scheme = _require("fsspec", path), urlsplit(path.url).scheme.lower()
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


def _require(package: str, path: RemotePath) -> Any:
    if find_spec(package) is None:
        raise DataError(f"needs the {package} package", where=str(path), allowed=installation("store"))
    return __import__(package)
