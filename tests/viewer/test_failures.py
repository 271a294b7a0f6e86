"""`clusterviz view` as a user starts it: bad input changes nothing, one steers at a time, a dead rank ends it."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from failures.jobs import FIELD, SMALL, finish, start
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from clusterviz.cli import run
from clusterviz.cli.termination import RANK_VARIABLES
from clusterviz.viewer.messages import unpack

pytestmark = pytest.mark.fresh
PATIENCE = 100.0
"""Seconds until a test fails that waits in vain; the first picture may wait for its kernels to be compiled."""


class Viewer:
    """Job of the command, and what its clients do."""

    def __init__(self, ranks: int, *options: str, **environment: str) -> None:
        arguments = ("-m", "clusterviz", "view", FIELD, "--port", "0", *SMALL, *options)
        self.job = start(ranks, *arguments, environment=environment)
        assert self.job.stdout is not None
        address = re.fullmatch(r"http://[^/]+:(\d+)/\?token=(\S+)\n", self.job.stdout.readline())
        if address is None:
            pytest.fail(finish(self.job).err)
        self.port, self.token = int(address[1]), address[2]

    def connect(self) -> AbstractContextManager[ClientConnection]:
        header = {"Authorization": f"Bearer {self.token}"}
        return connect(
            f"ws://127.0.0.1:{self.port}/ws", additional_headers=header, compression=None, open_timeout=PATIENCE
        )


@contextmanager
def viewing(ranks: int, *options: str, **environment: str) -> Iterator[Viewer]:
    """A job that does not outlive a test that fails."""
    found = Viewer(ranks, *options, **environment)
    try:
        yield found
    finally:
        if found.job.poll() is None:
            found.job.terminate()


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    """A job on one rank, which ends as it should on ctrl-C."""
    with viewing(1) as found:
        yield found
        with found.connect() as watching:
            until(watching, type="hello")
            found.job.send_signal(signal.SIGINT)
            assert until(watching, type="ended")["message"] == "the job was interrupted"
            with pytest.raises(ConnectionClosed, match="1001"):
                until(watching, type="nothing")
        ended = finish(found.job)
    assert (ended.status, ended.out, ended.err) == (130, "", "clusterviz: interrupted\n")


def send(to: ClientConnection, kind: str, **values: Any) -> None:
    to.send(json.dumps({"type": kind, **values}))


def until(client: ClientConnection, **wanted: Any) -> dict[str, Any]:
    """The next message or header of a picture with these values; pictures are acknowledged."""
    while True:
        data = client.recv(timeout=PATIENCE)
        found: dict[str, Any] = json.loads(data) if isinstance(data, str) else unpack(data)[0]
        if found.get("kind") == "picture":
            with suppress(ConnectionClosed):  # by the other side, which may have said why before
                send(client, "ack", picture=found["picture"])
        if wanted.items() <= found.items():
            return found


def test_what_cannot_be_done_changes_nothing(viewer: Viewer) -> None:
    with viewer.connect() as client:
        before = until(client, type="state")["scene"]
        changes = [
            ({"volumes.0.clim": "bright"}, "volumes.0.clim", "not a list"),
            ({"quality.step": -1}, "quality.step", "too small"),
            ({"volumes.0.colour": "red"}, "volumes.0.colour", "unknown key"),
            ({"volumes.7.cmap": "grey"}, "volumes.7.cmap", "no such item in the list"),
        ]
        for number, (change, key, what) in enumerate(changes, 1):
            send(client, "edit", changes=change, moving=False, input=number)
            answer = until(client, type="error")
            assert (answer["input"], answer["key"]) == (number, key)
            assert what in answer["message"]
        send(client, "edit", changes={"volumes.0.path": "no/such/file.nrrd"}, moving=False, input=98)
        assert "not a file that the live view may open" in until(client, type="error")["message"]
        send(client, "edit", changes={"quality.step": 2}, moving=False, input=99)
        expected = before | {"quality": before["quality"] | {"step": 2}}
        while until(client, type="state")["scene"] != expected:
            pass


def test_window_without_area_is_drawn_small(viewer: Viewer) -> None:
    with viewer.connect() as client:
        send(client, "size", width=0, height=0)
        until(client, kind="picture", width=16, height=16, still=True)
        send(client, "size", width=30, height=20)
        until(client, kind="picture", width=30, height=20, still=True)


def test_one_steers_at_a_time(viewer: Viewer) -> None:
    with viewer.connect() as first, viewer.connect() as second:
        one, two = until(first, type="hello")["client"], until(second, type="hello")["client"]
        send(first, "edit", changes={"quality.step": 3}, moving=False, input=1)
        until(first, type="state", steering=one)
        send(second, "edit", changes={"quality.step": 4}, moving=False, input=1)
        assert until(second, type="error")["message"] == f"client {one} steers"
        send(second, "steer", action="ask")
        until(first, type="state", asking=[two])
        send(first, "steer", action="grant", client=two)
        until(second, type="state", steering=two)
        send(first, "edit", changes={"quality.step": 5}, moving=False, input=2)
        assert until(first, type="error")["message"] == f"client {two} steers"
        send(second, "edit", changes={"quality.step": 6}, moving=False, input=2)
        until(second, kind="picture", input=2, still=True)
    with viewer.connect() as reloaded:
        state = until(reloaded, type="state")
        assert (state["scene"]["quality"]["step"], state["steering"]) == (6, None)


def test_killed_rank_ends_the_job_and_all_connections() -> None:
    mark = f"{os.getpid()}.{id(object())}"
    with viewing(2, "--host", "0.0.0.0", CLUSTERVIZ_MARK=mark) as viewer, viewer.connect() as client:
        until(client, kind="picture")
        os.kill(rank_of(1, mark), signal.SIGKILL)
        with pytest.raises(ConnectionClosed):
            until(client, type="nothing")
        ended = finish(viewer.job)
    assert ended.status != 0
    assert "others on the network can read its token" in ended.err
    assert viewer.token not in ended.err + ended.out
    assert "Traceback" not in ended.err


def rank_of(rank: int, mark: str) -> int:
    """The process of a rank, by the environment of its job."""
    wanted = {f"{name}={rank}".encode() for name in RANK_VARIABLES}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            variables, words = (folder / "environ").read_bytes(), (folder / "cmdline").read_bytes()
        except OSError:
            continue
        is_ours = f"CLUSTERVIZ_MARK={mark}".encode() in variables and b"clusterviz\0view" in words
        if is_ours and wanted & set(variables.split(b"\0")):
            return int(folder.name)
    raise ProcessLookupError(rank)


def test_port_in_use_is_named(viewer: Viewer, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(("view", FIELD, *SMALL, "--port", str(viewer.port))) == 2
    error = capsys.readouterr().err
    assert f"127.0.0.1:{viewer.port}: cannot listen: address already in use; allowed a free --port" in error
    assert error.count("\n") == 1


def test_missing_package_is_named() -> None:
    code = "import sys; sys.modules['uvicorn'] = None; from clusterviz.cli import main; main()"
    ended = finish(start(1, "-c", code, "view", "none.npy"))
    assert ended.status == 1
    assert ended.err == "clusterviz: error: view needs uvicorn: pip install '.[view]' in a checkout of clusterviz\n"
