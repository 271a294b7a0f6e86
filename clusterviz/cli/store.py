"""`clusterviz store`: write a volume as OME-Zarr with levels and compressed bricks, on all ranks."""

from __future__ import annotations

import json as json_text
import math
from contextlib import AbstractContextManager
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer

from clusterviz.cli.console import print_info, show_progress
from clusterviz.cli.instrumentation import start
from clusterviz.comm import abort_on_failure, agree
from clusterviz.data import open_source
from clusterviz.data.axes import Subset
from clusterviz.data.series import open_series
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import StoreWriter, write_store
from clusterviz.errors import InputError, OutputError


def command(
    files: Annotated[
        list[str], typer.Argument(metavar="IN…", help="Volumes of any format that can be read, or patterns of names.")
    ],
    output: Annotated[Path, typer.Argument(metavar="OUT.ome.zarr", help="The store, a folder.")],
    codec: Annotated[
        str, typer.Option(help="wavelet; zstd or zfp, which other programs read without clusterviz.")
    ] = "wavelet",
    error: Annotated[float, typer.Option(help="Largest error of a sample; 0: bit for bit.", min=0.0)] = 0.0,
    brick: Annotated[int, typer.Option(help="Samples along the side of a brick.", min=8, max=512)] = 64,
    effort: Annotated[int, typer.Option(help="Level of zstd: 1 fast, 19 small.", min=1, max=22)] = 1,
    along: Annotated[str, typer.Option("--as", metavar="time|channels", help="What several files are.")] = "time",
    array: Annotated[str | None, typer.Option(help="Which array, for files with several.")] = None,
    time: Annotated[int | None, typer.Option(help="Which time step, from 0; default: all.", min=0)] = None,
    channel: Annotated[str | None, typer.Option(help="Which channel, by number or name; default: all.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write volumes as OME-Zarr with levels and compressed bricks; under mpirun, on all ranks.

    Several files are time steps, or channels. A store that was half written is continued by the same command.
    """
    ranks, _ = start()
    began = perf_counter()
    with agree(ranks, 0, "store"):
        if not output.name.endswith(".zarr"):
            raise OutputError("not a name of a store", where=str(output), found=output.name, allowed="OUT.ome.zarr")
        packing = BrickCodec(codec, error, effort)
        if along not in ("time", "channels"):
            raise InputError("not what files can be", where="--as", found=along, allowed="time, channels")
        opener = lambda name, subset: open_source(name, subset=subset)  # noqa: E731
        series = open_series(files, along, Subset(array, time, channel), opener)
        levels = range(len(StoreWriter(series.sources[0], output, packing, brick).arrays))
        steps = [
            f"{label}{step}" for label in series.labels for step in (*(f"level {n}" for n in levels), "statistics")
        ]
        weights = [weight for _ in series.labels for weight in (*(0.125**n for n in levels), 0.2)]

    def together(stage: str) -> AbstractContextManager[None]:
        return (abort_on_failure if stage == "statistics" else agree)(ranks, 0, stage)

    with show_progress(steps if ranks.rank == 0 else (), weights) as progress:
        writer = write_store(
            series, output, packing, brick, ranks.rank, ranks.size, together, ranks.allgather, progress
        )
    if ranks.rank == 0:
        found = describe(writer, perf_counter() - began)
        print(json_text.dumps(found, indent=2)) if json else print_info(_text(found))


def describe(writer: StoreWriter, seconds: float) -> dict[str, Any]:
    """Return what was written, as JSON values."""
    levels = []
    for array in writer.arrays:
        volumes = [array.at(*index) for index in np.ndindex(array.counts)]
        levels.append(
            {
                "shape_zyx": list(array.shape_zyx),
                "bricks": math.prod(array.counts_zyx) * len(volumes),
                "references": sum(int((each.steps() != each.step).sum()) for each in volumes),
                "bytes": math.prod(array.shape_zyx) * array.dtype.itemsize * len(volumes),
                "stored_bytes": sum(file.stat().st_size for file in (array.path / "c").rglob("*") if file.is_file()),
                "error": max(float(each.statistics()[2].max()) for each in volumes),
            }
        )
    series = writer.series
    counts = dict(zip(series.axes, series.counts, strict=True)) if series else {}
    found = {"path": str(writer.path), "codec": writer.codec.name, "levels": levels, "seconds": seconds}
    return found | {"time_steps": counts.get("t", 1), "channels": list(series.channels) if series else []}


def _text(found: dict[str, Any]) -> str:
    lines = [f"{found['time_steps']} time steps"] if found["time_steps"] > 1 else []
    lines += [f"channels: {', '.join(found['channels'])}"] if found["channels"] else []
    for n, level in enumerate(found["levels"]):
        size = " × ".join(map(str, level["shape_zyx"][::-1]))
        share = 100 * level["stored_bytes"] / level["bytes"]
        stored = f"{level['stored_bytes'] / 2**20:.1f} MiB, {share:.1f} % of its samples"
        same = f" ({level['references']} as in the time step before)" if found["time_steps"] > 1 else ""
        lines.append(f"level {n}: {size}, {level['bricks']} bricks{same}, {stored}, error at most {level['error']:g}")
    rate = found["levels"][0]["bytes"] / found["seconds"] / 1e6
    return "\n".join([*lines, f"the store is {found['path']}: {found['seconds']:.1f} s, {rate:.0f} MB/s"])
