"""How even each distribution leaves the ranks of the real loop: `python benchmarks/balance_loop.py [--ranks 4]`.

Ranks are threads of this process, so times mean nothing here; samples are the same as on a cluster. The MNI head is
seen from all sides (*orbit*), over a quarter there and back and there again (*to and fro*), and from near after one
frame from afar (*near*). "Recalled" are bricks that came back to a rank which still had them: nobody sent them again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.comm import Channel, run_loopback
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import FrameLoop, Rendered
from clusterviz.scene import Scene, load_scene
from clusterviz.scene.path import orbit
from clusterviz.scene.settings import with_settings

EXAMPLE = Path(__file__).parents[1] / "examples" / "head.yaml"
DISTRIBUTIONS: tuple[dict[str, Any], ...] = (
    {"distribution": "coherent"},
    {"distribution": "interleaved"},
    {"distribution": "replicated", "copies": 2},
    {"distribution": "dynamic"},
)


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


def draw(base: Scene, name: str, frames: int, ranks: int, keys: dict[str, Any]) -> list[Rendered]:
    """All frames, on ranks of this process."""

    def on_rank(channel: Channel) -> list[Rendered]:
        with FrameLoop(with_settings(base, keys), channel) as loop:
            return [loop.frame(scene, number) for number, scene in enumerate(scenes_of(loop.scene, name, frames))]

    return run_loopback(ranks, on_rank, timeout_seconds=120)[0]


def row_of(keys: dict[str, Any], drawn: list[Rendered]) -> dict[str, Any]:
    """What the frames cost."""
    samples = np.array([[rank.samples for rank in frame.statistics.per_rank] for frame in drawn], float)
    imbalance = samples.max(axis=1) / samples.mean(axis=1)
    per_rank = [rank for frame in drawn for rank in frame.statistics.per_rank]
    images = [sum(rank.balance.get("images", 0) for rank in frame.statistics.per_rank) for frame in drawn]
    return {
        "distribution": " ".join(map(str, keys.values())),
        "total / even": float(samples.max(axis=1).sum() / samples.mean(axis=1).sum()),
        "worst": float(imbalance.max()),
        "after 10": float(imbalance[10]) if len(imbalance) > 10 else None,
        "last": float(imbalance[-1]),
        "most images": max(images) or "",
        "flights": sum(int(frame.statistics.per_rank[0].balance.get("flights", 0)) for frame in drawn),
        "recalled": sum(rank.balance.get("bricks_recalled", 0) for rank in per_rank),
        "MB sent": sum(rank.balance.get("bytes_sent", 0) for rank in per_rank) / 1e6,
    }


def main() -> None:
    """Print a table a path, and write them as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranks", type=int, default=4)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--brick", type=int, default=16)
    parser.add_argument("--paths", nargs="+", choices=("orbit", "to and fro", "near"), default=["orbit", "near"])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    base = load_scene(EXAMPLE, [f"volumes.0.path={fetch_sample('mni152')}"])
    base = with_settings(base, {"size": (options.size, options.size), "brick": options.brick})
    tables = {}
    for name in options.paths:
        drawn = [(keys, draw(base, name, options.frames, options.ranks, keys)) for keys in DISTRIBUTIONS]
        rows = tables[name] = [row_of(*pair) for pair in drawn]
        print(f"\n{name}, {options.ranks} ranks, {options.frames} frames\n\n| {' | '.join(rows[0])} |")
        print(f"|{'---|' * len(rows[0])}")
        for row in rows:
            cells = (f"{value:.3f}" if isinstance(value, float) else str(value) for value in row.values())
            print(f"| {' | '.join(cells)} |", flush=True)
    if options.json:
        options.json.write_text(json.dumps(vars(options) | {"json": None, "tables": tables}, indent=1, default=str))


if __name__ == "__main__":
    main()
