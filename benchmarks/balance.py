"""How even each distribution leaves the ranks: `python benchmarks/balance.py [--only corner|orbit] [--json F]`.

No rendering and no MPI: costs are synthetic, or the samples that the plan of the MNI head expects in each brick. Ranks
are told their own sums only, as in a run; everything sent in a frame has arrived in the next.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.complete import complete_scene
from clusterviz.content.volume.info import VolumeInfo
from clusterviz.data import open_source
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.samples import fetch_sample
from clusterviz.data.summary import summarise
from clusterviz.distribution.balancer import Policy, begin, complete, learn, plan_moves
from clusterviz.distribution.brick_cost import expected_samples
from clusterviz.distribution.flights import dispatch
from clusterviz.image.replace import replacing
from clusterviz.partition import (
    Owners,
    assign_replicas,
    build_tree,
    interleave,
    owners_of,
    ray_origin,
    replicate,
    visible_groups,
)
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.scene.animation import orbit
from clusterviz.scene.files import load_scene

Costs = NDArray[np.float64]
CORNERS = ((0.1, 0.15, 0.2, 0.18), (0.9, 0.8, 0.2, 0.15), (0.5, 0.1, 0.9, 0.25))  # centre and width
SIDE, FRAMES, JUMP = 32, 30, 15
EVEN = 1.10
DIRECTION = (1.0, 0.5, 0.2)
BRICK_BYTES = 17**3


@dataclass(frozen=True)
class Row:
    """A distribution over all frames.

    Attributes
    ----------
    imbalance : of each frame, largest over mean
    slowest : the cost of the busiest rank of each frame
    images : partial images of each frame
    wire_bytes : planned in each frame
    """

    imbalance: list[float]
    slowest: list[float]
    images: list[int]
    wire_bytes: list[int]


Eye = tuple[float, float, float]


def look(row: Row, owners: Owners, cost: Costs, eye: Eye, sent: int) -> None:
    """Note one frame."""
    row.imbalance.append(owners.imbalance(cost))
    row.slowest.append(float(owners.loads(cost).max()))
    row.images.append(len(visible_groups(owners, eye, DIRECTION)))
    row.wire_bytes.append(sent)


def fixed(deal: Callable[[Costs], Owners], costs: Sequence[Costs], eyes: Sequence[Eye]) -> Row:
    """Data that stay where they are; `deal` says who draws what of them in a frame, by the cost of the last."""
    row = Row([], [], [], [])
    for last, cost, eye in zip([costs[0], *costs], costs, eyes, strict=False):
        look(row, deal(last), cost, eye, 0)
    return row


def dynamic(
    model: Costs, costs: Sequence[Costs], eyes: Sequence[Eye], ranks: int, policy: Policy, views: bool = False
) -> Row:
    """Planes that move. What is expected is the model in all frames, or with `views` the samples of each camera."""
    row, held = Row([], [], [], []), np.where(model > 0, BRICK_BYTES, 0)
    places = [ray_origin(eye, DIRECTION) for eye in eyes]
    balance = begin(costs[0] + 1e-9 * model if views else model, ranks, held, policy, places[0])
    for cost, eye, place in zip(costs, eyes, places, strict=True):
        expected = cost if views else model
        balance = plan_moves(balance, expected, policy, place)
        planned = [flight.brick for flight in balance.migration.flights if flight.stage == "planned"]
        owners = balance.migration.owners
        look(row, owners, cost, eye, len(planned) * BRICK_BYTES)
        balance = replace(balance, migration=dispatch(balance.migration, planned))
        balance = complete(learn(balance, expected, owners.loads(cost), policy), planned)
    return row


def rows(
    model: Costs, costs: Sequence[Costs], eyes: Sequence[Eye], ranks: int, policy: Policy
) -> Iterator[tuple[str, Row]]:
    """All distributions; the first two know nothing but the model."""
    home = build_tree(model, ranks)
    shown = model > 0
    yield "static coherent", fixed(lambda _: owners_of(home), costs, eyes)
    dealt = interleave(model, ranks, 4)
    yield "static interleaved, blocks of 4", fixed(lambda _: dealt, costs, eyes)
    for copies in (2, 3):
        held = replicate(home, copies)
        name = f"static replicated, {copies} copies"
        yield name, fixed(lambda last, held=held: assign_replicas(held, np.where(shown, last + 1e-9, 0)), costs, eyes)
    yield "dynamic", dynamic(model, costs, eyes, ranks, policy)
    yield "dynamic, next view known", dynamic(model, costs, eyes, ranks, policy, views=True)


def corner(z: float, y: float, x: float, width: float) -> Costs:
    """A cost that lies in one place, with a little everywhere."""
    middles = (np.arange(SIDE) + 0.5) / SIDE
    squares = (middles[:, None, None] - z) ** 2 + (middles[:, None] - y) ** 2 + (middles - x) ** 2
    return np.asarray(0.01 + np.exp(-squares / (2 * width**2)), np.float64)


def back(imbalance: Sequence[float]) -> int | None:
    """Frames until it is even, and stays so; None where it never does."""
    uneven = [number for number, value in enumerate(imbalance) if value > EVEN]
    return 0 if not uneven else None if uneven[-1] == len(imbalance) - 1 else uneven[-1] + 1


def corner_table(ranks: int) -> list[dict[str, Any]]:
    """A dear corner; after `JUMP` frames another one."""
    model, eyes = np.ones((SIDE,) * 3), [(56.25, -43.75, 25.0)] * FRAMES
    policy = Policy(model.size // 4 * BRICK_BYTES, 10**9)
    table = []
    for number, at in enumerate(CORNERS):
        then = CORNERS[(number + 1) % len(CORNERS)]
        costs = [corner(*at)] * JUMP + [corner(*then)] * (FRAMES - JUMP)
        for name, row in rows(model, costs, eyes, ranks, policy):
            table.append(
                {
                    "corner": number,
                    "name": name,
                    "first": row.imbalance[0],
                    "after 10": row.imbalance[10],
                    "even after": back(row.imbalance[:JUMP]),
                    "after the jump": back(row.imbalance[JUMP:]),
                    "most images": max(row.images),
                    "most bytes / budget": max(row.wire_bytes) / policy.budget_bytes,
                }
            )
    return table


def plans(frames: int, brick: int, nearer: float) -> list[Plan]:
    """The head from all sides, once round; `nearer` moves the camera towards it."""
    sample = fetch_sample("mni152")
    scene = load_scene(Path(__file__).parents[1] / "examples" / "head.yaml", [f"volumes.0.path={sample}"])
    source = open_source(scene.volumes[0].path, scene.volumes[0].array)
    layout, grid = BrickLayout(source.grid.shape_zyx, brick), source.grid
    wanted = [(z, y, x) for z, y, x in np.ndindex(layout.counts_zyx)]
    summary = summarise(source.dtype, layout, lambda: read_bricks(source, layout, wanted), lambda value: [value])
    percentiles = (summary.percentile(1.0), summary.percentile(99.0))
    info = VolumeInfo(grid.shape_zyx, grid.spacing, grid.corners, *summary.value_range, *percentiles)
    complete = complete_scene(scene, (info,))
    position, focal = (np.array(point) for point in (complete.camera.position, complete.camera.focal_point))
    moved = tuple(float(value) for value in focal + (position - focal) * nearer)
    camera = complete.camera.model_copy(update={"position": moved})
    each = [complete.model_copy(update={"camera": view}) for view in orbit(camera, 360.0, frames)]
    return [make_plan(one, grid, source.dtype, layout, summary) for one in each]


def orbit_table(ranks: int, nearer: float) -> list[dict[str, Any]]:
    """Ninety frames round the head: what the busiest ranks cost in all, over an even share of all."""
    views = plans(90, 8, nearer)
    costs = [expected_samples(plan) for plan in views]
    model = views[0].cost
    policy = Policy(int((model > 0).sum()) // 20 * BRICK_BYTES, 10**9)
    even = sum(float(cost.sum()) for cost in costs) / ranks
    return [
        {
            "name": name,
            "total / even": sum(row.slowest) / even,
            "worst": max(row.imbalance),
            "mean images": float(np.mean(row.images)),
            "bricks sent": sum(row.wire_bytes) // BRICK_BYTES,
            "most bytes / budget": max(row.wire_bytes) / policy.budget_bytes,
        }
        for name, row in rows(model, costs, [plan.eye_in_bricks() or (0.0, 0.0, 0.0) for plan in views], ranks, policy)
    ]


def show(title: str, table: Sequence[dict[str, Any]]) -> None:
    """A table in Markdown."""
    print(f"\n{title}\n\n| {' | '.join(table[0])} |\n|{'---|' * len(table[0])}")
    for row in table:
        cells = (
            f"{value:.3f}" if isinstance(value, float) else "never" if value is None else str(value)
            for value in row.values()
        )
        print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the tables, and write them as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("corner", "orbit"))
    parser.add_argument("--ranks", type=int, nargs="+", default=[4, 7])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    tables: dict[str, list[dict[str, Any]]] = {}
    for ranks in options.ranks:
        if options.only != "orbit":
            tables[f"a dear corner, {ranks} ranks"] = corner_table(ranks)
            show(*list(tables.items())[-1])
        for nearer in (1.0, 0.35) if options.only != "corner" else ():
            tables[f"90 frames round the MNI head, {ranks} ranks, camera at {nearer:g} of its distance"] = orbit_table(
                ranks, nearer
            )
            show(*list(tables.items())[-1])
    if options.json:
        with replacing(options.json) as temporary:
            temporary.write_text(json.dumps(tables, indent=1))


if __name__ == "__main__":
    main()
