"""`clusterviz trace`: lines of a flow as a VTP file, and its critical points as a table, on all ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clusterviz.cli.arguments import Define
from clusterviz.cli.console import print_info
from clusterviz.cli.instrumentation import check_reports, start
from clusterviz.comm import agree
from clusterviz.content.flow.kind import FLOW
from clusterviz.content.flow.section import LINES, FlowSection, Seeds
from clusterviz.content.table import first_of
from clusterviz.data.formats import grid_format_of
from clusterviz.data.formats.vtp import write_vtp
from clusterviz.data.vectors import open_vectors
from clusterviz.errors import InputError, OutputError
from clusterviz.flow.cells import open_cells
from clusterviz.flow.critical_points import CriticalPoints, find_critical_points
from clusterviz.flow.tracing import trace
from clusterviz.scene.files import load_scene, scene_of_data

SHOWN = 20
"""Critical points that are printed."""


def command(
    file: Annotated[
        str, typer.Argument(metavar="SCENE", help="A data file with vectors, or a scene file, of which the first flow.")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="LINES.vtp", help="VTK's polygonal data, for the lines.")
    ] = None,
    critical_points: Annotated[
        Path | None, typer.Option(metavar="POINTS.csv", help="Table of the critical points and their types.")
    ] = None,
    define: Define = None,
) -> None:
    """Trace lines of a flow into a VTP file, or find its critical points; under mpirun, on all ranks.

    Settings are the keys of `flows`: -D show=pathlines, -D seeds.count=500, -D trace.max_length=10.
    """
    ranks, _ = start()
    with agree(ranks, 0, "trace"):
        if output is None and critical_points is None:
            raise InputError("nothing to do", where="clusterviz trace", allowed="-o, --critical-points, or both")
        for path, suffix in ((output, ".vtp"), (critical_points, ".csv")):
            if path is not None and path.suffix.lower() != suffix:
                raise OutputError("not a name of its file", where=str(path), found=path.name, allowed=f"a {suffix}")
        check_reports(output, critical_points)
        flow = _flow(file, define or [])
        opened = open_cells if grid_format_of(Path(flow.path)) else open_vectors
        vectors = opened(flow.path, flow.array, flow.time, flow.order, flow.scale)
    if output is not None:
        kind = flow.show if flow.show in LINES else "streamlines"
        seeds = flow.seeds or Seeds()
        traced = trace(vectors, seeds, flow.trace, kind, channel=ranks, first_step=flow.time)  # type: ignore[arg-type]
        with agree(ranks, 0, "write"):
            if ranks.rank == 0:
                write_vtp(output, traced.lines)
                print_info(traced.summary)
    if critical_points is not None:
        found = find_critical_points(vectors, ranks)
        with agree(ranks, 0, "write"):
            if ranks.rank == 0:
                found.write(critical_points)
                print_info(_table(found))


def _flow(file: str, define: list[str]) -> FlowSection:
    if not file.lower().endswith((".yaml", ".yml", ".json")):
        scene = scene_of_data(file, define, (FLOW.name,), ({"show": "streamlines"},))
    else:
        scene = load_scene(file, define)
    flow: FlowSection | None = first_of(FLOW, scene)
    if flow is None:
        raise InputError("no flow", where=f"{file}: flows", found="none", allowed="a scene with flows")
    return flow


def _table(found: CriticalPoints) -> str:
    lines = [found.summary]
    for place, kind in list(zip(found.positions.tolist(), found.types, strict=True))[:SHOWN]:
        lines.append(f"  {kind:17} " + " ".join(f"{number:12.6g}" for number in place))
    more = len(found.types) - SHOWN
    return "\n".join([*lines, *([f"  … and {more} more"] if more > 0 else [])])
