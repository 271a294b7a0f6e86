"""`clusterviz animate`: render an orbit, a path of key frames or time steps as numbered pictures or as a movie.

A record beside the pictures serves `--resume`.
"""

from __future__ import annotations

import json
import math
import queue
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from clusterviz.annotations import with_annotations
from clusterviz.cli.arguments import (
    AnnotateOption,
    Define,
    DeviceOption,
    LayersOption,
    PresetOption,
    SceneArgument,
    Size,
    overrides_of,
    parse_device,
)
from clusterviz.cli.console import print_info, show_progress
from clusterviz.cli.instrumentation import Tracing, check_reports, slowest_startup, start, write_statistics
from clusterviz.comm import Channel, agree
from clusterviz.content.diff import differences
from clusterviz.content.summary import chosen_arrays
from clusterviz.data import open_scene, open_volume
from clusterviz.errors import InputError, OutputError
from clusterviz.frame import FrameLoop, Options
from clusterviz.frame.picture_file import write_picture
from clusterviz.image.files import LAYERED, check_writable, read_image
from clusterviz.image.movie import check_encoder, write_movie
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.report.counts import EarlyDiscarding, FrameCoherence, all_counts
from clusterviz.report.provenance import Provenance
from clusterviz.report.statistics import FrameStatistics
from clusterviz.report.trace import Span
from clusterviz.scene import background_rgb
from clusterviz.scene.animation import KeyFrames, load_path, scenes_along
from clusterviz.scene.files import public_data
from clusterviz.scene.values import Scene

NUMBER_FIELD = re.compile(r"%0?\d*d")
MAX_LISTED = 3
"""Largest number of differences named in an error."""


class FrameFiles:
    """Pictures of an animation, on rank 0.

    `output`: a file name with one number field (frame_%04d.png), or a movie (.mp4, .gif). `resume`: whether to keep
    existing pictures. Raises OutputError: the name is neither, the folder cannot be written, or there is no encoder.
    """

    def __init__(self, output: Path, resume: bool, has_layers: bool = False) -> None:
        self._output, self._resume = output, resume
        self._movie = output.suffix.lower() in (".mp4", ".gif")
        self._folder = output.with_name(f"{output.name}.frames") if self._movie else output.parent
        self._pattern = "frame_%06d.png" if self._movie else output.name
        if self._movie and not has_layers:
            if output.suffix.lower() == ".mp4":
                check_encoder(output)
            check_replaceable(output)
            return
        if (
            output.suffix.lower() not in (LAYERED if has_layers else (".png", *LAYERED))
            or len(NUMBER_FIELD.findall(output.name)) != 1
            or output.name.count("%") != 1
        ):
            allowed = "pictures with a field for their number ('frame_%04d.exr', 'frame_%04d.npz')"
            if not has_layers:
                allowed = f"a movie (movie.mp4, movie.gif), or {allowed[:-1]}, 'frame_%04d.png')"
            raise OutputError("not a name for frames", where="--output", found=output.name, allowed=allowed)
        check_writable(self.path(0))

    def path(self, number: int) -> Path:
        """Return the path of a picture."""
        return self._folder / (self._pattern % number)

    @property
    def record(self) -> Path:
        """Path of the record of what the pictures show."""
        stem = NUMBER_FIELD.sub("", Path(self._pattern).stem).strip("_-. ") or "frames"
        return self._folder / f"{stem}.animation.json"

    def begin(self, scene: Scene, frames: int, path: Any) -> list[int]:
        """Prepare the folder and the record; return the numbers of missing pictures.

        Parameters
        ----------
        scene : the completed scene
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

    def write(self, image: NDArray[np.float32], scene: Scene, made: Provenance) -> None:
        """Write one picture. Raises OutputError: the picture cannot be written; earlier ones are kept."""
        write_picture(self.path(made.number), image, scene, made)

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
    scene_data = public_data(scene, {"cluster"})
    files: dict[str, Any] = {}
    for section in scene.entries.values():
        with suppress(OSError):
            state = Path(section.path).stat()
            files[section.path] = {"bytes": state.st_size, "modified": state.st_mtime}
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


def command(
    context: typer.Context,
    scene: SceneArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="movie.mp4, movie.gif, or pictures: 'frame_%04d.png'.")
    ],
    orbit: Annotated[
        float | None, typer.Option(metavar="DEGREES", help="Turn about the focal point, round view_up.")
    ] = None,
    path: Annotated[
        Path | None, typer.Option(metavar="PATH.yaml", help="Key frames of camera and transfer function.")
    ] = None,
    time_steps: Annotated[
        bool, typer.Option("--time", help="Show the time steps of the volumes, one after the other.")
    ] = False,
    frames: Annotated[
        int | None,
        typer.Option(min=1, help="Number of frames; default with a path: its duration; with time steps: theirs."),
    ] = None,
    define: Define = None,
    preset: PresetOption = None,
    size: Size = None,
    layers: LayersOption = None,
    annotate: AnnotateOption = False,
    fps: Annotated[float, typer.Option(min=0.01, help="Frames per second.")] = 25.0,
    resume: Annotated[bool, typer.Option("--resume", help="Render only frames that are not there yet.")] = False,
    stats: Annotated[Path | None, typer.Option(metavar="F.json", help="Write what each rank did as JSON.")] = None,
    trace: Annotated[Path | None, typer.Option(metavar="F.json", help="Write a trace for Perfetto.")] = None,
    device: DeviceOption = None,
    overlap: Annotated[bool, typer.Option(help="Composite each frame while the next one is drawn.")] = True,
) -> None:
    """Render an orbit, a path or time steps as a movie or as numbered pictures; under mpirun, on all ranks."""
    channel, startup = start(several_threads=overlap)
    with agree(channel, 0, "scene"):
        opened, device_choice = open_scene(scene, overrides_of(define, size, layers), preset), parse_device(device)
        keys = load_path(path) if path else None
        opened = with_annotations(opened) if annotate else opened
        opened = opened if orbit is None else fit_to_orbit(opened)
        opened, steps = with_time_steps(opened, time_steps)
        count = frame_count(orbit, keys, frames, fps, str(path), max(steps.values(), default=0))
    with agree(channel, 0, "output"):
        files = FrameFiles(output, resume, bool(opened.image.layers)) if channel.rank == 0 else None
        if channel.rank == 0:
            check_reports(stats, trace)
    began = time.perf_counter()
    tracing = Tracing(channel, trace)
    movie = _Animation(channel, files, tracing, bool(stats))
    changing = keys is not None and bool(keys.transfer)
    debug, traced = bool(context.obj["debug"]), bool(trace)
    options = Options(
        device_choice,
        debug=debug,
        write=movie.write,
        trace=traced,
        overlap=overlap,
        annotate=True,
        keep_bricks=changing,
    )
    with FrameLoop(opened, channel, options=options) as loop:
        with agree(channel, 0, "path"):
            scenes = scenes_along(loop.scene, count, orbit, keys, str(path or "--orbit"), steps)
            description: dict[str, Any] = {"orbit": orbit, "keys": keys.model_dump(mode="json") if keys else None}
            description |= {"time steps": steps} if steps else {}
            missing = files.begin(loop.scene, count, description) if files else []
        missing = channel.broadcast(missing)
        movie.draw(loop, scenes, missing)
    with agree(channel, count - 1, "write"):
        movie.finish(count, fps)
    slowest = slowest_startup(channel.allgather(startup))
    with agree(channel, count - 1, "statistics"):
        if stats and channel.rank == 0:
            write_statistics(stats, loop.scene, movie.statistics, slowest)
    tracing.write()
    if channel.rank == 0:
        seconds = time.perf_counter() - began
        for line in chosen_arrays(opened, loop.scene):
            print_info(line)
        print_info(f"{len(missing)} of {count} frames rendered in {seconds:.1f} s: {output}")
        if movie.frame_coherence:
            print_info(f"frame coherence: {movie.frame_coherence}")
        if movie.early_discarding:
            print_info(f"early discarding: {movie.early_discarding}")


def fit_to_orbit(scene: Scene) -> Scene:
    """Return a scene whose camera, if it is chosen automatically, shows everything from all sides."""
    if (scene.camera.position, scene.camera.parallel_scale) != (None, None):
        return scene
    return scene.model_copy(update={"camera": scene.camera.model_copy(update={"fit": "orbit"})})


def with_time_steps(scene: Scene, asked_for: bool) -> tuple[Scene, dict[str, int]]:
    """Return a scene whose volumes show all time steps, and the number of these steps by the key of the volume.

    `asked_for`: whether volumes with several steps of which the scene names none show all. Raises DataError: a file
    cannot be read. Raises InputError: no volume has several time steps.
    """
    volumes, steps = scene.drawn_as("samples"), dict[str, int]()
    for key, volume in volumes.items():
        if volume.time == "all" or (asked_for and volume.time is None):
            first = open_volume(volume.model_copy(update={"time": None, "spacing": (1.0, 1.0, 1.0)}))
            slab = getattr(first, "slab", None)
            if slab is not None and slab.time_steps > 1:
                steps[key] = slab.time_steps
            volumes[key] = volume.model_copy(update={"time": "all" if key in steps else None})
    if asked_for and not steps:
        raise InputError("no volume has several time steps", where="--time", allowed="a series or store with some")
    return scene.with_entries(volumes), steps


def frame_count(
    orbit: float | None, keys: KeyFrames | None, frames: int | None, fps: float, where: str, time_steps: int = 0
) -> int:
    """Return the number of frames.

    Raises InputError: nothing moves, as there are no orbit, path and time steps; or an orbit alone without `--frames`.
    """
    if orbit is not None and not math.isfinite(orbit):
        raise InputError("not finite", where="--orbit", found=orbit, allowed="degrees, as in 360")
    if orbit is None and keys is None and not time_steps:
        raise InputError("nothing moves", where="animate", allowed="--orbit DEGREES, --path PATH.yaml, --time")
    if frames is None and keys is None and not time_steps:
        raise InputError("missing", where="--frames", allowed="1 or more")
    return frames or (keys.frames(fps, where) if keys else time_steps)


class _Animation:
    """Drawing and writing of the frames; rank 0 writes them in a thread."""

    def __init__(self, channel: Channel, files: FrameFiles | None, tracing: Tracing, keep: bool) -> None:
        self._channel, self._files, self._tracing, self._keep = channel, files, tracing, keep
        self._thread = WriterThread() if files else None
        self.statistics: list[FrameStatistics] = []
        self.frame_coherence: FrameCoherence | None = None
        self.early_discarding: EarlyDiscarding | None = None

    def draw(self, loop: FrameLoop, scenes: list[Scene], missing: list[int]) -> None:
        """Draw the missing frames; collective."""
        try:
            self._draw(loop, scenes, missing)
        finally:
            if self._thread:
                self._thread.close()

    def _draw(self, loop: FrameLoop, scenes: list[Scene], missing: list[int]) -> None:
        names = [f"frame {number + 1} of {len(scenes)}" for number in missing]
        with show_progress(names if self._channel.rank == 0 else ()) as progress:
            if names:
                progress(names[0])
            frames = loop.frames((number, scenes[number]) for number in missing)
            for rendered, following in zip_longest(frames, names[1:]):
                if following:
                    progress(following)
                self._tracing.add(rendered.spans)
                self.frame_coherence = all_counts((self.frame_coherence, rendered.statistics.frame_coherence))
                self.early_discarding = all_counts((self.early_discarding, rendered.statistics.early_discarding))
                if self._keep and self._channel.rank == 0:
                    self.statistics.append(rendered.statistics)

    def write(self, image: NDArray[np.float32], scene: Scene, made: Provenance) -> None:
        """Queue a frame for writing while others are drawn and composited."""
        files, tracing = self._files, self._tracing

        def job() -> None:
            began = time.perf_counter()
            files.write(image, scene, made)  # type: ignore[union-attr]
            tracing.add([Span(f"write frame {made.number}", "finish", began, time.perf_counter(), row="writing")])

        if files and self._thread:
            self._thread.put(job)

    def finish(self, frames: int, frames_per_second: float) -> None:
        """Wait until all frames are written, and encode the movie if the output is one."""
        if self._files and self._thread:
            self._thread.finish()
            self._files.finish(frames, frames_per_second)
