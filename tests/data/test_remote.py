"""Stores at URLs: ranges, repeated requests, time-outs, the cache, and what servers do wrong."""

from __future__ import annotations

import base64
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import fsspec
import numpy as np
import pytest
import zarr
from data.checks import check_source, refused

from clusterviz.cli import run
from clusterviz.cli.termination import RANK_VARIABLES
from clusterviz.content.description import name_of
from clusterviz.data import open_scene, open_source, remote
from clusterviz.data.memory import ArraySource
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import write_store
from clusterviz.errors import ClustervizError, DataError, without_secrets
from clusterviz.image.files import RECORD_KEY, read_text
from clusterviz.scene import dump_scene
from clusterviz.viewer.saving import scene_file

FIELD = np.random.default_rng(1).integers(0, 255, (20, 21, 22), np.uint8)
OWN, OTHER = "own.ome.zarr", "other.ome.zarr"
SHARD, CHUNK = f"{OWN}/0/c/0/0/0", f"{OTHER}/0/c/0/0/0"


ENDLESS = {
    "endless": (b"HTTP/1.1 200 OK\r\n\r\n", bytes(1 << 16), 0.0),
    "chunks": (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", b"2000\r\n" + bytes(0x2000) + b"\r\n", 0.0),
    "part": (b"HTTP/1.1 206 Partial\r\nContent-Range: bytes 0-99/*\r\n\r\n", bytes(1 << 16), 0.0),
    "bytewise": (b"HTTP/1.1 200 OK\r\nContent-Length: 900\r\n\r\n", b" ", 0.02),
    "headers": (b"HTTP/1.1 200 OK\r\n", b"a: b\r\n", 0.02),
    "around": (b"HTTP/1.1 302 Found\r\nLocation: /\r\n\r\n", bytes(1 << 16), 0.0),
    "lost": (b"HTTP/1.1 404 None\r\n\r\n", bytes(1 << 16), 0.0),
}
"""Answers without end: how they begin, what goes on, and the seconds between."""


@dataclass
class Site:
    """Files of a folder, with faults by the path that they concern; a fault that is a list happens once each."""

    folder: Path
    url: str = ""
    faults: dict[str, Any] = field(default_factory=dict)
    requests: list[tuple[str, str]] = field(default_factory=list)
    tag: str = '"1"'
    users: set[str] = field(default_factory=set)

    def fault_of(self, name: str) -> str:
        """What goes wrong with this request."""
        found = self.faults.get(name, "")
        if isinstance(found, list):
            return found.pop(0) if found else ""
        return str(found)


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    site: Site

    def do_GET(self) -> None:
        site, (name, _, query) = self.site, self.path[1:].partition("?")
        wanted, fault = self.headers.get("Range", ""), site.fault_of(name)
        site.users.add(self.headers.get("Authorization", ""))
        site.requests.append((name + (f"?{query}" if query else ""), wanted))
        if fault.isdecimal() or not (site.folder / name).is_file():
            return self.answer(int(fault) if fault else 404, b"no", {})
        if fault in ENDLESS:
            return self.trickle(*ENDLESS[fault])
        data, total = (site.folder / name).read_bytes(), (site.folder / name).stat().st_size
        if fault == "slow":
            time.sleep(0.4)
        status, headers = 200, {"ETag": site.tag}
        if wanted and fault != "whole":
            first, last = re.fullmatch(r"bytes=(\d*)-(\d*)", wanted).groups()  # type: ignore[union-attr]
            begin = int(first) if first else max(0, total - int(last))
            end = min(total, int(last) + 1) if first and last else total
            begin += fault == "shifted"
            status, data = 206, data[begin:end]
            headers["Content-Range"] = f"bytes {begin}-{end - 1}/{total}"
            if begin >= total:
                status, headers["Content-Range"] = 416, f"bytes */{total}"
        return self.answer(status, data, headers, len(data) // 2 if fault == "cut" else 0)

    def answer(self, status: int, data: bytes, headers: dict[str, str], missing: int = 0) -> None:
        self.send_response(status)
        for key, value in {**headers, "Content-Length": str(len(data))}.items():
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(data[: len(data) - missing])
        self.close_connection = missing > 0

    def trickle(self, start: bytes, again: bytes, seconds: float) -> None:
        """Send the start of an answer, then the same bytes again and again, until the client leaves."""
        self.close_connection = True
        self.wfile.write(start)
        for _ in range(4000):
            self.wfile.write(again)
            self.wfile.flush()
            time.sleep(seconds)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    write_store(ArraySource(FIELD), folder / OWN, BrickCodec(), 16)
    group = zarr.create_group(str(folder / OTHER))
    group.create_array("0", data=FIELD, chunks=(8, 8, 8), shards=(24, 24, 24))
    axes = [{"name": name, "type": "space"} for name in "zyx"]
    datasets = [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1, 1, 1]}]}]
    group.attrs["ome"] = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": datasets}]}
    return folder


@pytest.fixture
def site(written: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    """A server of both stores; waits are short, and nothing is cached yet."""
    monkeypatch.setattr(remote, "FIRST_WAIT_SECONDS", 0.0)
    monkeypatch.setattr(remote, "_cache", remote._Cache())
    found = Site(written)
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("OfSite", (Handler,), {"site": found}))
    found.url = f"http://127.0.0.1:{server.server_address[1]}"
    server.handle_error = lambda *_: None  # type: ignore[method-assign]  # clients that gave up
    thread = Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    yield found
    server.shutdown()
    server.server_close()
    thread.join()


def read_all(url: str) -> None:
    source = open_source(url)
    source.read((0, 0, 0), source.grid.shape_zyx)


@pytest.mark.parametrize("name", [OWN, OTHER])
def test_store_is_read_by_ranges(name: str, site: Site) -> None:
    source = open_source(f"{site.url}/{name}")
    source.read((0, 0, 0), (3, 3, 3))
    path, shard = f"{name}/0/c/0/0/0", site.folder / name / "0/c/0/0/0"
    ranges = [re.split("[=-]", wanted)[1:] for path_, wanted in site.requests if path_ == path]
    first, *others = ranges
    assert first[0] == ""  # the index at the end
    assert others
    assert sum(int(end) - int(begin) + 1 for begin, end in others) < shard.stat().st_size / 2
    check_source(source, FIELD, 9)
    count = len(site.requests)
    check_source(open_source(f"{site.url}/{name}"), FIELD, 9)
    assert {path for path, _ in site.requests[count:]} <= {f"{OWN}/zarr.json"}  # asked again: was the store changed?


@pytest.mark.cover
@pytest.mark.parametrize("fault", [["500"], ["503", "429", "502", "408"], ["cut"], ["slow"], "whole"])
def test_failures_that_pass(fault: Any, site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "TIMEOUT_SECONDS", 0.2)
    for name, path in ((OWN, SHARD), (OTHER, CHUNK), (OTHER, f"{OTHER}/zarr.json")):
        site.faults[path] = list(fault) if isinstance(fault, list) else fault
        np.testing.assert_array_equal(open_source(f"{site.url}/{name}").read((0, 0, 0), FIELD.shape), FIELD)


META, LEVEL = f"{OTHER}/zarr.json", f"{OTHER}/0/zarr.json"
STAYING = [
    (SHARD, "404", "own.ome.zarr/0/c/0/0/0: no such file"),
    (SHARD, "500", "0/c/0/0/0: HTTP 500 .*, 2 times"),
    (SHARD, "403", "HTTP 403 Forbidden"),
    (SHARD, "cut", "the answer ends early, 2 times"),
    (SHARD, "shifted", "another range"),
    (SHARD, "slow", "no answer within 0.2 s, 2 times"),
    (CHUNK, "500", "0/c/0/0/0: HTTP 500 .*, 2 times"),
    (CHUNK, "403", "HTTP 403 Forbidden"),
    (CHUNK, "cut", "the answer ends early, 2 times"),
    (f"{OWN}/zarr.json", "404", "not a store of Zarr"),
    (META, "401", "HTTP 401 Unauthorized"),
    (LEVEL, "404", "no such array"),
    # answers without end
    (META, "endless", "more than there may be; allowed up to 100000 bytes"),
    (META, "chunks", "more than there may be; allowed up to 100000 bytes"),
    (META, "bytewise", "slower than 4096 bytes a second, 2 times"),
    (META, "headers", "no answer within 0.2 s, 2 times"),
    (META, "around", "not a store of Zarr"),
    (LEVEL, "lost", "no such array"),
    (CHUNK, "endless", "more than there may be; allowed up to 79850 bytes"),
    (SHARD, "endless", "the server sends no ranges"),
    (SHARD, "part", "more than there may be; allowed up to 132 bytes"),
]


@pytest.mark.cover
@pytest.mark.parametrize(("path", "fault", "text"), STAYING)
def test_failures_that_stay(path: str, fault: str, text: str, site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    endless = fault in ENDLESS or fault == "slow"
    for name, value in {"TIMEOUT_SECONDS": 0.2 if endless else 5.0, "WHOLE_FILE_BYTES": 100_000, "ATTEMPTS": 2}.items():
        monkeypatch.setattr(remote, name, value)
    site.faults[path] = fault
    refused(lambda: read_all(f"{site.url}/{path.partition('/')[0]}"), site.url, text)


def test_server_without_ranges_sends_whole_files_once(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    site.faults[SHARD] = "whole"
    read_all(f"{site.url}/{OWN}")
    assert [path for path, _ in site.requests].count(SHARD) == 1
    monkeypatch.setattr(remote, "_cache", remote._Cache())
    monkeypatch.setattr(remote, "WHOLE_FILE_BYTES", 4000)
    refused(lambda: read_all(f"{site.url}/{OWN}"), "sends no ranges")


@pytest.mark.parametrize("name", [OWN, OTHER])
def test_file_that_changes_on_the_server(name: str, site: Site) -> None:
    source = open_source(f"{site.url}/{name}")
    source.read((0, 0, 0), (1, 1, 1))
    site.tag = '"2"'
    refused(lambda: source.read((0, 0, 0), FIELD.shape), site.url, "changed while it was in use")


def test_cache_has_a_limit(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "CACHE_BYTES", 3000)
    for name in (OWN, OTHER):
        np.testing.assert_array_equal(open_source(f"{site.url}/{name}").read((0, 0, 0), FIELD.shape), FIELD)
        kept = remote._cache._kept.values()
        assert 0 < sum(len(data) for data, _ in kept) == remote._cache._bytes <= 3000


def test_secrets_of_urls_are_sent_and_not_told(site: Site) -> None:
    url = site.url.replace("//", "//me:sec%20ret@")
    source = open_source(f"{url}/{OTHER}?token=hidden")
    assert source.name == f"{site.url}/{OTHER}"
    source.read((0, 0, 0), (1, 1, 1))
    assert all(path.endswith("?token=hidden") for path, _ in site.requests)
    assert site.users == {f"Basic {base64.b64encode(b'me:sec ret').decode()}"}
    site.faults[f"{OWN}/zarr.json"] = "403"
    refused(lambda: open_source(f"{url}/{OWN}?token=hidden"), "^(?!.*(sec|hidden)).*HTTP 403")


@pytest.mark.parametrize(
    ("text", "public"),
    [
        ("http://me:SECRET@host:80/a@1/b.zarr?sig=SECRET&x=1", "http://host:80/a@1/b.zarr"),
        ("s3://bucket/a.zarr", "s3://bucket/a.zarr"),
        ("https://SECRET@host?SECRET", "https://host"),
        ("http://me:SEC?RET@host/a", "http://host/a"),
        ("no such file: 'http://me:SECRET@h/a b'; allowed", "no such file: 'http://h/a b'; allowed"),
        ("(https://h/a?sig=SECRET), then ftp://u:SECRET@h/b.", "(https://h/a), then ftp://h/b."),
        ("volumes.0.path=http://h/a?SECRET", "volumes.0.path=http://h/a"),
        ("a://", "a://"),
        ("what? me@host", "what? me@host"),
    ],
)
def test_texts_show_no_secrets_of_addresses(text: str, public: str) -> None:
    assert without_secrets(text) == public
    assert str(DataError(text)) == str(ClustervizError(text)) == public
    assert str(DataError("what", where=text, found=text)) == f"{public}: what; found {public}"
    long = f"http://me:{'SECRET' * 300}@host/{'a' * 2000}?sig=SECRET"
    assert "SECRET" not in str(DataError(long, where=long, found=long, allowed=long))


def test_what_is_kept_or_shown_has_no_secrets_of_addresses(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in RANK_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    url, picture = f"{site.url.replace('//', '//me:SECRET@')}/{OWN}?sig=SECRET", tmp_path / "a.png"
    small = ("--size", "16x12", "--device", "cpu")
    assert run(["render", url, "-o", str(picture), "--stats", str(tmp_path / "a.json"), *small]) == 0
    assert all(path.endswith("?sig=SECRET") for path, _ in site.requests)
    assert run(["scene", url]) == run(["scene", str(picture)]) == run(["info", url]) == 0
    assert run(["replay", str(picture), "--json", "--device", "cpu"]) == 0
    assert run(["render", url, "-o", str(picture), "-D", f"volumes.0.cmap={url}", *small]) == 2
    scene = open_scene(url, ["volumes.0.clim=[1, 2]"])
    assert "SECRET" in scene.volumes[0].path
    said = capsys.readouterr()
    texts = [said.out, said.err, (tmp_path / "a.json").read_text(), read_text(picture), read_text(picture, RECORD_KEY)]
    texts += [dump_scene(scene), scene_file(scene).decode(), name_of(scene.volumes[0])]
    assert [text for text in texts if "SECRET" in text] == []
    assert f"{site.url}/{OWN}" in texts[3]


def test_urls_in_scenes_and_of_other_kinds(site: Site, written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"{site.url}/{OTHER}"
    assert [each.path for each in open_scene(url, ["volumes.0.clim=[1,2]"]).volumes] == [url]
    fsspec.filesystem("memory").put(str(written / OWN), f"/{OWN}", recursive=True)
    check_source(open_source(f"memory://{OWN}"), FIELD, 9)
    refused(lambda: open_source("memory://nothing.zarr"), "not a store of Zarr")
    refused(lambda: open_source("s3://bucket/a.zarr"), "a.zarr/zarr.json: URLs of s3", "pip install s3fs")
    refused(lambda: open_source("nope://a.zarr"), "URLs of nope")
    refused(lambda: open_source("http://127.0.0.1:1/a.zarr"), "no connection")
    refused(lambda: open_source("http:///a.zarr"), "not a URL")
    for package, text in (("urllib3", url), ("fsspec", "memory://a.zarr")):
        monkeypatch.setitem(sys.modules, package, None)
        refused(lambda text=text: open_source(text), f"needs the {package} package")
