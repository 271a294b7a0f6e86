"""`clusterviz render`: one picture of a scene or a data file, from all ranks together."""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

import clusterviz
from clusterviz.cli.arguments import Define, DeviceOption, SceneArgument, Size, overrides_of, parse_device
from clusterviz.cli.costs import print_costs
from clusterviz.cli.progress import announce_compiling, show_progress
from clusterviz.cli.tracing import Tracing
from clusterviz.cli.verbosity import Verbosity, say, verbosity
from clusterviz.comm import Channel, agree, limit_threads, open_channel
from clusterviz.frame import STEPS, Options, render_frame
from clusterviz.image.files import check_writable, write_image
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.report.statistics import FrameStatistics, statistics_file
from clusterviz.scene import background_rgb, open_scene
from clusterviz.scene.text import picture_metadata, scene_summary
from clusterviz.scene.values import Scene


def command(
    context: typer.Context,
    scene: SceneArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="The picture: .png, .jpg, .gif, .npy or .exr.")
    ],
    define: Define = None,
    size: Size = None,
    stats: Annotated[Path | None, typer.Option(metavar="F.json", help="Write what each rank did as JSON.")] = None,
    trace: Annotated[Path | None, typer.Option(metavar="F.json", help="Write a trace for Perfetto.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Composite a second time, serially, and compare.")] = False,
    device: DeviceOption = None,
) -> None:
    """Render a scene or a data file into a picture; under mpirun, on all ranks."""
    channel, startup = start()
    with agree(channel, 0, "scene"):
        opened, drawn_on = open_scene(scene, overrides_of(define, size)), parse_device(device)
    with agree(channel, 0, "output"):
        if channel.rank == 0:
            _check_outputs(output, stats, trace)
    tracing = Tracing(channel, trace)
    with show_progress(STEPS if channel.rank == 0 else (), one=True) as progress:
        options = Options(drawn_on, check, context.obj["debug"], progress, _writer(output), bool(trace))
        rendered = render_frame(opened, channel, options=options)
    tracing.add(rendered.spans)
    tracing.write()
    slowest = slowest_of(channel.allgather(startup))
    with agree(channel, 0, "statistics"):
        if stats and channel.rank == 0:
            write_statistics(stats, rendered.scene, [rendered.statistics], slowest)
    if channel.rank == 0 and verbosity() is not Verbosity.QUIET:
        print_costs(rendered.statistics, slowest)
        say(f"shown      {scene_summary(rendered.scene)}")
        say(f"\nthe picture is {output}" + (f", its numbers are in {stats}" if stats else ""))


def start(*, several_threads: bool = False) -> tuple[Channel, dict[str, float]]:
    """The channel, and the seconds from the start of this process until the ranks knew each other."""
    reached, began = clusterviz.REACHED, time.perf_counter()
    age = _process_age()
    channel = open_channel(several_threads=several_threads)
    limit_threads(channel.placement())
    warnings.formatwarning = lambda message, *_: f"\nclusterviz: WARNING: {message}\n"  # a user needs no line of code
    if channel.rank == 0:
        announce_compiling()
    ready = time.perf_counter()
    return channel, {"interpreter": max(0.0, age - (began - reached)), "imports": began - reached, "mpi": ready - began}


def _process_age() -> float:
    """Seconds since this process began, to 0.01; 0 where the system does not tell (it is Linux that does)."""
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):
        return 0.0


def _check_outputs(output: Path, *reports: Path | None) -> None:
    """Find out before hours of work what would fail after them."""
    check_writable(output)
    check_reports(*reports)


def check_reports(*reports: Path | None) -> None:
    """The same for files that may or may not be asked for."""
    for report in filter(None, reports):
        check_replaceable(report)


def _writer(output: Path) -> Callable[[Any, Scene, int], None]:
    return lambda image, scene, number: write_image(
        output, image, background_rgb(scene.image.background), picture_metadata(scene)
    )


def slowest_of(startups: list[dict[str, float]]) -> dict[str, float]:
    """The seconds of each part of the start on the rank that took longest."""
    return {name: max(startup[name] for startup in startups) for name in startups[0]}


def write_statistics(path: Path, scene: Scene, frames: list[FrameStatistics], startup: dict[str, float]) -> None:
    """Write what each rank did in each frame."""
    report = statistics_file(scene.model_dump(mode="json"), frames, startup)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n")
