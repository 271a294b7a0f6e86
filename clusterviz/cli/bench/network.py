"""`clusterviz bench network`: measure the constants of the time model by which compositing algorithms are chosen.

Two ranks of one node, and two of different nodes if there are several, exchange messages from 0 bytes to 16 MiB, and
bursts of small ones. Then as many ranks of each node as it has cores blend and copy at the same time, the ranks of each
node synchronise, and tiny images are composited, which measures the overhead of the program. The constants are stored
in a file that later runs read. Each rank should have a core, since sharing cores disturbs the measured overheads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from clusterviz.cli.bench.probes import TINY_SIDE, time_blend, time_copy, time_link, time_step, time_tiny
from clusterviz.cli.bench.report import Frames, JsonOption, write_json
from clusterviz.comm import Channel, abort_on_failure, agree, limit_threads, open_channel
from clusterviz.comm.placement import granted_cores
from clusterviz.composite.model.fitting import fit_program
from clusterviz.composite.model.network import FILE_VARIABLE, Network, open_network, save_network, saved_path
from clusterviz.composite.over.blend import compile_kernels
from clusterviz.errors import InputError
from clusterviz.image.replace import check_replaceable

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
    """Return two ranks for each kind of link."""
    largest = max(nodes, key=len)
    two_image_variants = {INSIDE: (largest[0], largest[1])} if len(largest) > 1 else {}
    return two_image_variants | ({BETWEEN: (nodes[0][0], nodes[1][0])} if len(nodes) > 1 else {})


def _cores(channel: Channel) -> int:
    """Return the number of cores that the ranks of a node may use together, the minimum over nodes."""
    granted = channel.allgather((channel.placement().node, granted_cores()))
    return min(len(frozenset().union(*(cores for _, cores in group))) for group in _by_node(granted))


def _by_node(granted: list[tuple[int, frozenset[int]]]) -> list[list[tuple[int, frozenset[int]]]]:
    return [[item for item in granted if item[0] == node] for node in {node for node, _ in granted}]


def _lines(network: Network, report: dict[str, Any]) -> list[str]:
    """Return the constants as text."""
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
