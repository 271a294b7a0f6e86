"""Where the frames of an animation go: numbered pictures, and what is beside them for taking it up again.

Each picture appears whole or not at all. A small JSON file beside them holds what they show: the completed scene, the
path, the size and state of the data file. An animation is taken up again only where all of that is the same; what does
not change pictures (the section `cluster`) may differ. An MP4 is made from pictures that are kept in a folder beside it
until the movie is whole.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
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

FIELD = re.compile(r"%0?\d*d")
SHOWN = 3
"""How many differences are named."""


class FrameFiles:
    """The pictures of an animation, on rank 0.

    Parameters
    ----------
    output : a name with one field for the number (frame_%04d.png), or a movie (.mp4, .gif)
    resume : keep the pictures that are there

    Raises
    ------
    OutputError
        Neither of both, a folder that cannot be written, or no encoder.
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
        if output.suffix.lower() != ".png" or len(FIELD.findall(output.name)) != 1 or output.name.count("%") != 1:
            allowed = "a movie (movie.mp4, movie.gif), or pictures with a field for their number ('frame_%04d.png')"
            raise OutputError("not a name for frames", where="--output", found=output.name, allowed=allowed)
        check_writable(self.path(0))

    def path(self, number: int) -> Path:
        """Of one picture."""
        return self._folder / (self._pattern % number)

    @property
    def record(self) -> Path:
        """The file that says what the pictures show."""
        stem = FIELD.sub("", self._pattern.removesuffix(".png")).strip("_-. ") or "frames"
        return self._folder / f"{stem}.animation.json"

    def begin(self, scene: Scene, frames: int, path: Any) -> list[int]:
        """Get ready; which pictures are missing.

        Parameters
        ----------
        scene : completed, of the loop
        path : what moves, as JSON holds it

        Raises
        ------
        InputError
            What is there shows something else, with the differences; a movie that shall be transparent.
        OutputError
            The folder cannot be written.
        """
        if self._movie and background_rgb(scene.image.background) is None:
            allowed = "a colour, as in -D image.background=black"
            raise InputError("a movie cannot be transparent", where="image.background", allowed=allowed)
        about = _about(scene, frames, path)
        with _writable(self._folder):
            self._folder.mkdir(exist_ok=True)
        if self._resume and self.record.exists():
            self._check_same(about)
            return [number for number in range(frames) if not self._is_whole(number, scene.image.size)]
        # Older pictures would be taken for this animation's when it is taken up again.
        with _writable(self._folder):
            for number in range(frames):
                self.path(number).unlink(missing_ok=True)
        with replacing(self.record) as temporary:
            temporary.write_text(json.dumps(about, indent=2) + "\n")
        return list(range(frames))

    def write(self, number: int, image: NDArray[np.float32], scene: Scene) -> None:
        """Keep one picture.

        Raises
        ------
        OutputError
            It cannot be written; those before stay whole.
        """
        write_image(self.path(number), image, background_rgb(scene.image.background))

    def finish(self, frames: int, frames_per_second: float) -> None:
        """When all pictures are there: make the movie, and remove them."""
        if self._movie:
            pictures = (_bytes_of(self.path(number)) for number in range(frames))
            write_movie(self._output, pictures, frames, frames_per_second)
            shutil.rmtree(self._folder, ignore_errors=True)

    def _check_same(self, about: dict[str, Any]) -> None:
        try:
            before = json.loads(self.record.read_text())
        except (OSError, ValueError) as error:
            raise InputError("cannot be read", where=str(self.record), found=error) from None
        found = differences(before, about)
        if found:
            more = f"; and {len(found) - SHOWN} more differences" if len(found) > SHOWN else ""
            raise InputError(
                "the frames show something else",
                where=str(self.record),
                found="; ".join(found[:SHOWN]) + more,
                allowed="the same scene and path, or no --resume: then all is rendered anew",
            )

    def _is_whole(self, number: int, size: tuple[int, int]) -> bool:
        with suppress(InputError):
            return self.path(number).exists() and read_image(self.path(number)).shape[1::-1] == size
        return False


def _about(scene: Scene, frames: int, path: Any) -> dict[str, Any]:
    """All that pictures depend on, as JSON holds it."""
    told = scene.model_dump(mode="json", exclude={"cluster"})
    files: dict[str, Any] = {}
    for volume in scene.volumes:
        with suppress(OSError):
            state = Path(volume.path).stat()
            files[volume.path] = {"bytes": state.st_size, "modified": state.st_mtime}
    about = {"scene": told, "size": list(scene.image.size), "frames": frames, "path": path, "data": files}
    return dict(json.loads(json.dumps(about)))


def _bytes_of(path: Path) -> NDArray[np.uint8]:
    pixels: NDArray[np.uint8] = np.rint(read_image(path)[..., :3] * 255).astype(np.uint8)
    return pixels


@contextmanager
def _writable(folder: Path) -> Iterator[None]:
    """What the system says of a folder, as a user reads it."""
    try:
        yield
    except OSError as error:
        raise OutputError("cannot be written", where=str(folder), found=error.strerror or error) from None
