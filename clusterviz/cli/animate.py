"""`clusterviz animate`: render an orbit or a path of key frames as numbered pictures or as a movie."""

from __future__ import annotations

import math
import time
from itertools import zip_longest
from pathlib import Path
from typing import Annotated

import typer

from clusterviz.cli.arguments import Define, DeviceOption, SceneArgument, Size, overrides_of, parse_device
from clusterviz.cli.console import print_info, show_progress
from clusterviz.cli.frame_files import FrameFiles, WriterThread
from clusterviz.cli.instrumentation import Tracing, check_reports, slowest_startup, start, write_statistics
from clusterviz.comm import Channel, agree
from clusterviz.errors import InputError
from clusterviz.frame import FrameLoop, Options
from clusterviz.report.frame_coherence import FrameCoherence, together
from clusterviz.report.statistics import FrameStatistics
from clusterviz.report.trace import Span
from clusterviz.scene import Scene, open_scene
from clusterviz.scene.animation import KeyFrames, load_path, scenes_along


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
    frames: Annotated[
        int | None, typer.Option(min=1, help="Number of frames; default with a path: its duration.")
    ] = None,
    define: Define = None,
    size: Size = None,
    fps: Annotated[float, typer.Option(min=0.01, help="Frames per second.")] = 25.0,
    resume: Annotated[bool, typer.Option("--resume", help="Render only frames that are not there yet.")] = False,
    stats: Annotated[Path | None, typer.Option(metavar="F.json", help="Write what each rank did as JSON.")] = None,
    trace: Annotated[Path | None, typer.Option(metavar="F.json", help="Write a trace for Perfetto.")] = None,
    device: DeviceOption = None,
    overlap: Annotated[bool, typer.Option(help="Composite each frame while the next one is drawn.")] = True,
) -> None:
    """Render an orbit or a path as a movie or as numbered pictures; under mpirun, on all ranks."""
    channel, startup = start(several_threads=overlap)
    with agree(channel, 0, "scene"):
        opened, device_choice = open_scene(scene, overrides_of(define, size)), parse_device(device)
        keys = load_path(path) if path else None
        if orbit is not None and (opened.camera.position, opened.camera.parallel_scale) == (None, None):
            opened = opened.model_copy(update={"camera": opened.camera.model_copy(update={"fit": "orbit"})})
        count = _frames(orbit, keys, frames, fps, str(path))
    with agree(channel, 0, "output"):
        files = FrameFiles(output, resume) if channel.rank == 0 else None
        if channel.rank == 0:
            check_reports(stats, trace)
    began = time.perf_counter()
    tracing = Tracing(channel, trace)
    movie = _Animation(channel, files, tracing, bool(stats))
    changing = keys is not None and bool(keys.transfer)
    debug, traced = bool(context.obj["debug"]), bool(trace)
    options = Options(
        device_choice, debug=debug, write=movie.write, trace=traced, overlap=overlap, keep_bricks=changing
    )
    with FrameLoop(opened, channel, options=options) as loop:
        with agree(channel, 0, "path"):
            scenes = scenes_along(loop.scene, count, orbit, keys, str(path or "--orbit"))
            description = {"orbit": orbit, "keys": keys.model_dump(mode="json") if keys else None}
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
        print_info(f"{len(missing)} of {count} frames rendered in {seconds:.1f} s: {output}")
        if movie.frame_coherence:
            print_info(f"frame coherence: {movie.frame_coherence}")


def _frames(orbit: float | None, keys: KeyFrames | None, frames: int | None, fps: float, where: str) -> int:
    """Return the number of frames.

    Raises
    ------
    InputError
        Neither an orbit nor a path is given, or an orbit without `--frames`.
    """
    if orbit is not None and not math.isfinite(orbit):
        raise InputError("not finite", where="--orbit", found=orbit, allowed="degrees, as in 360")
    if orbit is None and keys is None:
        raise InputError("nothing moves", where="animate", allowed="--orbit DEGREES, --path PATH.yaml, or both")
    if frames is None and keys is None:
        raise InputError("missing", where="--frames", allowed="1 or more")
    return frames or (keys.frames(fps, where) if keys else 1)


class _Animation:
    """Drawing and writing of the frames; rank 0 writes them in a thread."""

    def __init__(self, channel: Channel, files: FrameFiles | None, tracing: Tracing, keep: bool) -> None:
        self._channel, self._files, self._tracing, self._keep = channel, files, tracing, keep
        self._thread = WriterThread() if files else None
        self.statistics: list[FrameStatistics] = []
        self.frame_coherence: FrameCoherence | None = None

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
                self.frame_coherence = together((self.frame_coherence, rendered.statistics.frame_coherence))
                if self._keep and self._channel.rank == 0:
                    self.statistics.append(rendered.statistics)

    def write(self, image: object, scene: Scene, number: int) -> None:
        """Queue a frame for writing while others are drawn and composited."""
        files, tracing = self._files, self._tracing

        def job() -> None:
            began = time.perf_counter()
            files.write(number, image, scene)  # type: ignore[union-attr, arg-type]
            tracing.add([Span(f"write frame {number}", "finish", began, time.perf_counter(), row="writing")])

        if files and self._thread:
            self._thread.put(job)

    def finish(self, frames: int, frames_per_second: float) -> None:
        """Wait until all frames are written, and encode the movie if the output is one."""
        if self._files and self._thread:
            self._thread.finish()
            self._files.finish(frames, frames_per_second)
