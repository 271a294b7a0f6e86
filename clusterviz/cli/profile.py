"""`clusterviz profile`: measure what each pixel and each line of the shader costs, and write a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clusterviz.cli.arguments import Define, SceneArgument, Size, overrides_of
from clusterviz.cli.console import show_progress
from clusterviz.cli.jobs import refuse_launcher
from clusterviz.cli.reporting import AsNumbers, Output, check_report, print_report, write_report
from clusterviz.data import open_scene
from clusterviz.errors import InputError, SceneError, public_address
from clusterviz.gl.devices import prefers_cpu
from clusterviz.pages.profile.measure import Report, measure
from clusterviz.pages.profile.page import KIND, as_json, write_files

BY = "cpu", "gl"


def command(
    scene: SceneArgument,
    output: Output,
    ranks: Annotated[
        int, typer.Option(min=1, max=1024, help="Number of ranks among which bricks are divided; drawn in turn.")
    ] = 1,
    by: Annotated[
        str | None, typer.Option(metavar="cpu|gl", help="What draws; default: OpenGL if there is a GPU.")
    ] = None,
    define: Define = None,
    size: Size = None,
    as_numbers: AsNumbers = False,
) -> None:
    """Show what each pixel costs, and on CPUs each line of the shader."""
    refuse_launcher("profile", "draws all ranks by itself")
    if by not in (None, *BY):
        raise InputError("nothing that draws", where="--by", found=by, allowed=" or ".join(BY))
    opened = open_scene(scene, overrides_of(define, size))
    if not opened.has_content:
        raise SceneError("nothing to draw", where=scene, allowed="a scene with content")
    check_report(output, KIND)
    steps = ("read", "compile", *(f"rank {rank}" for rank in range(ranks)), "write")
    with show_progress(steps) as progress:
        report = measure(opened, ranks, prefers_cpu() if by is None else by == "cpu", progress)
        progress("write")
        write_report(output, KIND, lambda folder: write_files(folder, Path(public_address(scene)).name, report))
    print_report(output, KIND, summary(report), as_json(report) if as_numbers else None)


def summary(report: Report) -> str:
    """Return the profile in a few lines."""
    totals, memory = report.whole.totals, report.whole.memory
    lines = [
        f"slabs      {totals['slabs']:,}: {totals['covered']:,} sampled, {totals['skipped']:,} skipped, "
        f"{totals['left_out']:,} left out behind what is opaque",
        f"samples    {totals['samples']:,} in {totals['runs']:,} runs",
        f"memory     {memory['bricks_sampled']:,} of {report.whole.bricks:,} bricks, "
        f"{memory['bytes_sampled'] / 2**20:.2f} MiB, each fetched {memory['times_fetched']:.1f} times",
    ]
    if totals["fragments"]:
        lines.append(f"fragments  {totals['fragments']:,} of meshes, lines and points")
    if report.code:
        lines += [
            f"time       {1e3 * report.code.seconds:.1f} ms of one thread, {report.code.idle:.1%} of the lanes idle, "
            f"{report.code.ideal:.1%} of it for samples without idle lanes",
            *(f"           {one.share:6.1%}  {one.name}" for one in report.code.lines[:3]),
        ]
    return "\n".join(lines)
