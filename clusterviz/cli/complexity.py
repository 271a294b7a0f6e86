"""`clusterviz complexity`: count the fragments of meshes, lines and points at each pixel, and write a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clusterviz.cli.animate import fit_to_orbit, frame_count
from clusterviz.cli.arguments import Define, DeviceOption, SceneArgument, Size, overrides_of, parse_device
from clusterviz.cli.console import show_progress
from clusterviz.cli.instrumentation import start
from clusterviz.cli.reporting import AsNumbers, Output, check_report, print_report, write_report
from clusterviz.comm import agree
from clusterviz.data import open_scene
from clusterviz.errors import InputError, public_address
from clusterviz.pages.complexity.measure import Report, measure
from clusterviz.pages.complexity.page import KIND, as_json, write_files


def command(
    scene: SceneArgument,
    output: Output,
    orbit: Annotated[
        float | None, typer.Option(metavar="DEGREES", help="Turn about the focal point, round view_up.")
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Number of frames of the orbit.")] = None,
    define: Define = None,
    size: Size = None,
    device: DeviceOption = None,
    as_numbers: AsNumbers = False,
) -> None:
    """Count the fragments of meshes, lines, points and flows at each pixel; under mpirun, on all ranks."""
    channel, _ = start()
    with agree(channel, 0, "scene"):
        if orbit is None and frames is not None:
            raise InputError("nothing moves", where="--frames", found=frames, allowed="--orbit DEGREES beside it")
        count = 1 if orbit is None else frame_count(orbit, None, frames, 1.0, "")
        opened, device_choice = open_scene(scene, overrides_of(define, size)), parse_device(device)
        if not opened.geometry and all(flow.show in ("lic", "surface-lic") for flow in opened.flows):
            where, allowed = f"{scene}: meshes, lines, points", "a scene with one of them, or lines or arrows of flows"
            raise InputError("nothing to count", where=where, allowed=allowed)
        opened = opened if orbit is None else fit_to_orbit(opened)
    with agree(channel, 0, "output"):
        if channel.rank == 0:
            check_report(output, KIND)
    names = [f"frame {number + 1} of {count}" for number in range(count)]
    with show_progress(names if channel.rank == 0 else ()) as progress:
        report = measure(opened, channel, device_choice, (orbit, count), progress)
    with agree(channel, count, "write"):
        if report is not None:
            write_report(output, KIND, lambda folder: write_files(folder, Path(public_address(scene)).name, report))
    if report is None:
        return
    print_report(output, KIND, summary(report), as_json(report) if as_numbers else None)


def summary(report: Report) -> str:
    """Return the depth complexity of the first frame in a few lines."""
    first = report.frames[0]
    memory = ", ".join(f"{name} {size / 2**20:.1f} MiB" for name, size in first.fill_bytes.items())
    shares = ", ".join(f"{size}: {count / max(1, first.covered):.1%}" for size, count in first.classes.items())
    return (
        f"fragments  {first.fragments:,}, at most {first.maximum:,} and on average {first.mean:.1f} at "
        f"{first.covered:,} of {first.pixels:,} pixels\nclasses    {shares}\nmemory     {memory}"
    )
