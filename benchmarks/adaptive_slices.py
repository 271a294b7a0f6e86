"""Adaptive sampling in three dimensions: `python benchmarks/adaptive_slices.py [DATA …] [--size N] [--json F]`.

For each volume and each largest error that a pixel may have, against all samples on the same slices: the least share of
samples, by the tolerance of each oracle that is found by halving; in three dimensions, and along rays alone. Beside it
the ray caster's samples with empty-space skipping, and with `quality.adaptive` at the same bound. `vessels` is made
here: branching tubes in an empty cube, as of an angiography.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.3.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from measuring import Row, loaded, opened, options, prepared, sample, show, timed, whole_pieces, write
from numpy.typing import NDArray

from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Source
from clusterviz.plan.plan import Plan
from clusterviz.plan.sampling_oracle import SamplingOracle, distance_by_bend, distance_to_change
from clusterviz.render.slices.adaptive import AdaptivePicture, draw_adaptively
from clusterviz.scene.values import ImageSettings, Quality, Scene, Volume

BOUNDS = (1 / 255, 4 / 255, 16 / 255)
HALVINGS = 6
LOWEST, HIGHEST = -5.0, 2.0
"""Decimal logarithms of tolerances."""
ORACLES: dict[str, Callable[..., SamplingOracle]] = {"change": distance_to_change, "bend": distance_by_bend}
ALL = SamplingOracle(np.zeros((1, 1, 1), np.float32), 1 << 20)
LOOKS: dict[str, dict[str, Any]] = {
    "vessels": {"clim": (0, 1), "opacity": ((0, 0), (0.3, 0), (0.6, 0.5), (1, 0.9)), "opacity_unit_distance": 2.0}
}


def vessels(side: int = 256) -> NDArray[np.float32]:
    """Tubes that branch, 1 inside and 0 outside, with soft walls."""
    rng, found = np.random.default_rng(7), np.full((side,) * 3, 1e9, np.float32)
    branches = [(np.array([0.5, 0.5, 0.1]) * side, np.array([0.0, 0.0, 1.0]), 0.02 * side)]
    while branches:
        at, way, radius = branches.pop()
        for _ in range(36):
            # Back to the middle from the border.
            way = way + 0.15 * rng.normal(size=3) + 0.3 * (0.5 - at / side) ** 3 * 8
            way /= np.linalg.norm(way)
            at = at + 0.5 * radius * way
            low, high = (np.clip(np.round(at + sign * 3 * radius), 0, side).astype(int) for sign in (-1, 1))
            z, y, x = np.ogrid[tuple(slice(*ends) for ends in zip(low[::-1], high[::-1], strict=True))]
            part = found[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
            away = np.sqrt((x - at[0]) ** 2 + (y - at[1]) ** 2 + (z - at[2]) ** 2) - radius
            np.minimum(part, away, out=part)
        if radius > 0.005 * side:
            branches += [(at, way + 0.8 * rng.normal(size=3), share * radius) for share in (0.8, 0.65)]
    return np.clip(0.5 - 0.5 * found, 0, 1)


def planned(source: Source, name: str, size: int, **quality: Any) -> tuple[Plan, dict[Any, Any]]:
    """The plan of a volume with its look, and its bricks."""
    volume, image = Volume(path=name, **LOOKS.get(name, {})), ImageSettings(size=(size, size))
    return prepared(Scene(volumes=(volume,), image=image, quality=Quality(**quality)), [source])


def cast(source: Source, name: str, size: int, **quality: Any) -> tuple[int, float]:
    """The ray caster's samples, and the least seconds of a frame."""
    plan, bricks = planned(source, name, size, **quality)
    caster = loaded(plan, bricks, "cpu")
    runs = [timed(lambda: caster.draw(plan, whole_pieces(plan))[0]) for _ in range(3)]
    return runs[-1].value.samples, min(run.wall for run in runs)


def adaptive(*given: Any, **how: Any) -> tuple[AdaptivePicture, float]:
    """A picture, and its seconds."""
    run = timed(lambda: draw_adaptively(*given, **how))
    return run.value, run.wall


def least(
    plan: Plan, voxels: NDArray[Any], truth: AdaptivePicture, oracle: str, bound: float, along_rays: bool
) -> dict[str, Any]:
    """The largest tolerance with which no pixel is off by more than a bound."""
    low, high = LOWEST, HIGHEST
    best: dict[str, Any] = {}
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        found, seconds = adaptive(
            plan, voxels, ORACLES[oracle](voxels, plan.volume.transfer, 10**middle), along_rays=along_rays
        )
        error = float(np.abs(found.rgba - truth.rgba).max())
        if error <= bound:
            low, best = middle, {"tolerance": 10**middle, "share": found.share, "error": error, "seconds": seconds}
        else:
            high = middle
    return best


def measured(data: str, size: int) -> Iterator[Row]:
    """All rows of a volume."""
    name = sample(name=data) if data == "mni152" else data
    source = ArraySource(vessels()) if data == "vessels" else opened(name)[0]
    plan, _ = planned(source, name, size, renderer="slices")
    voxels = np.asarray(source.read((0, 0, 0), source.grid.shape_zyx))
    adaptive(plan, voxels, ALL, coarsest=0)
    truth, seconds = adaptive(plan, voxels, ALL, coarsest=0)
    yield {"data": data, "way": "all samples", "share": truth.share, "seconds": seconds}
    samples, seconds = cast(source, name, size, renderer="slices")
    yield {"data": data, "way": "ray caster", "share": samples / truth.uniform, "seconds": seconds}
    for bound in BOUNDS:
        samples, seconds = cast(source, name, size, adaptive=bound)
        share = samples / truth.uniform
        yield {"data": data, "way": "quality.adaptive", "bound": bound, "share": share, "seconds": seconds}
        for oracle in ORACLES:
            for along_rays in (False, True):
                row = {"data": data, "way": f"{oracle}, {'along rays' if along_rays else 'in 3-D'}", "bound": bound}
                yield row | least(plan, voxels, truth, oracle, bound, along_rays)


def main() -> None:
    """Print the table; what has no share was not reached."""
    data = {"names": ["data"], "nargs": "*", "default": ["vessels", "mni152", "field:hydrogen:128"]}
    asked = options(__doc__, data=data, size=384)
    head = "data | way | bound, of 255 | share of samples | largest error, of 255 | seconds"
    cells = "{data} | {way} | {bound!l:.0f} | {share:.2%} | {error!l:.2f} | {seconds:.3f}"
    write(asked, rows=show(head, cells, (row for name in asked.data for row in measured(name, asked.size))))


if __name__ == "__main__":
    main()
