"""What each way to share costs, in the real loop, and how even ranks are that share the screen.

    python benchmarks/balance_loop.py [--scene sparse] [--frames 90] [--json F]    a table a path
    python benchmarks/balance_loop.py --ways dynamic --bricks 8 16 8-32   bricks of one size, and of 8 to 32
    mpirun -n 8 python benchmarks/balance_loop.py figure --size 320 --json F   one frame, by real ranks
    python benchmarks/balance_loop.py plot F G -o docs/measurements/balance.svg   the charts of such files

Ranks of a path are threads of this process, so times mean nothing there, and bound nothing; samples are as on a
cluster. The scene is seen from all sides (*orbit*), over a quarter there and back and there again (*to and fro*), and
from near after one frame from afar (*near*). "Recalled" are bricks that came back to a rank which still had them:
nobody sent them again. `figure` draws figure 5.3 of the thesis again, with the CPU time of drawing, all threads.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Row, head_scene, options, show, svg, write

from clusterviz.comm import Channel, LoopbackChannel, open_channel, run_loopback
from clusterviz.data import open_source
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Source
from clusterviz.frame import FrameLoop, Rendered
from clusterviz.image.replace import check_replaceable
from clusterviz.scene import Scene, Volume
from clusterviz.scene.animation import orbit
from clusterviz.scene.overrides import with_settings

Opener = Callable[[], Source]
WAYS: dict[str, dict[str, Any]] = {
    "coherent": {"distribution": "coherent"},
    "interleaved": {"distribution": "interleaved"},
    "replicated, 2 copies": {"distribution": "replicated", "copies": 2},
    "dynamic": {"distribution": "dynamic", "migration_share": 1.0},
    "screen: interleaved, 16": {"mode": "sort-first", "tiling": "interleaved", "tile": 16},
    "screen: pattern × 3": {"mode": "sort-first", "tiling": "pattern", "tile": 8, "repetitions": 3},
    "screen: scheduled, 16": {"mode": "sort-first", "tiling": "scheduled", "tile": 16},
    "screen: temporal": {"mode": "sort-first", "tiling": "temporal"},
    "screen: estimated": {"mode": "sort-first", "tiling": "estimated"},
    "2 groups, temporal": {"mode": "hybrid", "groups": 2, "tiling": "temporal"},
}
FIGURE: dict[str, dict[str, Any]] = {
    "sort-last": {"mode": "sort-last", "transport": "messages"},
    **{f"interleaved, {n}": {"mode": "sort-first", "tiling": "interleaved", "tile": n} for n in (64, 32, 16)},
    **{
        f"pattern × {n}": {"mode": "sort-first", "tiling": "pattern", "tile": 8, "repetitions": n} for n in (1, 2, 3, 5)
    },
    "scheduled, 32": {"mode": "sort-first", "tiling": "scheduled", "tile": 32},
    "temporal": {"mode": "sort-first", "tiling": "temporal"},
    "estimated": {"mode": "sort-first", "tiling": "estimated"},
    **{
        f"hybrid, {n} groups, {tiling}": {"groups": n, "transport": "messages", "tiling": tiling}
        for tiling in ("interleaved", "temporal")
        for n in (2, 4)
    },
}
ONE_COPY = ("coherent", "interleaved")
"""Static ways whose ranks hold no brick twice, as with the dynamic one."""
DRAWN = ("coherent", "interleaved", "replicated, 2 copies", "dynamic", "screen: temporal")
"""Ways that are plotted."""
HEAD = (
    "way | M samples | total / even | worst | after 10 | last | most images | bricks | flights | recalled | MB sent | "
    "MB a rank | MB at first"
)
CELLS = (
    "{way} | {M samples:.3f} | {total / even:.3f} | {worst:.3f} | {after 10:.3f} | {last:.3f} | {most images} | "
    "{bricks} | {flights} | {recalled} | {MB sent:.3f} | {MB a rank:.3f} | {MB at first:.3f}"
)
FIGURE_HEAD = "way | most samples / mean | fewest | slowest, CPU ms | extra | MB sent | MB held"
FIGURE_CELLS = "{way} | {most:.3f} | {fewest:.3f} | {slowest:.1f} | {extra:.3f} | {sent:.3f} | {held:.1f}"


def sparse() -> Any:
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


def scenes_of(base: Scene, name: str, frames: int) -> list[Scene]:
    """The frames of a path; `base` is complete."""
    camera = base.camera
    assert camera.position is not None
    assert camera.focal_point is not None
    if name == "near":
        position, focal = np.array(camera.position), np.array(camera.focal_point)
        near = {"position": tuple((focal + (position - focal) * 0.3).tolist()), "view_angle": 40.0}
        return [base, *[with_settings(base, near)] * (frames - 1)]
    views = orbit(camera, 360.0 if name == "orbit" else 90.0, frames if name == "orbit" else frames // 3)
    if name == "to and fro":
        views = [*views, *views[::-1], *views]
    return [base.model_copy(update={"camera": view}) for view in views]


def draw(scenes: Sequence[Scene], open_voxels: Opener, ranks: int, keys: dict[str, Any]) -> list[Rendered]:
    """All frames, on ranks of this process, each of which opens the file: a file is read at one place at a time."""
    settled = [with_settings(scene, keys) for scene in scenes]

    def on_rank(channel: Channel) -> list[Rendered]:
        with FrameLoop(settled[0], channel, open_voxels()) as loop:
            return [loop.frame(scene, number) for number, scene in enumerate(settled)]

    return run_loopback(ranks, on_rank, timeout_seconds=600)[0]


def row_of(way: str, drawn: Sequence[Rendered]) -> Row:
    """What the frames cost: the samples of the busiest rank, summed, and what led to them."""
    samples = np.array([[rank.samples for rank in frame.statistics.per_rank] for frame in drawn], float)
    imbalance = samples.max(axis=1) / samples.mean(axis=1)
    per_rank = [rank for frame in drawn for rank in frame.statistics.per_rank]
    images = [sum(rank.balance.get("images", 0) for rank in frame.statistics.per_rank) for frame in drawn]
    return {
        "way": way,
        "M samples": float(samples.max(axis=1).sum() / 1e6),
        "total / even": float(samples.max(axis=1).sum() / samples.mean(axis=1).sum()),
        "worst": float(imbalance.max()),
        "after 10": float(imbalance[10]) if len(imbalance) > 10 else None,
        "last": float(imbalance[-1]),
        "most images": max(images) or "",
        "bricks": sum(rank.bricks for rank in drawn[0].statistics.per_rank),
        "flights": sum(int(frame.statistics.per_rank[0].balance.get("flights", 0)) for frame in drawn),
        "recalled": sum(rank.balance.get("bricks_recalled", 0) for rank in per_rank),
        "MB sent": sum(rank.balance.get("bytes_sent", 0) for rank in per_rank) / 1e6,
        "MB a rank": max(rank.voxel_bytes for rank in per_rank) / 1e6,
        "MB at first": sum(rank.voxel_bytes for rank in drawn[0].statistics.per_rank) / 1e6,
        "imbalance": imbalance.tolist(),
    }


def sizes_of(text: str) -> dict[str, int]:
    """The keys of bricks of one size, as "16", or of several, as "8-32"."""
    smallest, *largest = map(int, text.split("-"))
    return {"brick": smallest, **({"largest_brick": largest[0]} if largest else {})}


def verdict(rows: Sequence[Row]) -> str:
    """Whether bricks that move cost less than bricks that stay, in a sentence."""
    cost = {row["way"]: row["M samples"] for row in rows}
    alone, best = min(ONE_COPY, key=lambda way: cost[way]), min(cost, key=lambda way: cost[way])
    word = "less" if cost["dynamic"] < cost[alone] else "more"
    text = f"dynamic took {abs(cost['dynamic'] / cost[alone] - 1):.1%} {word} than {alone}, the best static of one copy"
    return text if best == "dynamic" else f"{text}; the least took {best}: {1 - cost[best] / cost['dynamic']:.1%} less"


def measure(asked: argparse.Namespace) -> None:
    """Print a table a path."""
    base = with_settings(scene_of(asked.scene, asked.size)[0], {"shade": True} if asked.lit else {})

    def open_voxels() -> Source:
        return scene_of(asked.scene, asked.size)[1]

    with FrameLoop(base, LoopbackChannel(), open_voxels(), several=False) as loop:
        base = loop.scene
    tables: dict[str, list[Row]] = {}
    for name in asked.paths:
        scenes, several = scenes_of(base, name, asked.frames), len(asked.bricks) > 1
        rows = (
            row_of(
                f"{way}, bricks of {size}" if several else way,
                draw(scenes, open_voxels, asked.ranks, WAYS[way] | sizes_of(size)),
            )
            for way in asked.ways
            for size in asked.bricks
        )
        tables[name] = show(HEAD, CELLS, rows, f"{asked.scene}, {name}, {asked.ranks} ranks, {len(scenes)} frames")
        if not several and {"dynamic", *ONE_COPY} <= set(asked.ways):
            print(f"\n{verdict(tables[name])}")
    write(asked, tables=tables)


def figure(channel: Channel, name: str, size: int) -> Iterator[Row]:
    """The third of three frames, four degrees apart, by each way; rows on rank 0."""
    scene, source = scene_of(name, size)
    with FrameLoop(scene, LoopbackChannel(), source) as loop:
        scenes = [scene.model_copy(update={"camera": view}) for view in orbit(loop.scene.camera, 12.0, 3)]
    for way, settings in FIGURE.items():
        if settings.get("groups", 1) > channel.size:
            continue
        with FrameLoop(with_settings(scenes[0], settings), channel, source) as loop:
            drawn = [loop.frame(with_settings(each, settings), n) for n, each in enumerate(scenes)]
        ranks = drawn[-1].statistics.per_rank
        samples = [rank.samples for rank in ranks]
        yield {
            "way": way,
            "samples": samples,
            "most": max(samples) / np.mean(samples),
            "fewest": min(samples) / np.mean(samples),
            "slowest": max(1000 * rank.cpu_seconds for rank in ranks),
            "extra": sum(rank.samples_estimate for rank in ranks) / sum(samples),
            "sent": sum(rank.bytes_sent + rank.compositing.get("bytes_collected", 0) for rank in ranks) / 1e6,
            "held": max(rank.voxel_bytes for rank in ranks) / 1e6,
        }


def measure_figure(asked: argparse.Namespace) -> None:
    channel = open_channel()
    rows = figure(channel, asked.scene, asked.size)
    asked.ranks = channel.size
    if channel.rank == 0:
        write(asked, figure=show(FIGURE_HEAD, FIGURE_CELLS, rows))
    else:
        list(rows)


def draw_orbit(axis: Any, report: Row) -> None:
    """How uneven each frame is."""
    for row in report["tables"]["orbit"]:
        if row["way"] in DRAWN:
            axis.plot(row["imbalance"], label=f"{row['way']}: {row['total / even']:.3f}", linewidth=1)
    axis.set_title(f"{report['scene']}, {report['ranks']} ranks, {report['frames']} frames")
    axis.set(xlabel="frame", ylabel="samples of the busiest rank / mean")
    place = {"loc": "upper center", "ncols": 3, "bbox_to_anchor": (0.5, -0.18)}
    axis.legend(fontsize=7, title="total / even", title_fontsize=7, **place)
    axis.label_outer()


def draw_figure(axis: Any, report: Row) -> None:
    """Bars to the slowest rank, from the fastest."""
    rows = report["figure"]
    least, most = np.array([[row["fewest"], row["most"]] for row in rows]).T
    axis.bar(range(len(rows)), most)
    axis.errorbar(range(len(rows)), most, yerr=[most - least, np.zeros(len(rows))], fmt="none", ecolor="k")
    axis.axhline(1.0, color="k", linewidth=0.6)
    axis.set_xticks(range(len(rows)), [row["way"] for row in rows], rotation=60, ha="right", fontsize=8)
    axis.set_title(f"{report['scene']}, {report['ranks']} ranks")
    axis.set_ylabel("samples of the slowest rank\n(lines: to the fastest) / mean")
    axis.label_outer()


def main() -> None:
    asked = options(
        __doc__,
        what={"names": ["what"], "nargs": "?", "choices": ("measure", "figure", "plot"), "default": "measure"},
        files={"names": ["files"], "nargs": "*", "type": Path},
        scene={"choices": ("head", "sparse"), "default": "head"},
        ranks=4,
        frames=90,
        size=96,
        bricks=["16"],
        lit={"action": "store_true", "help": "shaded: bricks overlap by two more voxels"},
        paths={"nargs": "+", "choices": ("orbit", "to and fro", "near"), "default": ["orbit"]},
        ways={"nargs": "+", "choices": tuple(WAYS), "default": list(WAYS)},
        out={"names": ["-o", "--out"], "type": Path, "default": Path("balance.svg")},
    )
    if asked.json:
        check_replaceable(asked.json)
    if asked.what == "plot":
        reports = [json.loads(file.read_text()) for file in asked.files]
        draws = draw_figure if "figure" in reports[0] else draw_orbit
        svg(reports, 3.7, "balance", draws, asked.out)
    else:
        {"measure": measure, "figure": measure_figure}[asked.what](asked)


if __name__ == "__main__":
    main()
