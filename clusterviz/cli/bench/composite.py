"""`clusterviz bench composite`: time to composite given images.

Rank r reads `DIR/img_<r>.rgba`: raw RGBA8, premultiplied, width · height pixels, rank 0 in front. The bounding box of
its visible pixels is its partial image. A frame is timed from a barrier until the picture is complete on rank 0, on the
slowest rank. With shared memory, images are in it before the time starts, as after a renderer's readback; `--copy`
includes the copy into it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from clusterviz.cli.arguments import Frames, parse_size
from clusterviz.cli.bench.report import JsonOption, write_json
from clusterviz.comm import Channel, ThrottledChannel, abort_on_failure, agree, limit_threads, open_channel
from clusterviz.composite import CompositeCounters, Compositor, compile_kernels
from clusterviz.composite.model.network import default_network
from clusterviz.errors import DataError
from clusterviz.image import PartialImage, Rect
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.input_files import require_regular_file


@dataclass(frozen=True)
class Timings:
    milliseconds: list[float]  # time of each frame on the slowest rank
    counters: list[CompositeCounters]  # counters of the last frame; index = rank
    picture: NDArray[Any] | None  # uint8 (h, w, 4), premultiplied, on rank 0; None on others


def command(
    context: typer.Context,
    images: Annotated[Path, typer.Option(metavar="DIR", help="Folder with img_<rank>.rgba: raw RGBA8, premultiplied.")],
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height of every image.")],
    algorithm: Annotated[str, typer.Option(metavar="A", help="Compositing algorithm.")] = "auto",
    codec: Annotated[str, typer.Option(metavar="C", help="Codec of pixels.")] = "auto",
    transport: Annotated[str, typer.Option(metavar="T", help="Transport of pixels.")] = "auto",
    copy: Annotated[bool, typer.Option("--copy", help="Time the writing of images into shared memory too.")] = False,
    link: Annotated[
        float | None, typer.Option("--link-gbit", metavar="G", min=1e-3, help="Slow each rank's link to G Gb/s.")
    ] = None,
    frames: Frames = 20,
    out: Annotated[Path | None, typer.Option(metavar="F.rgba", help="Write the picture, raw RGBA8.")] = None,
    json: JsonOption = None,
) -> None:
    """Measure compositing of given images on the ranks of an mpirun."""
    channel: Channel = open_channel()
    limit_threads(channel.placement())
    if link:
        channel = ThrottledChannel(channel, link * 1e9 / 8)
    with agree(channel, 0, "options"):
        shape = parse_size(size)
        for path in (out, json):
            if path and channel.rank == 0:
                check_replaceable(path)
    network = default_network(len(channel.nodes()))
    if link:
        # The time model and the choice of codecs use the throttled link.
        network = replace(network, seconds_per_byte=8e-9 / link, node_seconds_per_byte=8e-9 / link)
    compositor = Compositor(channel, shape, algorithm=algorithm, codec=codec, transport=transport, network=network)
    with agree(channel, 0, "read"):
        partial = visible_box(read_rgba(images / f"img_{channel.rank}.rgba", shape))
    with abort_on_failure(channel, 0, "composite", context.obj["debug"]):
        timed = measure(partial, channel, compositor, frames, copy)
    report = _report(timed, shape)
    with agree(channel, 0, "write"):
        if timed.picture is not None:
            _write(report, timed.picture, out, json)


def read_rgba(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read a raw picture, uint8 (h, w, 4). Raises DataError: the file is missing or has the wrong size."""
    require_regular_file(path, DataError)
    try:
        pixels = np.fromfile(path, np.uint8)
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", where=str(path)) from None
    if pixels.size != 4 * size[0] * size[1]:
        raise DataError(
            "not the size of the picture", where=str(path), found=f"{pixels.size} bytes", allowed=4 * size[0] * size[1]
        )
    return pixels.reshape(size[1], size[0], 4)


def visible_box(rgba: NDArray[np.uint8]) -> PartialImage:
    """Return the bounding rectangle of all pixels that are not transparent."""
    rows, columns = (np.flatnonzero(rgba[..., 3].any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return PartialImage(Rect(0, 0, 0, 0), rgba[:0, :0])
    rect = Rect(int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    box = rgba[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end]
    return PartialImage(rect, np.ascontiguousarray(box))


def measure(
    partial: PartialImage, channel: Channel, compositor: Compositor, frames: int, copy: bool = False
) -> Timings:
    """Composite the ranks' images several times, after two warm-up frames; collective."""
    compile_kernels(channel)
    order = list(range(channel.size))
    out, _ = compositor.composite(partial, order)
    if not copy:
        memory = compositor.image(partial.rect, partial.rgba.dtype)
        np.copyto(memory, partial.rgba)
        partial = PartialImage(partial.rect, memory)
    seconds = []
    for _ in range(frames + 1):
        channel.barrier()
        started = perf_counter()
        picture, counters = compositor.composite(partial, order, out)
        seconds.append(perf_counter() - started)
    by_rank = np.array(channel.allgather(seconds[1:]))
    counters_by_rank = channel.allgather(counters)
    return Timings((1e3 * by_rank.max(axis=0)).tolist(), counters_by_rank, picture)


def _report(timed: Timings, size: tuple[int, int]) -> dict[str, Any]:
    totals = [counters.total for counters in timed.counters]
    first = timed.counters[0]
    return {
        "algorithm": first.algorithm,
        "codec": first.codec,
        "transport": first.transport,
        "ranks": len(totals),
        "size": list(size),
        "frames": len(timed.milliseconds),
        "median_ms": median(timed.milliseconds),
        "min_ms": min(timed.milliseconds),
        "predicted_ms": 1e3 * first.seconds_predicted,
        "messages_sent": [total.messages_sent for total in totals],
        "bytes_raw": [total.bytes_raw for total in totals],
        "bytes_sent": [total.bytes_sent for total in totals],
        "bytes_collected": [counters.bytes_collected for counters in timed.counters],
        "seconds": [
            {
                "agree": counters.seconds_agree,
                "encode": total.seconds_encode,
                "wait": total.seconds_wait,
                "blend": total.seconds_blend,
                "collect": counters.seconds_collect,
            }
            for counters, total in zip(timed.counters, totals, strict=True)
        ],
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
