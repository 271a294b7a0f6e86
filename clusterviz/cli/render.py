"""`clusterviz render`: render one picture of a scene or a data file, on all ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
from clusterviz.cli.console import Verbosity, print_info, show_progress, verbosity
from clusterviz.cli.instrumentation import (
    Tracing,
    check_reports,
    print_cost_table,
    slowest_startup,
    start,
    write_statistics,
)
from clusterviz.comm import agree
from clusterviz.content.summary import chosen_arrays, scene_summary
from clusterviz.data import open_scene
from clusterviz.frame import STEPS, Options, render_frame
from clusterviz.frame.picture_file import write_picture
from clusterviz.image.files import check_writable


def command(
    context: typer.Context,
    scene: SceneArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="The picture: .png, .jpg, .gif, .npy, .npz or .exr.")
    ],
    define: Define = None,
    preset: PresetOption = None,
    size: Size = None,
    layers: LayersOption = None,
    annotate: AnnotateOption = False,
    stats: Annotated[Path | None, typer.Option(metavar="F.json", help="Write what each rank did as JSON.")] = None,
    trace: Annotated[Path | None, typer.Option(metavar="F.json", help="Write a trace for Perfetto.")] = None,
    check: Annotated[
        bool,
        typer.Option("--check", help="Check that each brick is drawn once; composite again, serially, and compare."),
    ] = False,
    device: DeviceOption = None,
) -> None:
    """Render a scene or a data file into a picture; under mpirun, on all ranks."""
    channel, startup = start()
    with agree(channel, 0, "scene"):
        opened, device_choice = open_scene(scene, overrides_of(define, size, layers), preset), parse_device(device)
        opened = with_annotations(opened) if annotate else opened
    with agree(channel, 0, "output"):
        if channel.rank == 0:
            check_writable(output, bool(opened.image.layers))
            check_reports(stats, trace)
    tracing = Tracing(channel, trace)
    with show_progress(STEPS if channel.rank == 0 else (), per_step=True) as progress:
        write = lambda image, scene, made: write_picture(output, image, scene, made)  # noqa: E731
        options = Options(device_choice, check, context.obj["debug"], progress, write, bool(trace), annotate=True)
        rendered = render_frame(opened, channel, options=options)
    tracing.add(rendered.spans)
    tracing.write()
    slowest = slowest_startup(channel.allgather(startup))
    with agree(channel, 0, "statistics"):
        if stats and channel.rank == 0:
            write_statistics(stats, rendered.scene, [rendered.statistics], slowest)
    if channel.rank == 0 and verbosity() is not Verbosity.QUIET:
        print_cost_table(rendered.statistics, slowest)
        print_info(f"shown      {scene_summary(rendered.scene)}")
        for line in chosen_arrays(opened, rendered.scene):
            print_info(f"array      {line}")
        print_info(f"\nthe picture is {output}" + (f", its numbers are in {stats}" if stats else ""))
