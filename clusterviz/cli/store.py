"""`clusterviz store`: write a volume as OME-Zarr with levels and compressed bricks, on all ranks."""

from __future__ import annotations

import json as json_text
import math
from contextlib import AbstractContextManager
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from clusterviz.cli.console import print_info, show_progress
from clusterviz.cli.instrumentation import start
from clusterviz.comm import abort_on_failure, agree
from clusterviz.data import open_source
from clusterviz.data.axes import Subset
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import StoreWriter, write_store
from clusterviz.errors import OutputError


def command(
    file: Annotated[str, typer.Argument(metavar="IN", help="A volume of any format that can be read.")],
    output: Annotated[Path, typer.Argument(metavar="OUT.ome.zarr", help="The store, a folder.")],
    codec: Annotated[
        str, typer.Option(help="wavelet, or zstd, which other programs read without clusterviz.")
    ] = "wavelet",
    error: Annotated[float, typer.Option(help="Largest error of a sample; 0: bit for bit.", min=0.0)] = 0.0,
    brick: Annotated[int, typer.Option(help="Samples along the side of a brick.", min=8, max=512)] = 64,
    effort: Annotated[int, typer.Option(help="Level of zstd: 1 fast, 19 small.", min=1, max=22)] = 1,
    array: Annotated[str | None, typer.Option(help="Which array, for files with several.")] = None,
    time: Annotated[int | None, typer.Option(help="Which time step, from 0.", min=0)] = None,
    channel: Annotated[str | None, typer.Option(help="Which channel, by number or name.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write a volume as OME-Zarr with levels and compressed bricks; under mpirun, on all ranks.

    A store that was half written is continued by the same command.
    """
    ranks, _ = start()
    began = perf_counter()
    with agree(ranks, 0, "store"):
        if not output.name.endswith(".zarr"):
            raise OutputError("not a name of a store", where=str(output), found=output.name, allowed="OUT.ome.zarr")
        packing = BrickCodec(codec, error, effort)
        source = open_source(file, subset=Subset(array, time, channel))
        levels = range(len(StoreWriter(source, output, packing, brick).arrays))
        steps = [*(f"level {n}" for n in levels), "statistics"]

    def together(stage: str) -> AbstractContextManager[None]:
        return (abort_on_failure if stage == "statistics" else agree)(ranks, 0, stage)

    with show_progress(steps if ranks.rank == 0 else (), [*(0.125**n for n in levels), 0.2]) as progress:
        writer = write_store(
            source, output, packing, brick, ranks.rank, ranks.size, together, ranks.allgather, progress
        )
    if ranks.rank == 0:
        found = describe(writer, perf_counter() - began)
        print(json_text.dumps(found, indent=2)) if json else print_info(_text(found))


def describe(writer: StoreWriter, seconds: float) -> dict[str, Any]:
    """Return what was written, as JSON values."""
    levels = [
        {
            "shape_zyx": list(array.shape_zyx),
            "bricks": math.prod(array.counts_zyx),
            "bytes": math.prod(array.shape_zyx) * array.dtype.itemsize,
            "stored_bytes": sum(file.stat().st_size for file in (array.path / "c").rglob("*") if file.is_file()),
            "error": float(array.statistics()[2].max()),
        }
        for array in writer.arrays
    ]
    return {"path": str(writer.path), "codec": writer.codec.name, "levels": levels, "seconds": seconds}


def _text(found: dict[str, Any]) -> str:
    lines = []
    for n, level in enumerate(found["levels"]):
        size = " × ".join(map(str, level["shape_zyx"][::-1]))
        share = 100 * level["stored_bytes"] / level["bytes"]
        stored = f"{level['stored_bytes'] / 2**20:.1f} MiB, {share:.1f} % of its samples"
        lines.append(f"level {n}: {size}, {level['bricks']} bricks, {stored}, error at most {level['error']:g}")
    rate = found["levels"][0]["bytes"] / found["seconds"] / 1e6
    return "\n".join([*lines, f"the store is {found['path']}: {found['seconds']:.1f} s, {rate:.0f} MB/s"])
