"""What pre-integration costs: `python benchmarks/preintegration.py [DATA] [--size N] [--repeats N] [--json F]`.

First what a new transfer function costs before it can be drawn (while a user drags one of its points, it does so every
frame): segments and sums for 8 to 1024 control points, one thread, beside the segments that midpoints need. There is
no table of pairs of scalars to fill, so another step costs nothing. Then a frame with slabs classified between their
ends beside one with midpoints, in turn.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from blend_modes import planned, whole_pieces

from clusterviz.data import open_source
from clusterviz.data.samples import fetch_sample
from clusterviz.gl.context import open_context
from clusterviz.plan.preintegration import make_preintegrated
from clusterviz.plan.segments import make_segments
from clusterviz.render.raycast import Raycaster
from clusterviz.scene import TransferFunction

POINTS = (8, 64, 256, 1024)
MODES: dict[str, dict[str, Any]] = {
    "midpoints": {},
    "pre-integrated": {"scene": {"quality": {"classification": "pre-integrated"}}},
}


def dragged(points: int, turn: int) -> TransferFunction:
    """Bumps of opacity and changing colours by so many control points, a little different each turn."""
    place = np.linspace(0.0, 1.0, points)
    opacities = 0.4 * (1 + np.sin(25 * place + 0.1 * turn)) * place
    colours = 0.5 + 0.5 * np.cos(6 * place[:, None] + np.array([0.0, 2.0, 4.0]))
    return TransferFunction(place, colours, place, np.clip(opacities, 0, 1), 1.0, (0.0, 1.0))


def seconds_of(make: Callable[[TransferFunction], Any], points: int, repeats: int) -> list[float]:
    """How long each of some new transfer functions took."""
    times = []
    for turn in range(repeats + 1):
        transfer = dragged(points, turn)
        began = perf_counter()
        make(transfer)
        times.append(perf_counter() - began)
    return times[1:]


def building(repeats: int) -> list[dict[str, Any]]:
    """Milliseconds for each number of control points."""
    return [
        {
            "points": points,
            "segments": len(make_preintegrated(dragged(points, 0)).records),
            "pre-integrated_ms": 1e3 * median(seconds_of(make_preintegrated, points, repeats)),
            "midpoints_ms": 1e3 * median(seconds_of(lambda transfer: make_segments(transfer, 1.0), points, repeats)),
        }
        for points in POINTS
    ]


def frames(path: str, size: int, repeats: int) -> list[dict[str, Any]]:
    """Milliseconds of a frame in each mode, taken in turn."""
    source, context = open_source(path, None), open_context()
    casters, times = {}, {name: [0.0] for name in MODES}
    for name, look in MODES.items():
        plan, bricks = planned(path, source, (0.0, 1.0), size, look)
        casters[name] = Raycaster(context, plan), plan
        casters[name][0].load(plan, bricks)
    for _ in range(repeats + 1):
        for name, (caster, plan) in casters.items():
            times[name].append(caster.draw(plan, whole_pieces(plan))[0].seconds_render)
    return [{"classification": name, "median_ms": 1e3 * median(found[2:])} for name, found in times.items()]


def main() -> None:
    """Print both tables, and write them as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a data file; default: the sample mni152")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    path = options.data or str(fetch_sample("mni152"))
    built = building(options.repeats)
    print(f"{'control points':>14} {'segments':>9} {'pre-integrated':>15} {'midpoints':>12}")
    for row in built:
        print(
            f"{row['points']:14} {row['segments']:9} {row['pre-integrated_ms']:12.2f} ms {row['midpoints_ms']:9.2f} ms"
        )
    drawn = frames(path, options.size, options.repeats)
    print(f"\na frame of {path}, {options.size} × {options.size}")
    for row in drawn:
        ratio = row["median_ms"] / drawn[0]["median_ms"]
        print(f"{row['classification']:14} {row['median_ms']:9.1f} ms, {ratio:.2f} of {drawn[0]['classification']}")
    if options.json:
        report = {"data": path, "size": options.size, "repeats": options.repeats, "building": built, "frames": drawn}
        options.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
