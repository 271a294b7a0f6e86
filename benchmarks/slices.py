"""View-aligned slices: `python benchmarks/slices.py [DATA] [--size N] [--brick N …] [--count N] [--json F]`.

Three tables:
- the thesis's table 5.1 [1], measured: per brick the CPU's time, bytes and vertices of each slice generator, and the
  time of a frame that OpenGL draws with them, beside the ray caster on the same planes;
- a million random boxes and planes: where two boxes with a common face have not the area of both together, and how many
  polygons brute force gets wrong that validates lines by themselves, of planes through corners;
- errors of `quality.renderer: slices` and of rays with the same steps, against rays of step 1/16.

References
----------
[1] M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import moderngl
import numpy as np
from blend_modes import whole_pieces

import clusterviz
from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.frame import Options, Run, prepare
from clusterviz.gl.context import open_context
from clusterviz.plan.plan import Plan
from clusterviz.plan.slices import GENERATORS, Cuts
from clusterviz.plan.slices.brute_force import brute_force
from clusterviz.render.raycast import Raycaster
from clusterviz.render.slices import SliceDrawing
from clusterviz.scene.values import Cluster, ImageSettings, Quality, Scene, Volume

CHUNK = 20_000
STEPS = (0.5, 1.0, 2.0)
FINE = 1 / 16
ROUNDING = 1e-11


def prepared(path: str, size: int, brick: int, **quality: Any) -> tuple[Plan, dict[Any, Any]]:
    """Plan and bricks of the data with its usual look."""
    scene = Scene(
        volumes=(Volume(path=path),),
        image=ImageSettings(size=(size, size)),
        quality=Quality(**quality),
        cluster=Cluster(brick=brick),
    )
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, [open_source(path, None)])
    assert share.plan is not None, "there is something to show"
    return share.plan, dict(bricks)


def table(context: moderngl.Context, path: str, size: int, brick: int, frames: int) -> list[dict[str, Any]]:
    """One row for each generator, and for the ray caster on slices and on rays."""
    plan, bricks = prepared(path, size, brick, renderer="slices")
    rows = []
    for name in GENERATORS:
        drawing = SliceDrawing(context, plan, bricks, name)
        drawn = [drawing.draw() for _ in range(frames + 1)][1:]
        drawing.release()
        one = drawn[0]
        rows.append(
            {
                "generator": name,
                "bricks": one.bricks,
                "slices": one.slices / one.bricks,
                "cpu_us": 1e6 * min(each.cpu_seconds for each in drawn) / one.bricks,
                "bytes": one.bytes_sent / one.bricks,
                "bytes_once": one.bytes_once,
                "vertices": one.vertices / one.bricks,
                "draw_ms": 1e3 * min(each.seconds for each in drawn),
                "gpu_ms": 1e3 * min(each.gpu_seconds for each in drawn),
            }
        )
    for renderer in ("slices", "raycast"):
        plan, bricks = prepared(path, size, brick, renderer=renderer)
        caster = Raycaster(context, plan)
        caster.load(plan, bricks)
        seconds = []
        for _ in range(frames + 1):
            began = perf_counter()
            caster.draw(plan, whole_pieces(plan))
            seconds.append(perf_counter() - began)
        caster.release()
        rows.append({"generator": f"ray caster, {renderer}", "draw_ms": 1e3 * min(seconds[1:])})
    return rows


def random_cuts(rng: np.random.Generator, count: int, through_corners: bool) -> Cuts:
    """Boxes of any shape, with planes of any direction that meet most of them, or that hit a corner."""
    low = rng.uniform(-10, 10, (count, 3))
    high = low + rng.uniform(0.01, 8, (count, 3))
    normal = rng.normal(size=(count, 3))
    levels = Cuts(low, high, normal, np.zeros(count)).corner_levels
    share = rng.uniform(-0.05, 1.05, count)
    level = levels[:, 0] * (1 - share) + levels[:, 7] * share
    if through_corners:
        level = levels[np.arange(count), rng.integers(1, 7, count)]
    return Cuts(low, high, normal, level)


def watertight(count: int) -> list[dict[str, Any]]:
    """How many of the planes are not the sum of their parts in two boxes, and the CPU's time of a polygon."""
    rows = []
    for name, generator in GENERATORS.items():
        rng, wrong, seconds, polygons = np.random.default_rng(1), 0, 0.0, 0
        for number in range(count // CHUNK):
            cuts, axis = random_cuts(rng, CHUNK, number % 2 == 1), number % 3
            at = cuts.low[:, axis] + 0.3 * (cuts.high[:, axis] - cuts.low[:, axis])
            begin, end = cuts.low.copy(), cuts.high.copy()
            begin[:, axis] = end[:, axis] = at
            boxes = (cuts.low, cuts.high), (cuts.low, end), (begin, cuts.high)
            began = process_time()
            found = [generator(Cuts(*box, cuts.normal, cuts.level)) for box in boxes]
            seconds += process_time() - began
            polygons += sum(len(each.counts) for each in found)
            whole, left, right = (each.areas for each in found)
            size = ((cuts.high - cuts.low) ** 2).sum(axis=1)
            wrong += int((np.abs(left + right - whole) > ROUNDING * size).sum())
        rows.append({"generator": name, "planes": count, "wrong": wrong, "us": 1e6 * seconds / polygons})
    rng, wrong, other = np.random.default_rng(1), 0, 0
    for _ in range(count // CHUNK):
        cuts = random_cuts(rng, CHUNK, True)
        apart = np.abs(brute_force(cuts, by_lines=True).areas - brute_force(cuts).areas)
        wrong += int((apart > 1e-6 * ((cuts.high - cuts.low) ** 2).sum(axis=1)).sum())
        other += CHUNK
    return [
        *rows,
        {"generator": "brute-force, lines by themselves, planes through corners", "planes": other, "wrong": wrong},
    ]


def errors(path: str, size: int) -> list[dict[str, Any]]:
    """Largest and root of the mean square difference to a fine picture, in 255ths, and samples."""

    def picture(**quality: Any) -> np.ndarray:
        found = clusterviz.render(path, size=(size, size), **quality)
        assert found is not None, "one rank"
        return found.astype(np.float64)

    truth, rows = picture(step=FINE), []
    for classification in ("post", "pre-integrated"):
        for step in STEPS:
            for renderer in ("raycast", "slices"):
                apart = picture(step=step, renderer=renderer, classification=classification) - truth
                most, rms = 255 * float(np.abs(apart).max()), 255 * float(np.sqrt(np.mean(apart**2)))
                name = {"classification": classification, "step": step, "renderer": renderer}
                rows.append(name | {"max": most, "rms": rms})
    return rows


def main() -> None:
    """Print the tables, and write them as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="?", default="field:marschner-lobb:128", help="a data file or field")
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--brick", type=int, nargs="*", default=[16, 32, 64])
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--count", type=int, default=1_000_000, help="random planes")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    context = open_context()
    found: dict[str, Any] = {"renderer": context.info["GL_RENDERER"], "data": options.data, "table": {}}
    print(f"{options.data}, {options.size} × {options.size}, {found['renderer']}")
    for brick in options.brick:
        found["table"][brick] = rows = table(context, options.data, options.size, brick, options.frames)
        print(
            f"\nbricks of {brick}³, of each: CPU µs, bytes, vertices, slices; frame: ms drawing, ms of the GPU's clock"
        )
        for row in rows:
            keys = ("cpu_us", "bytes", "vertices", "slices", "draw_ms", "gpu_ms")
            print(f"{row['generator']:24}" + "".join(f"{row[key]:10.1f}" if key in row else " " * 10 for key in keys))
    found["watertight"] = watertight(options.count)
    print("\npieces that do not fit together, of random planes; CPU µs a polygon")
    for row in found["watertight"]:
        print(
            f"{row['generator']:56}{row['wrong']:8} of {row['planes']:,}" + (f"{row['us']:8.2f}" if "us" in row else "")
        )
    found["errors"] = errors(options.data, options.size)
    print(f"\ndifference to step {FINE}, in 255ths")
    for row in found["errors"]:
        print(
            f"{row['classification']:16}step {row['step']:<5g}{row['renderer']:9} "
            f"max {row['max']:7.3f}  rms {row['rms']:7.4f}"
        )
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
