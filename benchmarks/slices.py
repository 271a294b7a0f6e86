"""View-aligned slices: `python benchmarks/slices.py [DATA] [--size N] [--brick N …] [--count N] [--json F]`.

Tables, of which `--tables` names some:
- the thesis's table 5.1 [1], measured: per brick the CPU's time, bytes and vertices of each slice generator, and the
  time of a frame that OpenGL draws with them, beside the ray caster on the same planes;
- a million random boxes and planes: where two boxes with a common face have not the area of both together;
- errors of `quality.renderer: slices` and of rays with the same steps, against rays of step 1/16;
- adaptive sampling in three dimensions (section 4.3.1): for each volume of `--adaptive` and each largest error of a
  pixel the least share of samples on the slices, by the tolerance of each oracle that halving finds, along rays alone
  and in 3-D, beside the ray caster's with `quality.adaptive`. `vessels` are those of partial_images.py.

References
----------
[1] M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from measuring import (
    Row,
    context_of,
    loaded,
    opened,
    options,
    positional,
    prepared,
    sample,
    show,
    timed,
    whole_pieces,
    write,
)
from numpy.typing import NDArray
from partial_images import grow_vessels

import clusterviz
from clusterviz.data.memory import ArraySource
from clusterviz.plan.plan import Plan
from clusterviz.plan.sampling_oracle import SamplingOracle, distance_by_bend, distance_to_change
from clusterviz.plan.slices import GENERATORS, Cuts
from clusterviz.render.slices import SliceDrawing
from clusterviz.render.slices.adaptive import AdaptivePicture, draw_adaptively
from clusterviz.scene.values import Cluster, ImageSettings, Quality, Scene, Volume

CHUNK = 20_000
STEPS = (0.5, 1.0, 2.0)
FINE = 1 / 16
ROUNDING = 1e-11
BOUNDS = (1 / 255, 4 / 255, 16 / 255)
ORACLES: dict[str, Callable[..., SamplingOracle]] = {"change": distance_to_change, "bend": distance_by_bend}
EVERYWHERE = SamplingOracle(np.zeros((1, 1, 1), np.float32), 1 << 20)
VESSELS: dict[str, Any] = {"clim": (0, 255), "opacity": ((0, 0), (80, 0), (150, 0.5), (255, 0.9))}


def planned(data: str, size: int, brick: int = 64, **quality: Any) -> tuple[Plan, dict[Any, Any]]:
    """Plan and bricks of the data with its usual look."""
    path = sample(name=data) if data == "mni152" else data
    look = VESSELS | {"opacity_unit_distance": 2.0} if data == "vessels" else {}
    source = ArraySource(grow_vessels(256)) if data == "vessels" else opened(path)[0]
    image, cluster = ImageSettings(size=(size, size)), Cluster(brick=brick)
    scene = Scene(volumes=(Volume(path=path, **look),), image=image, quality=Quality(**quality), cluster=cluster)
    return prepared(scene, [source])


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


def errors(path: str, size: int) -> Iterator[Row]:
    """Largest and root of the mean square difference to a fine picture."""

    def picture(**quality: Any) -> Any:
        return np.asarray(clusterviz.render(path, size=(size, size), **quality), np.float64)

    truth = picture(step=FINE)
    for classification, step, renderer in product(("post", "pre-integrated"), STEPS, ("raycast", "slices")):
        apart = picture(step=step, renderer=renderer, classification=classification) - truth
        row = {"classification": classification, "step": step, "renderer": renderer}
        yield row | {"max": np.abs(apart).max(), "rms": float(np.sqrt(np.mean(apart**2)))}


def voxels_of(data: str) -> NDArray[Any]:
    return grow_vessels(256) if data == "vessels" else opened(sample(name=data) if data == "mni152" else data)[1]


def least(plan: Plan, voxels: NDArray[Any], truth: AdaptivePicture, oracle: str, bound: float, along: bool) -> Row:
    """The largest tolerance, between 10⁻⁵ and 10², with which no pixel is off by more than a bound."""
    low, high, best = -5.0, 2.0, Row()
    for _ in range(6):
        middle = (low + high) / 2
        where = ORACLES[oracle](voxels, plan.volume.transfer, 10**middle)
        found = draw_adaptively(plan, voxels, where, along_rays=along)
        error = float(np.abs(found.rgba - truth.rgba).max())
        if error <= bound:
            low, best = middle, {"share": found.share, "error": error}
        else:
            high = middle
    return best


def adaptive(data: str, size: int) -> Iterator[Row]:
    """A row for each bound and way; what has no share was not reached."""
    plan, _ = planned(data, size, renderer="slices")
    voxels = voxels_of(data)
    truth = draw_adaptively(plan, voxels, EVERYWHERE, coarsest=0)

    def cast(**quality: Any) -> float:
        plan, bricks = planned(data, size, **quality)
        return float(loaded(plan, bricks, "cpu").draw(plan, whole_pieces(plan))[0].samples / truth.uniform)

    yield {"data": data, "way": "all samples", "share": truth.share}
    yield {"data": data, "way": "ray caster", "share": cast(renderer="slices")}
    for bound in BOUNDS:
        yield {"data": data, "way": "ray caster, quality.adaptive", "bound": bound, "share": cast(adaptive=bound)}
        for oracle, along in product(ORACLES, (False, True)):
            row = {"data": data, "way": f"{oracle}, {'along rays' if along else 'in 3-D'}", "bound": bound}
            yield row | least(plan, voxels, truth, oracle, bound, along)


def main() -> None:
    tables = {
        "generators": (
            lambda: (row for brick in asked.brick for row in generators(asked.data, asked.size, brick, asked.frames)),
            "brick | generator | CPU µs | bytes | vertices | slices | frame, ms | of the GPU's clock",
            "{brick} | {generator} | {cpu_us:.1f} | {bytes:.0f} | {vertices:.1f} | {slices:.1f} | {draw!m:.1f} | "
            "{gpu!m:.1f}",
            "of each brick",
        ),
        "watertight": (
            lambda: watertight(asked.count),
            "generator | wrong | planes | µs",
            "{generator} | {wrong} | {planes:,} | {us:.2f}",
            "pieces that do not fit together, of random planes; CPU µs a polygon",
        ),
        "errors": (
            lambda: errors(asked.data, asked.size),
            "classification | step | renderer | max | rms",
            "{classification} | {step:g} | {renderer} | {max!l:.3f} | {rms!l:.4f}",
            f"difference to step {FINE}, in 255ths",
        ),
        "adaptive": (
            lambda: (row for name in asked.adaptive for row in adaptive(name, asked.size)),
            "data | way | bound, of 255 | share of samples | largest error, of 255",
            "{data} | {way} | {bound!l:.0f} | {share:.2%} | {error!l:.2f}",
            "adaptive sampling",
        ),
    }
    asked = options(
        __doc__,
        data=positional("data", default="field:marschner-lobb:128", help="a data file or field"),
        size=384,
        brick=[16, 32, 64],
        frames=3,
        count={"type": int, "default": 1_000_000, "help": "random planes"},
        adaptive=["vessels", "mni152", "field:hydrogen:128"],
        tables={"nargs": "+", "choices": list(tables), "default": list(tables)},
    )
    found = {}
    for name in asked.tables:
        rows, head, cells, title = tables[name]
        found[name] = show(head, cells, rows(), title)
    write(asked, **found)


if __name__ == "__main__":
    main()
