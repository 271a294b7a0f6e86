"""`clusterviz kbuffer`: survey the entries that k-buffers of an unstructured grid need, and write a page."""

from __future__ import annotations

from pathlib import Path

from clusterviz.cli.arguments import Define, DeviceOption, SceneArgument, Size, overrides_of, parse_device
from clusterviz.cli.console import show_progress
from clusterviz.cli.jobs import refuse_launcher
from clusterviz.cli.reporting import AsNumbers, Output, check_report, print_report, write_report
from clusterviz.data import open_scene
from clusterviz.errors import InputError, public_address
from clusterviz.pages.kbuffer.measure import Report, measure, steps
from clusterviz.pages.kbuffer.page import KIND, as_json, write_files


def command(
    scene: SceneArgument,
    output: Output,
    define: Define = None,
    size: Size = None,
    device: DeviceOption = None,
    as_numbers: AsNumbers = False,
) -> None:
    """Survey k-buffers of an unstructured grid from 14 sides: entries, wrong pixels, comparisons and time."""
    refuse_launcher("kbuffer", "draws all views by itself")
    opened, device_choice = open_scene(scene, overrides_of(define, size)), parse_device(device)
    if len(opened.grids) != 1 or opened.volumes or opened.geometry:
        allowed = "a scene of one unstructured grid, and nothing else"
        raise InputError("no k-buffer draws it", where=f"{scene}: grids", found=len(opened.grids), allowed=allowed)
    check_report(output, KIND)
    with show_progress([*steps(), "write"]) as progress:
        report = measure(opened, device_choice, progress)
        progress("write")
        write_report(output, KIND, lambda folder: write_files(folder, Path(public_address(scene)).name, report))
    print_report(output, KIND, summary(report), as_json(report) if as_numbers else None)


def summary(report: Report) -> str:
    """Return the survey in a few lines."""
    wrong = ", ".join(f"{k}: {pixels:,}" for k, pixels in report.wrong.items())
    longest = max(int(view.needs.fragments.max()) for view in report.views)
    exact, *buffers, _ = report.drawings
    lines = [f"grid       {report.tetrahedra:,} tetrahedra, {report.faces:,} faces; a ray meets {longest:,} at most"]
    lines += [f"wrong      pixels of {len(report.views)} views by k: {wrong}"]
    lines += [f"exact      {1e3 * exact.cpu_seconds:.1f} ms of CPU time a frame"]
    for entries in ("sorted", "unsorted"):
        own = ", ".join(f"{each.k}: {1e3 * each.cpu_seconds:.1f}" for each in buffers if each.entries == entries)
        lines.append(f"{entries:10} ms by k: {own}")
    return "\n".join(lines)
