"""`clusterviz simulate`: count messages and pixels of a compositing algorithm and predict its time, without MPI."""

from __future__ import annotations

from dataclasses import asdict
from json import dumps
from typing import Annotated

import typer

from clusterviz.cli.arguments import parse_size
from clusterviz.composite.model.network import open_network, shipped_networks
from clusterviz.composite.simulation.drawing import check_drawable, write_drawing
from clusterviz.composite.simulation.simulate import Options, Simulation, build_schedule, simulate
from clusterviz.errors import InputError

BYTES = {"uint8": 4, "float32": 16}


def command(
    ranks: Annotated[int, typer.Option(metavar="N", help="Number of ranks, up to 65,536.")],
    algorithm: Annotated[str, typer.Option(metavar="A", help="Compositing algorithm.")],
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height of the picture.")] = "1920x1080",
    footprints: Annotated[
        str, typer.Option(help="dense: each rank covers the picture; cubes: each has a brick.")
    ] = "dense",
    network: Annotated[
        str, typer.Option(metavar="F.json", help=f"A network file, or {', '.join(shipped_networks())}.")
    ] = "infiniband-200g",
    pixel: Annotated[str, typer.Option(help="uint8 or float32: 4 or 16 bytes a pixel.")] = "float32",
    factors: Annotated[str | None, typer.Option(metavar="K,K,…", help="Factors of radix-k.")] = None,
    owners: Annotated[
        int | None, typer.Option(metavar="M", help="Number of ranks that own a piece, for direct-send.")
    ] = None,
    bands: Annotated[
        int | None, typer.Option(metavar="B", help="Number of equal bands of each owner, for direct-send.")
    ] = None,
    batches: Annotated[int | None, typer.Option(metavar="B", help="Number of batches, for pipeline.")] = None,
    draw: Annotated[str | None, typer.Option(metavar="F.svg|png", help="Draw who sends to whom.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Count what an algorithm sends on any number of ranks, and predict its time without the final gather."""
    if pixel not in BYTES:
        raise InputError("unknown pixel type", where="--pixel", found=pixel, allowed=", ".join(BYTES))
    if draw:
        check_drawable(ranks, draw)
    options = Options(_parse_factors(factors) if factors else None, owners, bands, batches)
    picture = parse_size(size)
    result = simulate(
        algorithm,
        ranks,
        picture,
        open_network(network),
        footprints=footprints,
        bytes_per_pixel=BYTES[pixel],
        options=options,
    )
    if draw:
        schedule = build_schedule(result.algorithm, ranks, picture, footprints, options)
        write_drawing(schedule, draw, f"{result.algorithm} on {ranks} ranks, {size} pixels, {footprints}")
    print(dumps(asdict(result), indent=2) if json else _text(result))


def _parse_factors(text: str) -> tuple[int, ...]:
    """Parse a list of factors such as "8,8,4", which may repeat. Raises InputError: a factor is not a whole number."""
    if not all(factor.strip().isdecimal() for factor in text.split(",")):
        raise InputError("not a list of factors", where="--factors", found=text, allowed="whole numbers: 8,8,4")
    return tuple(int(factor) for factor in text.split(","))


def _text(result: Simulation) -> str:
    lines = {
        "algorithm": f"{result.algorithm}, {result.ranks:,} ranks, {result.size[0]}x{result.size[1]}, "
        f"{result.footprints}",
        "counted": result.counted,
        "messages": f"{result.messages_sent:,}",
        "pixels": f"{result.pixels_sent:,} ({result.bytes_sent / 2**20:,.1f} MiB)",
        "rounds": f"{result.rounds:,}, the gather apart",
        "seconds": f"{result.seconds:.3g} on {result.network}",
        "worst rank": f"{result.worst_rank}: sends {result.worst_rank_messages_sent:,} messages of "
        f"{result.worst_rank_pixels_sent:,} pixels, receives {result.worst_rank_messages_received:,} of "
        f"{result.worst_rank_pixels_received:,}",
    }
    return "\n".join(f"{name:<11}{text}" for name, text in lines.items())
