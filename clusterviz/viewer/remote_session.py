"""Session of a scene that ranks of an MPI job draw, which `clusterviz view` runs in processes of its own.

The job listens on a free port of the loopback interface; its clients are websockets of this process.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed, ConnectionClosedError, WebSocketException
from websockets.sync.client import ClientConnection, connect

from clusterviz.data.source import Grid, Source
from clusterviz.errors import ClustervizError, InputError
from clusterviz.frame.opening import Given
from clusterviz.scene.values import Scene, Volume

CLOSE_SECONDS = 5.0
"""Time for the job to end in order."""
ADDRESS = re.compile(r"http://([\w.:\[\]]+)/\?token=(\S+)")


class RemoteSession:
    """Session of an MPI job that this process starts, until it is closed.

    `sources`: arrays and data sources instead of the files that the scene names; they are copied into files. Raises
    ClustervizError: the scene cannot be opened, or the job cannot be started.
    """

    def __init__(self, scene: Scene, sources: Given, ranks: int) -> None:
        self._folder, self._is_closed = tempfile.TemporaryDirectory(prefix="clusterviz-"), False
        try:
            path = Path(self._folder.name)
            saved = path / "scene.json"
            saved.write_text(json.dumps(_with_files(scene, sources, path).model_dump(mode="json", exclude_unset=True)))
            options = ["--ranks", str(ranks), "--port", "0", "--shared", "--end-alone", "--root", "/"]
            self._errors = (path / "errors").open("w+")
            self._job = subprocess.Popen(
                [sys.executable, "-m", "clusterviz", "view", str(saved), *options],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                start_new_session=True,  # an interrupt of the notebook's kernel is not for the job
            )
            self._host, self._token = self._read_address()
        except BaseException:
            self.close()
            raise

    def connect(self, put_text: Callable[[str], None], put_binary: Callable[[bytes], None]) -> RemoteConnection:
        """Add a client, whose messages go to two functions, which are called in a thread of its own."""
        return RemoteConnection(self._host, self._token, put_text, put_binary, self._reason)

    def close(self) -> None:
        """End the job, and remove its files."""
        self._is_closed = True
        if job := getattr(self, "_job", None):
            for number in (signal.SIGTERM, signal.SIGKILL):
                with suppress(ProcessLookupError):
                    os.killpg(job.pid, number)
                with suppress(subprocess.TimeoutExpired):
                    job.wait(CLOSE_SECONDS)
                    break
            self._errors.close()
        self._folder.cleanup()

    def _read_address(self) -> tuple[str, str]:
        assert self._job.stdout is not None, "the output is piped"
        for line in self._job.stdout:
            if found := ADDRESS.search(line):
                threading.Thread(target=self._job.stdout.read, daemon=True).start()  # so that the job never waits
                return found[1], found[2]
        reason = self._reason()
        raise InputError(reason) if self._job.poll() == InputError.exit_status else ClustervizError(reason)

    def _reason(self) -> str:
        if self._is_closed:
            return "it was closed"
        with suppress(subprocess.TimeoutExpired):
            self._job.wait(CLOSE_SECONDS)
        lines = Path(self._errors.name).read_text(errors="replace").splitlines()
        said = [line.removeprefix("clusterviz: ") for line in lines if line.startswith("clusterviz: ")] or lines[-3:]
        return "\n".join(said).replace("error: ", "") or f"the job has ended with status {self._job.poll()}"


class RemoteConnection:
    """Client of a session at the other end of a websocket.

    `put_text`, `put_binary`: called with messages for the client. `reason`: called for the text of the last message,
    when the job ends without one.
    """

    def __init__(
        self,
        host: str,
        token: str,
        put_text: Callable[[str], None],
        put_binary: Callable[[bytes], None],
        reason: Callable[[], str],
    ) -> None:
        self._put_text, self._put_binary, self._reason = put_text, put_binary, reason
        self._socket: ClientConnection | None = None
        self._exit, self._has_left = ExitStack(), False
        try:
            headers = {"Authorization": f"Bearer {token}"}
            opened = connect(f"ws://{host}/ws", additional_headers=headers, max_size=None, compression=None, proxy=None)
            self._socket = self._exit.enter_context(opened)
        except (OSError, WebSocketException):
            self._end()
            return
        threading.Thread(target=self._read, args=(self._socket,), name="clusterviz-relay", daemon=True).start()

    def receive(self, text: str) -> None:
        """Take a message of the client."""
        if self._socket is not None:
            with suppress(ConnectionClosed):
                self._socket.send(text)

    def close(self) -> None:
        """Leave the session."""
        self._has_left = True
        self._exit.close()

    def _read(self, socket: ClientConnection) -> None:
        with suppress(ConnectionClosedError):
            for data in socket:
                if isinstance(data, str):
                    self._put_text(data)
                else:
                    self._put_binary(data)
        if not self._has_left:
            self._end()

    def _end(self) -> None:
        self._put_text(json.dumps({"type": "ended", "message": self._reason()}))


def _with_files(scene: Scene, sources: Given, folder: Path) -> Scene:
    """Write data in memory to files; return the scene that names them."""
    if sources is None:
        return scene
    given: list[Any] = list(sources) if isinstance(sources, Sequence) else [sources]
    pairs = [pair for pair in zip(scene.entries.items(), given, strict=False) if pair[1] is not None]
    if any(section.drawn_as != "samples" for (_, section), _ in pairs):
        allowed = "files, or ranks=None"
        raise InputError(
            "only arrays are handed to ranks", where="view", found="a mesh or grid in memory", allowed=allowed
        )
    volumes = dict[str, Volume]()
    for (key, volume), source in pairs:
        path = folder / f"{key}.npy"
        np.save(path, source.read((0, 0, 0), source.grid.shape_zyx))
        volumes[key] = volume.model_copy(update={**_placement(source, volume), "path": str(path)})
    return scene.with_entries(volumes)


def _placement(source: Source, volume: Volume) -> dict[str, Any]:
    """Return the keys that place the samples in a file as those of a source, unless the scene has others."""
    default = Grid(source.grid.shape_zyx)
    names = [name for name in ("spacing", "origin", "direction") if getattr(volume, name) is None]
    return {name: found for name in names if (found := getattr(source.grid, name)) != getattr(default, name)}
