"""What rays save that know the opacity in front of their rank: `python benchmarks/front_opacity.py [--json F]`.

With `quality.early_termination` a ray ends by what its own rank has gathered. Frames of an orbit are drawn

- *own*: like that;
- *same frame*: with the transmittance of all that is in front in this frame, by tiles of 8 pixels. Ranks would have to
  wait for those in front of them to know it: it is what could be gained;
- *last frame*: with that of the last frame: the largest of all tiles from which what is in the box of a piece may have
  come. Where bricks of the piece are in front no longer, they count as transparent.

Each piece is drawn with thresholds that grow by √2, and squares of 8 pixels are taken of that for which there is enough
in front. Ranks are threads of this process, so only samples are counted, not times: of the second half of the frames,
when the dynamic distribution has settled. "Error" is the largest difference from the picture in which no ray ends,
"bound" the most light that came through to where a ray was ended by what was in front of its rank.
"""

from __future__ import annotations

import argparse
import json
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from balance_loop import Opener
from numpy.typing import NDArray
from sort_first import scene_of
from vtk_raycast_ratio import synthetic

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.data.memory import ArraySource
from clusterviz.frame import FrameLoop, Rendered, Run
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.run import Options
from clusterviz.frame.work import RankWork
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import View
from clusterviz.render.render_result import SQUARE, RenderResult, footprint
from clusterviz.report.statistics import RankFrame
from clusterviz.scene import Scene, Volume
from clusterviz.scene.animation import orbit
from clusterviz.scene.overrides import with_settings

Floats = NDArray[np.float64]
WAYS = ("own", "same frame", "last frame")
RESIDUAL = 1 / 255
RATIO = 2**0.5
"""Of neighbouring thresholds."""
LEVELS = int(np.log(1 / RESIDUAL) / np.log(RATIO)) + 1
"""As many thresholds are below 1; from there on nothing is drawn."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A piece of the last frame: its bricks, int64 (m, 3), the view, and the largest transmittance of its tiles."""

    bricks: NDArray[np.int64]
    view: View
    through: Floats


class Passing:
    """What ranks share that know what is in front: all of them meet before and after drawing, and one decides."""

    def __init__(self, ranks: int, way: str) -> None:
        self._way = way
        self._share: RankWork | None = None
        self._levels: list[NDArray[np.int64]] = []
        self._drawn: dict[tuple[int, int], RenderResult] = {}
        self._chosen: list[tuple[PartialImage, int]] = []
        self._last: list[Seen] = []
        self._before = threading.Barrier(ranks, self._assume, 300)
        self._after = threading.Barrier(ranks, self._choose, 300)
        self.bounds: list[float] = []

    def draw(self) -> Callable[[Drawing, Run, RankWork, Iterable[Rect] | None], tuple[list[PartialImage], RankFrame]]:
        """In place of `Drawing.draw`."""

        def draw(
            drawing: Drawing, run: Run, share: RankWork, tiles: Iterable[Rect] | None = None
        ) -> tuple[list[PartialImage], RankFrame]:
            self._share, drawing.sample_counts = share, []
            self._before.wait()
            mine = [at for at, piece in enumerate(share.pieces) if piece.rank == run.channel.rank]
            for at in mine:
                known = np.unique(self._levels[at][self._levels[at] < LEVELS]).tolist()
                for level in range(LEVELS) if self._way == "same frame" else known:
                    assert drawing._renderers is not None
                    plan = with_residual(self._plan, RESIDUAL * RATIO**level)
                    (self._drawn[at, level],) = drawing._renderers.draw(plan, [share.pieces[at]])
            self._after.wait()
            chosen = [self._chosen[at] for at in mine]
            return [partial for partial, _ in chosen], RankFrame({}, samples=sum(taken for _, taken in chosen))

        return draw

    @property
    def _plan(self) -> Plan:
        assert self._share is not None
        assert self._share.plan is not None
        return self._share.plan

    def _assume(self) -> None:
        """A level for each square of each piece, by the last frame."""
        assert self._share is not None
        plan, self._drawn, self._levels = self._plan, {}, []
        number = np.full(plan.cost.shape, -1)
        for at, piece in enumerate(self._share.pieces):
            number[tuple(piece.members(plan.cost > 0).T)] = at
        moved = [(seen.bricks, moved_to(plan, seen)) for seen in self._last]
        for at, piece in enumerate(self._share.pieces):
            front = np.ones(plan.view.size[::-1])
            for bricks, through in moved:
                behind = bricks[number[tuple(bricks.T)] >= at]
                if len(behind) < len(bricks):
                    front *= uncovered(through, plan, behind) if len(behind) else through
            self._levels.append(levels_of(front[slices(footprint(plan, piece))]))

    def _choose(self) -> None:
        """Put pieces together of the squares of their levels, from front to back."""
        assert self._share is not None
        plan, self._chosen, bound = self._plan, [], 0.0
        front, self._last = np.ones(plan.view.size[::-1]), []
        for at, piece in enumerate(self._share.pieces):
            rect = footprint(plan, piece)
            if self._way == "same frame":
                self._levels[at] = levels_of(front[slices(rect)])
            levels, rgba, samples = self._levels[at], np.zeros((rect.height, rect.width, 4), np.float32), 0
            pixels = levels.repeat(SQUARE, axis=0).repeat(SQUARE, axis=1)[: rect.height, : rect.width]
            for level in np.unique(levels).tolist():
                drawn = self._drawn.get((at, level))
                if drawn and drawn.partial.rect.pixels:
                    rgba = np.where((pixels == level)[..., None], drawn.partial.rgba, rgba)
                    samples += int(drawn.work[levels == level].sum())
            own = np.ones_like(front)
            own[slices(rect)] = 1.0 - rgba[..., 3]
            front *= own
            ended = (pixels > 0) & (own[slices(rect)] <= RESIDUAL * RATIO**pixels * 1.00001)
            bound = max(bound, float(front[slices(rect)][ended].max(initial=0.0)))
            self._chosen.append((PartialImage(rect, np.ascontiguousarray(rgba)), samples))
            if self._way == "last frame":
                tiles = largest(own).repeat(SQUARE, axis=0).repeat(SQUARE, axis=1)
                seen = Seen(piece.members(plan.cost > 0), plan.view, tiles[: own.shape[0], : own.shape[1]])
                self._last.append(seen)
        self.bounds.append(bound)


def slices(rect: Rect) -> tuple[slice, slice]:
    """Where a rectangle's pixels lie in a picture."""
    return slice(rect.y_begin, rect.y_end), slice(rect.x_begin, rect.x_end)


def levels_of(front: Floats) -> NDArray[np.int64]:
    """By how many steps thresholds of squares may grow, by the transmittance of pixels in front of them."""
    return np.asarray(-np.log(np.maximum(largest(front), RESIDUAL / 2)) / np.log(RATIO) + 1e-9).astype(np.int64)


def moved_to(plan: Plan, seen: Seen) -> Floats:
    """The transmittance of a piece in another view: the largest of wherever what is in its box may have come from."""
    side, image = plan.layout.brick, seen.through
    begin, end = seen.bricks.min(axis=0) * side, (seen.bricks.max(axis=0) + 1) * side
    low, high = (np.minimum(each, plan.layout.cells_zyx)[::-1] for each in (begin, end))
    corners = np.array([[(low, high)[b >> k & 1][k] for k in range(3)] for b in range(8)], float)
    shift = projected(plan.view, corners) - projected(seen.view, corners)
    for axis in (0, 1):
        least, most = np.floor(shift[:, 1 - axis].min()), np.ceil(shift[:, 1 - axis].max())
        image = slid(image, int(least), int(most), axis)
    return image


def projected(view: View, points: Floats) -> Floats:
    """Pixels (x, y) of points in index space, all of them in front of the eye."""
    ahead, aside = view._camera_coordinates(points)
    aside = aside if view.parallel else aside / ahead[:, None]
    return np.asarray(np.array(view.size) / 2 + aside * np.array([1, -1]) / view.pixel)


def slid(image: Floats, least: int, most: int, axis: int) -> Floats:
    """The largest of the pixels `least` to `most` before each along an axis; 1 beyond the edges."""
    line = np.moveaxis(image, axis, -1)
    padding = max(abs(least), abs(most))
    padded = np.pad(line, [(0, 0), (padding, padding)], constant_values=1.0)
    windows = np.lib.stride_tricks.sliding_window_view(padded, most - least + 1, axis=-1)
    first = padding - most
    return np.moveaxis(windows[:, first : first + line.shape[-1]].max(axis=-1), -1, axis)


def uncovered(through: Floats, plan: Plan, bricks: NDArray[np.int64]) -> Floats:
    """The same, but 1 where one of some bricks may lie."""
    begin, found = bricks * plan.layout.brick, through.copy()
    end = np.minimum(begin + plan.layout.brick, plan.layout.cells_zyx)
    for rect in plan.view.footprints(begin[:, ::-1].astype(float), end[:, ::-1].astype(float)).tolist():
        found[slices(Rect(*rect))] = 1.0
    return found


def with_residual(plan: Plan, residual: float) -> Plan:
    """A plan whose rays end otherwise."""
    return replace(plan, march=replace(plan.march, residual=residual))


def largest(image: Floats) -> Floats:
    """Of each square of pixels; the last ones may be cut."""
    rows, columns = (-(-n // SQUARE) for n in image.shape)
    padded = np.zeros((rows * SQUARE, columns * SQUARE))
    padded[: image.shape[0], : image.shape[1]] = image
    found: Floats = padded.reshape(rows, SQUARE, columns, SQUARE).max(axis=(1, 3))
    return found


def draw(
    scenes: Sequence[Scene], open_voxels: Opener, ranks: int, way: str = "own"
) -> tuple[list[Rendered], list[float]]:
    """An orbit, drawn one way, and the bound on each frame's error."""
    passing = Passing(ranks, way)

    def on_rank(channel: Channel) -> list[Rendered]:
        with FrameLoop(scenes[0], channel, open_voxels(), Options(device="cpu")) as loop:
            return [loop.frame(scene, number) for number, scene in enumerate(scenes)]

    with nullcontext() if way == "own" else patch.object(Drawing, "draw", passing.draw()):
        return run_loopback(ranks, on_rank, timeout_seconds=600)[0], passing.bounds or [0.0] * len(scenes)


def samples_of(frames: Sequence[Rendered]) -> NDArray[np.float64]:
    """Of each frame and rank."""
    return np.array([[rank.samples for rank in frame.statistics.per_rank] for frame in frames], float)


def measure(
    name: str, ranks: int, distribution: str, degrees: float, options: argparse.Namespace
) -> list[dict[str, Any]]:
    """A row a way."""
    base, open_voxels = scene_with(name, options.size)
    with FrameLoop(base, LoopbackChannel(), open_voxels(), several=False) as loop:
        base = loop.scene
    views = orbit(base.camera, degrees * options.frames, options.frames + 1)[:-1]
    scenes = [base.model_copy(update={"camera": view}) for view in views]
    half = slice(options.frames // 2, None)
    alone = samples_of(draw(scenes[half], open_voxels, 1)[0]).sum()
    whole, _ = draw([with_settings(scene, {"early_termination": 0.0}) for scene in scenes[half]], open_voxels, 1)
    shared = [with_settings(one, {"distribution": distribution, "migration_share": 1.0}) for one in scenes]
    rows: list[dict[str, Any]] = []
    own = np.ones((1, 1))
    for way in options.ways:
        frames, bounds = draw(shared, open_voxels, ranks, way)
        frames, samples = frames[half], samples_of(frames[half])
        own = samples if way == "own" else own
        errors = [np.abs(a.image - b.image).max() for a, b in zip(frames, whole, strict=True)]  # type: ignore[operator]
        rows.append(
            {
                "scene": name,
                "ranks": ranks,
                "distribution": distribution,
                "degrees": degrees,
                "way": way,
                "of all": samples.sum() / samples_of(whole).sum(),
                "of one rank's": samples.sum() / alone,
                "of own": samples.sum() / own.sum(),
                "busiest, of own": samples.max(axis=1).sum() / own.max(axis=1).sum(),
                "imbalance": float((samples.max(axis=1) / samples.mean(axis=1)).mean()),
                "error": float(max(errors)),
                "bound": max(bounds[half]),
            }
        )
        show(rows[-1])
    return rows


def show(row: dict[str, Any]) -> None:
    """A line of a table in Markdown."""
    cells = (
        f"{value:.{4 if key in ('error', 'bound') else 3}f}" if isinstance(value, float) else str(value)
        for key, value in row.items()
    )
    print(f"| {' | '.join(cells)} |", flush=True)


def scene_with(name: str, size: int) -> tuple[Scene, Opener]:
    """The head of `examples/head.yaml`, or a ball of waves, about half of which is visible."""
    ends: dict[str, Any] = {"early_termination": RESIDUAL, "mode": "sort-last"}
    if name == "head":
        return with_settings(scene_of("head", size)[0], ends), lambda: scene_of("head", size)[1]
    voxels, opacity = synthetic(160), ((0.0, 0.0), (60.0, 0.0), (120.0, 0.05), (255.0, 0.3))
    volume = Volume(path="waves", clim=(0.0, 255.0), opacity=opacity, opacity_unit_distance=1.0)
    scene = with_settings(Scene(volumes=(volume,)), ends | {"size": (size, size), "brick": 16})
    return scene, lambda: ArraySource(voxels)


def main() -> None:
    """Print a table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=("head", "waves"), default=["head", "waves"])
    parser.add_argument("--ranks", type=int, nargs="+", default=[2, 4, 7])
    parser.add_argument("--distributions", nargs="+", default=["coherent", "dynamic"])
    parser.add_argument("--degrees", type=float, nargs="+", default=[0.25, 1.0, 4.0], help="from frame to frame")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.json:
        check_replaceable(options.json)
    rows: list[dict[str, Any]] = []
    for name in options.scenes:
        for ranks in options.ranks:
            for distribution in options.distributions:
                for degrees in options.degrees:
                    rows += measure(name, ranks, distribution, degrees, options)
    if options.json:
        with replacing(options.json) as temporary:
            temporary.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
