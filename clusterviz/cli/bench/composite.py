"""`clusterviz bench composite`: how long the ranks take from their images to one picture.

Rank r reads `DIR/img_<r>.rgba`: raw RGBA8, premultiplied, width · height pixels, rank 0 in front. A frame is timed from
a barrier until the picture is whole on rank 0, by the slowest rank.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from clusterviz.cli.arguments import parse_size
from clusterviz.cli.bench.report import Frames, JsonOption, write_json
from clusterviz.codec import choose_codec
from clusterviz.comm import Channel, abort_on_failure, agree, limit_threads, open_channel
from clusterviz.composite import CompositeCounters, choose_algorithm, collect, compile_kernels, composite
from clusterviz.errors import DataError, InputError
from clusterviz.image import PartialImage, Rect
from clusterviz.image.replace import check_replaceable, replacing

TRANSPORTS = ("auto", "messages")


@dataclass(frozen=True)
class Timed:
    """What the frames gave.

    Attributes
    ----------
    milliseconds : of each frame, of the slowest rank
    counters : of the last frame, by rank
    picture : uint8 (h, w, 4), premultiplied, on rank 0; None elsewhere
    """

    milliseconds: list[float]
    counters: list[CompositeCounters]
    picture: NDArray[Any] | None


def command(
    context: typer.Context,
    images: Annotated[Path, typer.Option(metavar="DIR", help="Where img_<rank>.rgba are: raw RGBA8, premultiplied.")],
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height of every image.")],
    algorithm: Annotated[str, typer.Option(metavar="A", help="Compositing algorithm.")] = "auto",
    codec: Annotated[str, typer.Option(metavar="C", help="How pixels are packed.")] = "auto",
    transport: Annotated[str, typer.Option(metavar="T", help="How pixels travel.")] = "auto",
    frames: Frames = 20,
    out: Annotated[Path | None, typer.Option(metavar="F.rgba", help="Write the picture, raw RGBA8.")] = None,
    json: JsonOption = None,
) -> None:
    """Measure compositing of given images on the ranks of an mpirun."""
    channel = open_channel()
    limit_threads(channel.place())
    with agree(channel, 0, "options"):
        shape = parse_size(size)
        choose_algorithm(algorithm, channel.size)
        choose_codec(codec)
        if transport not in TRANSPORTS:
            raise InputError("unknown transport", where="--transport", found=transport, allowed=", ".join(TRANSPORTS))
        for path in (out, json):
            if path and channel.rank == 0:
                check_replaceable(path)
    with agree(channel, 0, "read"):
        partial = PartialImage(Rect(0, 0, *shape), read_rgba(images / f"img_{channel.rank}.rgba", shape))
    with abort_on_failure(channel, 0, "composite", context.obj["debug"]):
        timed = measure(partial, channel, algorithm, codec, frames)
    report = _report(timed, shape, transport if transport != "auto" else "messages")
    with agree(channel, 0, "write"):
        if timed.picture is not None:
            _write(report, timed.picture, out, json)


def read_rgba(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """A raw picture, uint8 (h, w, 4).

    Raises
    ------
    DataError
        Missing, or not as large as it should be.
    """
    try:
        pixels = np.fromfile(path, np.uint8)
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", where=str(path)) from None
    if pixels.size != 4 * size[0] * size[1]:
        raise DataError(
            "not the size of the picture", where=str(path), found=f"{pixels.size} bytes", allowed=4 * size[0] * size[1]
        )
    return pixels.reshape(size[1], size[0], 4)


def measure(partial: PartialImage, channel: Channel, algorithm: str, codec: str, frames: int) -> Timed:
    """Composite the ranks' images several times, after once that is not timed; collective."""
    compile_kernels(channel)
    order, size = list(range(channel.size)), (partial.rect.width, partial.rect.height)
    seconds = []
    for _ in range(frames + 1):
        channel.barrier()
        started = perf_counter()
        piece, counters = composite(partial, order, channel, algorithm, codec)
        picture = collect(piece, size, channel)
        seconds.append(perf_counter() - started)
    by_rank = np.array(channel.allgather(seconds[1:]))
    return Timed((1e3 * by_rank.max(axis=0)).tolist(), channel.allgather(counters), picture)


def _report(timed: Timed, size: tuple[int, int], transport: str) -> dict[str, Any]:
    totals = [counters.total for counters in timed.counters]
    return {
        "algorithm": timed.counters[0].algorithm,
        "codec": timed.counters[0].codec,
        "transport": transport,
        "ranks": len(totals),
        "size": list(size),
        "frames": len(timed.milliseconds),
        "median_ms": median(timed.milliseconds),
        "min_ms": min(timed.milliseconds),
        "messages_sent": [total.messages_sent for total in totals],
        "bytes_raw": [total.bytes_raw for total in totals],
        "bytes_sent": [total.bytes_sent for total in totals],
    }


def _write(report: dict[str, Any], picture: NDArray[Any], out: Path | None, json: Path | None) -> None:
    if out:
        with replacing(out) as temporary, temporary.open("wb") as file:
            file.write(np.ascontiguousarray(picture).data)
    if json:
        write_json(json, report)
    chosen = ", ".join(str(report[key]) for key in ("algorithm", "codec", "transport"))
    width, height = report["size"]
    print(f"{chosen}, {report['ranks']} ranks, {width} × {height}, {report['frames']} frames", end=": ")
    print(f"median {report['median_ms']:.2f} ms, min {report['min_ms']:.2f} ms", end=", ")
    print(f"{sum(report['messages_sent'])} messages, {sum(report['bytes_sent']) / 2**20:.2f} MiB", flush=True)
