"""Output files of an animation: numbered pictures or a movie, with a record for `--resume`.

Each picture appears whole or not at all. A JSON record beside them holds the completed scene, the path, and size and
time of the data files. An animation is resumed only if the record is the same, except for the section `cluster`, which
does not change pictures. The pictures of a movie are kept in a folder beside it until the movie is complete.
"""

from __future__ import annotations

import json
import queue
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError, OutputError
from clusterviz.image.files import check_writable, read_image, write_image
from clusterviz.image.movie import check_encoder, write_movie
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.scene import background_rgb
from clusterviz.scene.diff import differences
from clusterviz.scene.values import Scene

NUMBER_FIELD = re.compile(r"%0?\d*d")
MAX_LISTED = 3
"""Largest number of differences named in an error."""


class FrameFiles:
    """Pictures of an animation, on rank 0.

    Parameters
    ----------
    output : a file name with one number field (frame_%04d.png), or a movie (.mp4, .gif)
    resume : whether to keep existing pictures

    Raises
    ------
    OutputError
        The name is neither, the folder cannot be written, or there is no encoder.
    """

    def __init__(self, output: Path, resume: bool) -> None:
        self._output, self._resume = output, resume
        self._movie = output.suffix.lower() in (".mp4", ".gif")
        self._folder = output.with_name(f"{output.name}.frames") if self._movie else output.parent
        self._pattern = "frame_%06d.png" if self._movie else output.name
        if self._movie:
            if output.suffix.lower() == ".mp4":
                check_encoder(output)
            check_replaceable(output)
            return
        if (
            output.suffix.lower() != ".png"
            or len(NUMBER_FIELD.findall(output.name)) != 1
            or output.name.count("%") != 1
        ):
            allowed = "a movie (movie.mp4, movie.gif), or pictures with a field for their number ('frame_%04d.png')"
            raise OutputError("not a name for frames", where="--output", found=output.name, allowed=allowed)
        check_writable(self.path(0))

    def path(self, number: int) -> Path:
        """Return the path of a picture."""
        return self._folder / (self._pattern % number)

    @property
    def record(self) -> Path:
        """Path of the record of what the pictures show."""
        stem = NUMBER_FIELD.sub("", self._pattern.removesuffix(".png")).strip("_-. ") or "frames"
        return self._folder / f"{stem}.animation.json"

    def begin(self, scene: Scene, frames: int, path: Any) -> list[int]:
        """Prepare the folder and the record; return the numbers of missing pictures.

        Parameters
        ----------
        scene : the completed scene
        frames : number of frames
        path : orbit and key frames, as JSON values

        Raises
        ------
        InputError
            Existing pictures show something else, or the background of a movie is transparent.
        OutputError
            The folder cannot be written.
        """
        if self._movie and background_rgb(scene.image.background) is None:
            allowed = "a colour, as in -D image.background=black"
            raise InputError("a movie cannot be transparent", where="image.background", allowed=allowed)
        record_content = _animation_record(scene, frames, path)
        with _folder_errors(self._folder):
            self._folder.mkdir(exist_ok=True)
        if self._resume and self.record.exists():
            self._check_same(record_content)
            return [number for number in range(frames) if not self._is_whole(number, scene.image.size)]
        # Older pictures would count as this animation's when it is resumed.
        with _folder_errors(self._folder):
            for number in range(frames):
                self.path(number).unlink(missing_ok=True)
        with replacing(self.record) as temporary:
            temporary.write_text(json.dumps(record_content, indent=2) + "\n")
        return list(range(frames))

    def write(self, number: int, image: NDArray[np.float32], scene: Scene) -> None:
        """Write one picture.

        Raises
        ------
        OutputError
            The picture cannot be written; earlier ones are kept.
        """
        write_image(self.path(number), image, background_rgb(scene.image.background))

    def finish(self, frames: int, frames_per_second: float) -> None:
        """Encode the movie, if the output is one, and remove its pictures."""
        if self._movie:
            pictures = (_read_bytes(self.path(number)) for number in range(frames))
            write_movie(self._output, pictures, frames, frames_per_second)
            shutil.rmtree(self._folder, ignore_errors=True)

    def _check_same(self, record_content: dict[str, Any]) -> None:
        try:
            before = json.loads(self.record.read_text())
        except (OSError, ValueError) as error:
            raise InputError("cannot be read", where=str(self.record), found=error) from None
        found = differences(before, record_content)
        if found:
            more = f"; and {len(found) - MAX_LISTED} more differences" if len(found) > MAX_LISTED else ""
            raise InputError(
                "the frames show something else",
                where=str(self.record),
                found="; ".join(found[:MAX_LISTED]) + more,
                allowed="the same scene and path, or no --resume: then all is rendered anew",
            )

    def _is_whole(self, number: int, size: tuple[int, int]) -> bool:
        with suppress(InputError):
            return self.path(number).exists() and read_image(self.path(number)).shape[1::-1] == size
        return False


def _animation_record(scene: Scene, frames: int, path: Any) -> dict[str, Any]:
    """Return everything that the pictures depend on, as JSON values."""
    scene_data = scene.model_dump(mode="json", exclude={"cluster"})
    files: dict[str, Any] = {}
    for volume in scene.volumes:
        with suppress(OSError):
            state = Path(volume.path).stat()
            files[volume.path] = {"bytes": state.st_size, "modified": state.st_mtime}
    record_content = {
        "scene": scene_data,
        "size": list(scene.image.size),
        "frames": frames,
        "path": path,
        "data": files,
    }
    return dict(json.loads(json.dumps(record_content)))


def _read_bytes(path: Path) -> NDArray[np.uint8]:
    pixels: NDArray[np.uint8] = np.rint(read_image(path)[..., :3] * 255).astype(np.uint8)
    return pixels


@contextmanager
def _folder_errors(folder: Path) -> Iterator[None]:
    """Raise an `OutputError` for operating system errors of a folder."""
    try:
        yield
    except OSError as error:
        raise OutputError("cannot be written", where=str(folder), found=error.strerror or error) from None


MAX_QUEUED = 2
"""Largest number of queued jobs; `put` blocks beyond it, which bounds memory."""


class WriterThread:
    """Thread that runs jobs in order; after an error it skips jobs, and the next call raises the error."""

    def __init__(self) -> None:
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(MAX_QUEUED)
        self._error: Exception | None = None
        # A daemon thread does not delay the end of the process.
        self._thread = threading.Thread(target=self._run, name="writing", daemon=True)
        self._thread.start()

    def put(self, job: Callable[[], None]) -> None:
        """Queue a job; its data must not change until it has run."""
        self._raise()
        self._jobs.put(job)

    def close(self) -> None:
        """Wait until all jobs have run; called also after failures, to keep finished frames."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()

    def finish(self) -> None:
        """Wait until all jobs have run, and raise the first error."""
        self.close()
        self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._error is None:
                try:
                    job()
                except Exception as error:
                    self._error = error
