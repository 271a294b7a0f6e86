"""`clusterviz bench network`: measure the constants of the time model by which compositing algorithms are chosen.

Two ranks of one node, and two of different nodes if there are several, exchange messages from 0 bytes to 16 MiB, and
bursts of small ones. Then as many ranks of each node as it has cores blend and copy at the same time, the ranks of each
node synchronise, and tiny images are composited, which measures the overhead of the program. The constants are stored
in a file that later runs read. Each rank should have a core, since sharing cores disturbs the measured overheads.

The result is the minimum over all repetitions, since other activity of a machine can only add time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import DTypeLike, NDArray

from clusterviz.cli.arguments import Frames
from clusterviz.cli.bench.report import JsonOption, write_json
from clusterviz.comm import Channel, abort_on_failure, agree, limit_threads, open_channel
from clusterviz.comm.placement import granted_cores
from clusterviz.composite import Compositor
from clusterviz.composite.fragment import Patch
from clusterviz.composite.model.fitting import Link, fit_link, fit_program
from clusterviz.composite.model.network import FILE_VARIABLE, Network, open_network, save_network, saved_path
from clusterviz.composite.over.blend import compile_kernels
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.errors import InputError
from clusterviz.image.partial import EMPTY, PartialImage, Rect
from clusterviz.image.replace import check_replaceable

Bytes = NDArray[np.uint8]

SIZES = (0, 64, 1 << 10, 1 << 12, 1 << 14, 1 << 16, 1 << 18, 1 << 20, 1 << 22, 1 << 24)
LARGE_BYTES = 1 << 16  # from this size on, bytes dominate the cost of a message
BURSTS = (1, 2, 4, 8, 16)
BURST_BYTES = 64
ARENA_BYTES = 1 << 26
IMAGE = (1024, 1024)
LAYERS = 4
TINY_SIDE = 16  # width and height of images with negligible cost of pixels
SHORT_REPETITIONS = 5  # factor of the repetitions of short operations
WARM_UP_FRAMES = 3  # frames before timing
COPY_BYTES = 1 << 24
STEPS = 20  # exchanges in one timed call
ANSWER_TAG = 1000


@dataclass(frozen=True)
class LinkTimes:
    """Seconds of each repetition on one link."""

    by_size: dict[int, list[float]]  # bytes -> seconds of one message
    by_swap: dict[int, list[float]]  # bytes of each -> seconds of one message each way at once, as in compositing
    by_count: dict[int, list[float]]  # number -> seconds of a burst of small messages in one direction

    def fit(self) -> Link:
        """Return the constants of this link."""
        by_size, by_count, by_swap = (
            {key: min(found) for key, found in times.items()} for times in (self.by_size, self.by_count, self.by_swap)
        )
        return fit_link(by_size, by_count, by_swap)


def time_link(channel: Channel, pair: Sequence[int], frames: int) -> LinkTimes:
    """Time ping-pong, swaps and bursts between two ranks; all ranks get the times of the first.

    Each repetition covers all sizes and numbers, so that a disturbance affects all of them.
    """
    by_size: dict[int, list[float]] = {size: [] for size in SIZES}
    by_swap: dict[int, list[float]] = {size: [] for size in SIZES if size >= LARGE_BYTES}
    by_count: dict[int, list[float]] = {count: [] for count in BURSTS}
    channel.barrier()
    if channel.rank in pair:
        mine = list(pair).index(channel.rank)
        peer = pair[1 - mine]
        # Messages use memory outside of the caches, as the pixels of a frame do.
        data = [np.ones(ARENA_BYTES, np.uint8) for _ in range(2)]
        for frame in range(frames + 1):
            for size in SIZES:
                begin = frame * size % (ARENA_BYTES - size)
                parts = [memory[begin : begin + size] for memory in data]
                seconds = _ping_pong(channel, peer, mine, parts)
                by_size[size] += [seconds] * (frame > 0)
                if size in by_swap:
                    seconds = _swap(channel, peer, parts)
                    by_swap[size] += [seconds] * (frame > 0)
            for count in BURSTS:
                seconds = _burst(channel, peer, mine, data, count)
                by_count[count] += [seconds] * (frame > 0)
    return channel.broadcast(LinkTimes(by_size, by_swap, by_count), pair[0])


def _ping_pong(channel: Channel, peer: int, is_answering: int, data: Sequence[Bytes]) -> float:
    """Return half the time of a message and an answer of the same size."""
    pending = channel.post_receive(data[1], peer, 0)
    started = perf_counter()
    if is_answering:
        channel.wait_some([pending])
    channel.isend(data[0], peer, 0)
    if not is_answering:
        channel.wait_some([pending])
    channel.wait_sends()
    return (perf_counter() - started) / 2


def _swap(channel: Channel, peer: int, data: Sequence[Bytes]) -> float:
    """Return the time of a message each way at once, after a synchronisation."""
    channel.isend(data[0][:0], peer, ANSWER_TAG)
    channel.wait_some([channel.post_receive(data[1][:0], peer, ANSWER_TAG)])
    channel.wait_sends()
    started = perf_counter()
    pending = channel.post_receive(data[1], peer, 0)
    channel.isend(data[0], peer, 0)
    channel.wait_some([pending])
    channel.wait_sends()
    return perf_counter() - started


def _burst(channel: Channel, peer: int, is_answering: int, data: Sequence[Bytes], count: int) -> float:
    """Return the time of a burst of small messages in one direction and an empty answer."""
    if is_answering:
        parts = np.split(data[1][: count * BURST_BYTES], count)
        waiting = [channel.post_receive(part, peer, tag) for tag, part in enumerate(parts)]
        channel.isend(data[0][:0], peer, ANSWER_TAG)
        while waiting:
            done = {index for index, _ in channel.wait_some(waiting)}
            waiting = [pending for index, pending in enumerate(waiting) if index not in done]
        channel.isend(data[0][:0], peer, ANSWER_TAG)
        channel.wait_sends()
        return 0.0
    channel.wait_some([channel.post_receive(data[1][:0], peer, ANSWER_TAG)])
    pending = channel.post_receive(data[1][:0], peer, ANSWER_TAG)
    started = perf_counter()
    for tag in range(count):
        channel.isend(data[0][:BURST_BYTES], peer, tag)
    channel.wait_some([pending])
    channel.wait_sends()
    return perf_counter() - started


def time_blend(channel: Channel, dtype: DTypeLike, busy: bool, frames: int) -> float:
    """Return seconds per pixel and image when all busy ranks blend four images in one pass at the same time."""
    count = IMAGE[0] * IMAGE[1]
    rng, patch = np.random.default_rng(channel.rank), Patch(IMAGE[0], 0, count, Rect(0, 0, *IMAGE))
    largest = 100 if np.dtype(dtype).kind == "u" else 0.4
    layers = [Layer(patch, (rng.random((count, 4), np.float32) * largest).astype(dtype)) for _ in range(LAYERS)]
    out = np.empty((count, 4), dtype)
    return min(time_calls(channel, lambda: blend_layers(layers, patch, out), busy, frames)) / (count * LAYERS)


def time_copy(channel: Channel, busy: bool, frames: int) -> float:
    """Return seconds per byte when all busy ranks copy at the same time."""
    source, target = np.zeros(COPY_BYTES, np.uint8), np.ones(COPY_BYTES, np.uint8)
    return min(time_calls(channel, lambda: np.copyto(target, source), busy, frames)) / COPY_BYTES


def time_step(channel: Channel, frames: int) -> float:
    """Return seconds of an exchange of small numbers through a node's shared memory, on all nodes at once."""
    window = channel.window(0)
    numbers = np.zeros(4, np.int64)

    def steps() -> None:
        for _ in range(STEPS):
            window.exchange(numbers)

    seconds = min(time_calls(channel, steps, True, SHORT_REPETITIONS * frames)) / STEPS
    window.free()
    return seconds


def time_tiny(channel: Channel, ranks: int, frames: int) -> float:
    """Return seconds of direct-send compositing of tiny images by messages, on the slowest rank.

    Memory is touched before each frame, as by drawing; with warm caches compositing takes half the time.
    """
    rect = Rect(0, 0, TINY_SIDE, TINY_SIDE) if channel.rank < ranks else EMPTY
    image = PartialImage(rect, np.ones((rect.height, rect.width, 4), np.uint8))
    # A fixed algorithm and network, independent of the constants being measured.
    network = open_network("laptop")
    compositor = Compositor(
        channel, (TINY_SIDE, TINY_SIDE), algorithm="direct-send", codec="raw", transport="messages", network=network
    )
    order = range(channel.size)
    seconds = []
    drawn = np.zeros((2, COPY_BYTES), np.uint8)
    for _ in range(SHORT_REPETITIONS * frames + WARM_UP_FRAMES):
        np.copyto(drawn[0], drawn[1])
        channel.barrier()
        started = perf_counter()
        compositor.composite(image, order)
        seconds.append(perf_counter() - started)
    compositor.close()
    return float(min(map(max, zip(*channel.allgather(seconds[WARM_UP_FRAMES:]), strict=True))))


def time_calls(channel: Channel, call: Callable[[], object], busy: bool, frames: int) -> list[float]:
    """Return the time of each repetition of a call on all busy ranks at once, of the slowest rank."""
    seconds = []
    for _ in range(frames + 1):
        channel.barrier()
        started = perf_counter()
        if busy:
            call()
        seconds.append(perf_counter() - started if busy else 0.0)
    return [max(times) for times in zip(*channel.allgather(seconds[1:]), strict=True)]


INSIDE, BETWEEN = "inside a node", "between nodes"


def command(
    context: typer.Context,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            metavar="F.json",
            help=f"The network file. Default: ${FILE_VARIABLE}, or the file in your configuration folder that later "
            "runs read.",
        ),
    ] = None,
    frames: Frames = 20,
    json: JsonOption = None,
) -> None:
    """Measure the links between the ranks of an mpirun and their blending speed, for the choice of algorithms."""
    channel = open_channel()
    limit_threads(channel.placement())
    path = output or saved_path()
    with agree(channel, 0, "options"):
        if channel.size < 2:
            raise InputError("a network has two ranks and more", found=channel.size, allowed="mpirun -n 2 and more")
        for file in (output, json):
            if file and channel.rank == 0:
                check_replaceable(file)
    with abort_on_failure(channel, 0, "network", context.obj["debug"]):
        network, report = measure(channel, frames)
    with agree(channel, 0, "write"):
        if channel.rank == 0:
            save_network(network, path)
            if json:
                write_json(json, {"constants": asdict(network), **report, "file": str(path), "frames": frames})
            print(*_lines(network, report), f"kept in {path}", sep="\n", flush=True)


def measure(channel: Channel, frames: int) -> tuple[Network, dict[str, Any]]:
    """Return the constants, the same on every rank, and the report of the measurements; collective."""
    compile_kernels(channel)
    nodes, cores = channel.nodes(), _cores(channel)
    times = {name: time_link(channel, pair, frames) for name, pair in _pairs(nodes).items()}
    links = {name: found.fit() for name, found in times.items()}
    inside = links.get(INSIDE) or links[BETWEEN]
    between = links.get(BETWEEN) or inside
    # As many ranks of each node as it has cores.
    busy = any(channel.rank in ranks[:cores] for ranks in nodes)
    ranks = max(map(len, nodes))
    step, others = time_step(channel, frames), ranks / min(cores, ranks) - 1
    laptop = open_network("laptop")
    plain = Network(
        name=f"measured on {channel.broadcast(channel.placement().host)}",
        source=f"clusterviz bench network on {datetime.now(UTC):%Y-%m-%d}; {channel.size} ranks on {len(nodes)} "
        f"{'nodes' if len(nodes) > 1 else 'node'} of {cores} cores; {frames} repetitions",
        latency_seconds=between.latency_seconds,
        overhead_seconds=between.overhead_seconds,
        seconds_per_byte=between.seconds_per_byte,
        seconds_per_pixel=time_blend(channel, np.uint8, busy, frames),
        node_latency_seconds=inside.latency_seconds,
        node_overhead_seconds=inside.overhead_seconds,
        node_seconds_per_byte=inside.seconds_per_byte,
        seconds_per_float_pixel=time_blend(channel, np.float32, busy, frames),
        copy_seconds_per_byte=time_copy(channel, busy, frames),
        # Only one of the two can be measured; the other is taken from the network file "laptop" of the package.
        barrier_seconds=step if not others else laptop.barrier_seconds,
        turn_seconds=step / others if others else laptop.turn_seconds,
        cores=cores,
        nodes=len(nodes),
    )
    tiny = {ranks: time_tiny(channel, ranks, frames) for ranks in sorted({1, 2, channel.size})}
    network = channel.broadcast(fit_program(plain, nodes, tiny, TINY_SIDE * TINY_SIDE))
    report = {
        "links": {name: asdict(link) for name, link in links.items()},
        "times": {name: asdict(found) for name, found in times.items()},
        "tiny": tiny,
        "ranks": channel.size,
        "ranks_by_node": nodes,
    }
    return network, report


def _pairs(nodes: Sequence[Sequence[int]]) -> dict[str, tuple[int, int]]:
    largest = max(nodes, key=len)
    two_image_variants = {INSIDE: (largest[0], largest[1])} if len(largest) > 1 else {}
    return two_image_variants | ({BETWEEN: (nodes[0][0], nodes[1][0])} if len(nodes) > 1 else {})


def _cores(channel: Channel) -> int:
    """Return the number of cores that the ranks of a node may use together, the minimum over nodes."""
    granted = channel.allgather((channel.placement().node, granted_cores()))
    nodes = {node for node, _ in granted}
    return min(len(frozenset().union(*(cores for node, cores in granted if node == one))) for one in nodes)


def _lines(network: Network, report: dict[str, Any]) -> list[str]:
    lines = [f"{network.name}: {network.source}"]
    for name, link in report["links"].items():
        lines.append(
            f"{name:14} latency {1e6 * link['latency_seconds']:.2f} µs, a message {1e6 * link['overhead_seconds']:.2f} "
            f"µs, {1e-9 / link['seconds_per_byte']:.2f} GB/s; fit within {100 * link['error']:.0f} % (half of the "
            f"sizes), {100 * link['worst_error']:.0f} % (worst)"
        )
    lines.append(
        f"{'a core':14} blends a byte pixel in {1e9 * network.seconds_per_pixel:.2f} ns, a float pixel in "
        f"{1e9 * network.seconds_per_float_pixel:.2f} ns, copies {1e-9 / network.copy_seconds_per_byte:.2f} GB/s"
    )
    lines.append(
        f"{'this program':14} {1e6 * network.frame_seconds:.0f} µs a frame, {1e6 * network.message_seconds:.0f} µs a "
        f"message, {1e6 * network.barrier_seconds:.1f} µs to keep a node in step, {1e6 * network.turn_seconds:.0f} µs "
        "for each rank that waits for a core"
    )
    return lines
