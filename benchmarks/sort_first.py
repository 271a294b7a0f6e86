"""How even ranks are that share the screen: figure 5.3 of the thesis again, and what each strategy costs beside.

    mpirun -n 8 python benchmarks/sort_first.py figure --scene head --json F     every way to share, by real ranks
    python benchmarks/sort_first.py orbit --scene sparse --ranks 8 --json F      by what one rank counts, frame by frame
    python benchmarks/sort_first.py plot F G -o docs/measurements/sort-first.svg   two files of `figure`

Samples are exact and the same in every run; CPU time is of drawing, all threads of a rank's process.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Row, head_scene, options, show, svg, write

from clusterviz.comm import LoopbackChannel, open_channel
from clusterviz.data import open_source
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Source
from clusterviz.distribution.sort_first import expected_map
from clusterviz.frame import FrameLoop, Options, Rendered, Run
from clusterviz.frame.drawing import Drawing
from clusterviz.partition import Piece
from clusterviz.partition.screen import (
    COARSE,
    CostMap,
    ScreenPartition,
    adapt,
    build_cuts,
    carried,
    coarse_plan,
    cost_map_of_blocks,
    interleaved_tiles,
    pattern_tiles,
    tile_queue,
)
from clusterviz.plan.plan import Plan
from clusterviz.scene import Scene, Volume
from clusterviz.scene.animation import orbit
from clusterviz.scene.overrides import with_settings

WAYS: dict[str, dict[str, Any]] = {
    "sort-last": {"mode": "sort-last", "transport": "messages"},
    "interleaved, 64": {"mode": "sort-first", "tiling": "interleaved", "tile": 64},
    "interleaved, 32": {"mode": "sort-first", "tiling": "interleaved", "tile": 32},
    "interleaved, 16": {"mode": "sort-first", "tiling": "interleaved", "tile": 16},
    "pattern × 1": {"mode": "sort-first", "tiling": "pattern", "tile": 8, "repetitions": 1},
    "pattern × 2": {"mode": "sort-first", "tiling": "pattern", "tile": 8, "repetitions": 2},
    "pattern × 3": {"mode": "sort-first", "tiling": "pattern", "tile": 8, "repetitions": 3},
    "pattern × 5": {"mode": "sort-first", "tiling": "pattern", "tile": 8, "repetitions": 5},
    "scheduled, 32": {"mode": "sort-first", "tiling": "scheduled", "tile": 32},
    "temporal": {"mode": "sort-first", "tiling": "temporal"},
    "estimated": {"mode": "sort-first", "tiling": "estimated"},
    "hybrid, 2 groups, 32": {"groups": 2, "transport": "messages", "tiling": "interleaved"},
    "hybrid, 4 groups, 32": {"groups": 4, "transport": "messages", "tiling": "interleaved"},
    "hybrid, 2 groups, cuts": {"groups": 2, "transport": "messages", "tiling": "temporal"},
    "hybrid, 4 groups, cuts": {"groups": 4, "transport": "messages", "tiling": "temporal"},
}
STILL_DEGREES = 4.0  # between two frames


def sparse() -> np.ndarray:
    """Three small clouds in a large empty volume."""
    z, y, x = np.mgrid[:96, :96, :128].astype(np.float32)
    clouds = ((20, 20, 20, 7.0), (70, 30, 100, 11.0), (50, 80, 64, 5.0))
    return np.add.reduce([np.exp(-((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2) / (2 * w * w)) for a, b, c, w in clouds])


def scene_of(name: str, size: int) -> tuple[Scene, Source]:
    """A scene and its voxels, read once."""
    if name == "sparse":
        volume = Volume(path="sparse", clim=(0.0, 1.0), opacity=((0.02, 0.0), (1.0, 0.3)), opacity_unit_distance=4.0)
        return with_settings(Scene(volumes=(volume,)), {"size": (size, size), "brick": 16}), ArraySource(sparse())
    scene = head_scene(size=(size, size), brick=16)
    return scene, open_source(scene.volumes[0].path)


def frames_of(scene: Scene, source: Source, degrees: float, frames: int) -> list[Scene]:
    """A part of an orbit."""
    with FrameLoop(scene, LoopbackChannel(), source) as loop:
        camera = loop.scene.camera
    return [scene.model_copy(update={"camera": view}) for view in orbit(camera, degrees, frames)]


def figure(name: str, size: int) -> Iterator[Row]:
    """The third of three frames that follow each other, by each way; rows on rank 0."""
    channel = open_channel()
    scene, source = scene_of(name, size)
    scenes = frames_of(scene, source, 3 * STILL_DEGREES, 3)
    for way, settings in WAYS.items():
        if settings.get("groups", 1) > channel.size:
            continue
        with FrameLoop(with_settings(scenes[0], settings), channel, source) as loop:
            drawn = [loop.frame(with_settings(each, settings), n) for n, each in enumerate(scenes)]
        if channel.rank == 0:
            yield {"way": way, **_row(drawn[-1])}


def _row(frame: Rendered) -> Row:
    ranks = frame.statistics.per_rank
    samples, cpu = [rank.samples for rank in ranks], [1000 * rank.cpu_seconds for rank in ranks]
    return {
        "samples": samples,
        "cpu_ms": cpu,
        "most": max(samples) / np.mean(samples),
        "fewest": min(samples) / np.mean(samples),
        "slowest": max(cpu),
        "extra": sum(rank.samples_estimate for rank in ranks) / sum(samples),
        "bytes_sent": sum(rank.bytes_sent + rank.compositing.get("bytes_collected", 0) for rank in ranks),
        "voxel_bytes": max(rank.voxel_bytes for rank in ranks),
    }


class Counting:
    """Where one rank takes how many samples: the cost of every frame, whoever would draw it."""

    def __init__(self, scenes: Sequence[Scene], source: Source) -> None:
        self._scenes, self._source = scenes, source

    def maps(self) -> Iterator[tuple[Plan, CostMap, CostMap, int]]:
        """Plan, cost, estimated cost and samples of the pre-pass of each frame."""
        with FrameLoop(self._scenes[0], LoopbackChannel(), self._source, Options(keep_drawn=True)) as loop:
            drawing: Drawing = loop._drawing
            for number, scene in enumerate(self._scenes):
                drawn = loop.frame(scene, number).drawn
                assert drawn is not None
                share = drawn.work
                assert share.plan is not None
                cost = cost_map_of_blocks(scene.image.size, drawing.sample_counts)
                coarse = coarse_plan(share.plan)
                pieces = tuple(Piece(piece.rank, piece.box, piece.bricks) for piece in share.pieces)
                _, counts = drawing.draw(Run(LoopbackChannel(), Options()), replace(share, plan=coarse, pieces=pieces))
                yield (
                    share.plan,
                    cost,
                    cost_map_of_blocks(scene.image.size, drawing.sample_counts, COARSE),
                    counts.samples,
                )


def loads(mosaic: ScreenPartition, cost: CostMap) -> list[float]:
    """The samples of each group."""
    return [sum(cost.total(window) for window in windows) for windows in mosaic.rects]


def scheduled(expected: CostMap, cost: CostMap, ranks: int, side: int) -> list[float]:
    """The samples of each rank, if whoever has least takes the next tile."""
    found = [0.0] * ranks
    for tile in tile_queue(expected, side):
        found[int(np.argmin(found))] += cost.total(tile)
    return found


def orbit_table(name: str, size: int, ranks: int, frames: int) -> list[dict[str, Any]]:
    """What the busiest ranks cost in all frames of a whole turn, over an even share of all samples."""
    scene, source = scene_of(name, size)
    weights, last, expected, tree, total = (1,) * ranks, None, None, None, 0.0
    busiest: dict[str, list[float]] = {}
    for plan, cost, estimate, extra in Counting(frames_of(scene, source, 360.0, frames), source).maps():
        z, y, x = plan.layout.shape_zyx
        extent = (x - 1.0, y - 1.0, z - 1.0)
        before, expected = expected, expected_map(plan)
        tree = (
            adapt(tree, carried(last, before, expected)) if tree and last and before else build_cuts(expected, weights)
        )
        size, found = plan.view.size, {"temporal": loads(tree.partition(), cost)}
        found |= {f"interleaved, {n}": loads(interleaved_tiles(size, ranks, n), cost) for n in (64, 32, 16)}
        found |= {f"pattern × {n}": loads(pattern_tiles(plan.view, extent, ranks, 8, n), cost) for n in (1, 3, 5)}
        found |= {"scheduled, 32": scheduled(expected, cost, ranks, 32)}
        counted = loads(build_cuts(estimate, weights).partition(), cost)
        found |= {"estimated": [load + extra / ranks for load in counted]}
        for way, samples in found.items():
            busiest.setdefault(way, []).append(max(samples))
        last, total = cost, total + float(cost.cost.sum()) / ranks
    return [{"way": way, "total / even": sum(most) / total} for way, most in busiest.items()]


def plot(files: Sequence[Path], out: Path) -> None:
    """Bars to the slowest rank, from the fastest."""

    def draw(axis: Any, report: Row) -> None:
        rows = report["table"]
        samples = [np.array(row["samples"]) / np.mean(row["samples"]) for row in rows]
        colours = ["tab:orange" if row["way"].split(",")[0] in ("scheduled", "temporal", "estimated") else
                   "tab:blue" if row["way"][:3] in ("int", "pat") else "tab:grey" for row in rows]  # fmt: skip
        most, least = ([pick(each) for each in samples] for pick in (np.max, np.min))
        axis.bar(range(len(rows)), most, color=colours)
        down = [np.subtract(most, least), np.zeros(len(rows))]
        axis.errorbar(range(len(rows)), most, yerr=down, fmt="none", ecolor="k")
        axis.axhline(1.0, color="k", linewidth=0.6)
        axis.set_xticks(range(len(rows)), [row["way"] for row in rows], rotation=60, ha="right", fontsize=8)
        axis.set_title(f"{report['scene']}, {report['ranks']} ranks")
        axis.set_ylabel("samples of the slowest rank\n(lines: to the fastest) / mean")
        axis.label_outer()

    svg([json.loads(file.read_text()) for file in files], 3.6, "sort-first", draw, out)


def main() -> None:
    """Measure, or draw what was measured."""
    asked = options(
        __doc__,
        what={"names": ["what"], "choices": ("figure", "orbit", "plot")},
        files={"names": ["files"], "nargs": "*", "type": Path},
        scene={"choices": ("head", "sparse"), "default": "head"},
        size={"type": int, "default": 320, "help": "pixels along both sides"},
        ranks={"type": int, "default": 8, "help": "of an orbit"},
        frames={"type": int, "default": 90, "help": "of an orbit"},
        out={"names": ["-o", "--out"], "type": Path},
    )
    if asked.what == "plot":
        plot(asked.files, asked.out)
    elif asked.what == "orbit":
        rows = orbit_table(asked.scene, asked.size, asked.ranks, asked.frames)
        write(asked, table=show("way | total / even", "{way} | {total / even:.3f}", rows))
    elif open_channel().rank:
        list(figure(asked.scene, asked.size))
    else:
        asked.ranks = open_channel().size
        head = "way | most samples / mean | fewest | slowest, CPU ms | extra | MB sent | MB held"
        cells = (
            "{way} | {most:.3f} | {fewest:.3f} | {slowest:.1f} | {extra:.3f} | {bytes_sent!M:.3f} | {voxel_bytes!M:.1f}"
        )
        write(asked, table=show(head, cells, figure(asked.scene, asked.size)))


if __name__ == "__main__":
    main()
