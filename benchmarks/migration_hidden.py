"""Whether frames take longer while bricks move: `mpirun -n 2 python benchmarks/migration_hidden.py [--share 0.05]`.

The MNI head from a camera that goes a little to and fro. In every other block of frames some bricks are sent from each
rank to the next, are stored there, and are given up again: they are drawn where they were, so that frames differ in
nothing but that bricks move. Blocks with and without follow each other, with the same cameras. Frames are compared by
medians: wall time on rank 0, and CPU time of all ranks, which counts what others on the same cores cannot hide.
`CLUSTERVIZ_RANKS_PER_NODE=1` pretends a network between ranks, for which bricks are packed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np
from measuring import Row, head_scene, options, show, timed, write

from clusterviz.comm import Channel, open_channel
from clusterviz.distribution import balancer
from clusterviz.distribution.flights import Migration, Move, withdraw
from clusterviz.frame import FrameLoop
from clusterviz.scene.animation import orbit


class Forced:
    """Moves that nobody asked for, and that come to nothing: each rank sends some bricks in a frame."""

    def __init__(self, bricks: int) -> None:
        self._bricks, self._frames = bricks, 0
        self.is_on = False

    def moves(self, present: Any, wish: Any, free: Any, budget: int, busy: Any) -> tuple[Move, ...]:
        """In place of `rebalance`: the next of each rank's bricks, as many as the budget carries."""
        if not self.is_on:
            return ()
        self._frames += 1
        found: list[Move] = []
        size = int(wish.wire_bytes.max())
        for rank in range(present.ranks):
            own = np.argwhere((present.owner == rank) & ~busy & (wish.held_bytes > 0))
            for z, y, x in np.roll(own, -self._frames * self._bricks, axis=0)[: self._bricks].tolist():
                budget -= size
                if budget >= 0:
                    found.append(Move((z, y, x), rank, (rank + 1) % present.ranks, 1))
        return tuple(found)

    @staticmethod
    def given_up(migration: Migration, cost: Any) -> Migration:
        """In place of `hand_over`: what has arrived stays where it was."""
        return withdraw(migration, [flight.brick for flight in migration.flights if flight.stage == "held"])


def frames(channel: Channel, options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Each frame's times and bytes; the first of a block without moves are left out while bricks still come."""
    forced = Forced(options.bricks)
    vars(balancer).update(rebalance=forced.moves, hand_over=forced.given_up)
    keys = {"size": (options.size, options.size), "brick": options.brick, "migration_share": options.share}
    with FrameLoop(head_scene(distribution="dynamic", **keys), channel) as loop:
        scenes = [loop.scene.model_copy(update={"camera": c}) for c in orbit(loop.scene.camera, 20.0, options.frames)]
        loop.frame(scenes[0])
        for block in range(2 * options.blocks):
            forced.is_on = block % 2 == 1
            for number, scene in enumerate(scenes):
                channel.barrier()
                run = timed(lambda scene=scene, number=number: loop.frame(scene, number).statistics)
                told, cpu = run.value, sum(channel.allgather(run.cpu))
                each = told.migration or {}
                opened = sum(rank.balance.get("bytes_opened", 0) for rank in told.per_rank)
                if forced.is_on or not (each["bytes_raw"] or each["bricks"] or opened):
                    yield {"on": forced.is_on, "wall": run.wall, "cpu": cpu, **each}


def summary(drawn: list[dict[str, Any]], options: argparse.Namespace) -> dict[str, Any]:
    """The frames' medians with and without moves, and what moved."""
    on, off = ([each for each in drawn if each["on"] is on] for on in (True, False))

    def median(frames: list[dict[str, Any]], name: str) -> float:
        return float(np.median([each[name] for each in frames]))

    raw, sent = (sum(each[name] for each in on) for name in ("bytes_raw", "bytes_sent"))
    return {
        "share allowed": options.share,
        "frames on / off": f"{len(on)} / {len(off)}",
        **{f"{name} ms on": 1e3 * median(on, name) for name in ("wall", "cpu")},
        **{f"{name} ms off": 1e3 * median(off, name) for name in ("wall", "cpu")},
        **{f"{name} on / off": median(on, name) / median(off, name) for name in ("wall", "cpu")},
        "share median": median(on, "share"),
        "share 90 %": float(np.quantile([each["share"] for each in on], 0.9)),
        "share mean": float(sum(each["seconds"] for each in on) / sum(each["wall"] for each in on)),
        "planning mean": float(sum(each["planning_seconds"] for each in on) / sum(each["wall"] for each in on)),
        "bricks a frame": sum(each["bricks"] for each in on) / len(on),
        "MB a frame": sent / len(on) / 1e6,
        "raw / sent": raw / sent if sent else 1.0,
    }


def main() -> None:
    """Print a table on rank 0."""
    asked = options(
        __doc__,
        share=0.05,
        bricks={"type": int, "default": 2, "help": "that each rank sends in a frame, if there is time"},
        brick=32,
        size=256,
        frames={"type": int, "default": 8, "help": "in a block"},
        blocks={"type": int, "default": 4, "help": "of either kind"},
    )
    channel = open_channel()
    found = summary(list(frames(channel, asked)), asked)
    if channel.rank == 0:
        rows: list[Row] = [{"name": name, "value": value} for name, value in found.items()]
        show("what | value", "{name} | {value}", rows)
        write(asked, **found)


if __name__ == "__main__":
    main()
