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

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from measuring import Row, context_of, loaded, opened, options, positional, prepared, show, timed, whole_pieces, write

import clusterviz
from clusterviz.plan.plan import Plan
from clusterviz.plan.slices import GENERATORS, Cuts
from clusterviz.plan.slices.brute_force import brute_force
from clusterviz.render.slices import SliceDrawing
from clusterviz.scene.values import Cluster, ImageSettings, Quality, Scene, Volume

CHUNK = 20_000
STEPS = (0.5, 1.0, 2.0)
FINE = 1 / 16
ROUNDING = 1e-11


def planned(path: str, size: int, brick: int, **quality: Any) -> tuple[Plan, dict[Any, Any]]:
    """Plan and bricks of the data with its usual look."""
    image, cluster = ImageSettings(size=(size, size)), Cluster(brick=brick)
    scene = Scene(volumes=(Volume(path=path),), image=image, quality=Quality(**quality), cluster=cluster)
    return prepared(scene, [opened(path)[0]])


def generators(path: str, size: int, brick: int, frames: int) -> Iterator[Row]:
    """One row for each generator, and for the ray caster on slices and on rays."""
    plan, bricks = planned(path, size, brick, renderer="slices")
    for name in GENERATORS:
        drawing = SliceDrawing(context_of(), plan, bricks, name)
        drawn = [drawing.draw() for _ in range(frames + 1)][1:]
        drawing.release()
        one = drawn[0]
        yield {
            "brick": brick,
            "generator": name,
            "slices": one.slices / one.bricks,
            "cpu_us": 1e6 * min(each.cpu_seconds for each in drawn) / one.bricks,
            "bytes": one.bytes_sent / one.bricks,
            "bytes_once": one.bytes_once,
            "vertices": one.vertices / one.bricks,
            "draw": min(each.seconds for each in drawn),
            "gpu": min(each.gpu_seconds for each in drawn),
        }
    for renderer in ("slices", "raycast"):
        plan, bricks = planned(path, size, brick, renderer=renderer)
        caster = loaded(plan, bricks, 0)
        runs = [
            timed(lambda plan=plan, caster=caster: caster.draw(plan, whole_pieces(plan))) for _ in range(frames + 1)
        ]
        caster.release()
        yield {"brick": brick, "generator": f"ray caster, {renderer}", "draw": min(run.wall for run in runs[1:])}


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


def watertight(count: int) -> Iterator[Row]:
    """How many of the planes are not the sum of their parts in two boxes, and the CPU's time of a polygon."""
    for name, generator in GENERATORS.items():
        rng, wrong, seconds, polygons = np.random.default_rng(1), 0, 0.0, 0
        for number in range(count // CHUNK):
            cuts, axis = random_cuts(rng, CHUNK, number % 2 == 1), number % 3
            at = cuts.low[:, axis] + 0.3 * (cuts.high[:, axis] - cuts.low[:, axis])
            begin, end = cuts.low.copy(), cuts.high.copy()
            begin[:, axis] = end[:, axis] = at
            each = [
                Cuts(*box, cuts.normal, cuts.level)
                for box in ((cuts.low, cuts.high), (cuts.low, end), (begin, cuts.high))
            ]
            run = timed(lambda each=each, generator=generator: [generator(one) for one in each])
            seconds += run.cpu
            polygons += sum(len(one.counts) for one in run.value)
            whole, left, right = (one.areas for one in run.value)
            wrong += int((np.abs(left + right - whole) > ROUNDING * ((cuts.high - cuts.low) ** 2).sum(axis=1)).sum())
        yield {"generator": name, "planes": count, "wrong": wrong, "us": 1e6 * seconds / polygons}
    rng, wrong = np.random.default_rng(1), 0
    for _ in range(count // CHUNK):
        cuts = random_cuts(rng, CHUNK, True)
        apart = np.abs(brute_force(cuts, by_lines=True).areas - brute_force(cuts).areas)
        wrong += int((apart > 1e-6 * ((cuts.high - cuts.low) ** 2).sum(axis=1)).sum())
    name = "brute-force, lines by themselves, planes through corners"
    yield {"generator": name, "planes": count // CHUNK * CHUNK, "wrong": wrong}


def errors(path: str, size: int) -> Iterator[Row]:
    """Largest and root of the mean square difference to a fine picture."""

    def picture(**quality: Any) -> Any:
        return np.asarray(clusterviz.render(path, size=(size, size), **quality), np.float64)

    truth = picture(step=FINE)
    for classification, step, renderer in product(("post", "pre-integrated"), STEPS, ("raycast", "slices")):
        apart = picture(step=step, renderer=renderer, classification=classification) - truth
        row = {"classification": classification, "step": step, "renderer": renderer}
        yield row | {"max": np.abs(apart).max(), "rms": float(np.sqrt(np.mean(apart**2)))}


def main() -> None:
    """Print the tables."""
    data = positional("data", default="field:marschner-lobb:128", help="a data file or field")
    count = {"type": int, "default": 1_000_000, "help": "random planes"}
    asked = options(__doc__, data=data, size=384, brick=[16, 32, 64], frames=3, count=count)
    table = show(
        "brick | generator | CPU µs | bytes | vertices | slices | frame, ms | of the GPU's clock",
        "{brick} | {generator} | {cpu_us:.1f} | {bytes:.0f} | {vertices:.1f} | {slices:.1f} | {draw!m:.1f} | "
        "{gpu!m:.1f}",
        (row for brick in asked.brick for row in generators(asked.data, asked.size, brick, asked.frames)),
        f"{asked.data}, {asked.size} × {asked.size}, {context_of().info['GL_RENDERER']}; of each brick",
    )
    title = "pieces that do not fit together, of random planes; CPU µs a polygon"
    head, cells = "generator | wrong | planes | µs", "{generator} | {wrong} | {planes:,} | {us:.2f}"
    fitting = show(head, cells, watertight(asked.count), title)
    head, cells = (
        "classification | step | renderer | max | rms",
        "{classification} | {step:g} | {renderer} | {max!l:.3f} | {rms!l:.4f}",
    )
    apart = show(head, cells, errors(asked.data, asked.size), f"difference to step {FINE}, in 255ths")
    write(asked, table=table, watertight=fitting, errors=apart)


if __name__ == "__main__":
    main()
