"""Choice of the level of each brick: as coarse as an error allows, or as fine as a budget does.

For an error, a limit on what any brick contributes to a pixel says, through the transfer function, how large an error
of the field its surroundings may have: the border of a brick is that of its coarsest neighbour. So a limit gives the
levels of all bricks at once, and is found by bisection: they are those at which a priority queue stops that refines the
brick which contributes most.

For a budget, the errors of all bricks in all pixels are added up, and a price of what they take: each brick has the
level that is cheapest in both. The price at which all fits is found by bisection. This is the queue that refines where
error falls most for what it takes. Most of a brick is far nearer to the finest level than the bound of its error says,
so a part of this bound is what counts.

Nothing here depends on clocks, and all ranks choose the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.levels import LevelMap, mixed_type
from clusterviz.data.source import Grid, MultilevelSource
from clusterviz.errors import SceneError
from clusterviz.plan.content import VolumeLayer
from clusterviz.plan.detail import levels_in_bricks
from clusterviz.plan.domain import Cut, count_in_boxes
from clusterviz.plan.encoding import make_encoding
from clusterviz.plan.picture_bound import SLAB, FieldError, Floats, PictureBound, Rays, dilated
from clusterviz.plan.plan import Plan
from clusterviz.plan.ray_sampling import clip_planes
from clusterviz.plan.view import make_view
from clusterviz.report.decisions import Detail
from clusterviz.scene.values import Scene

Levels = NDArray[np.uint8]
GUIDES = 4096
"""Rays, at most, by which limits are compared; the result is checked by all."""
TYPICAL = 1 / 16
"""Error of most of a brick over its bound; between 1/8 and 1/32, pictures of heads had the least errors."""
PRICES, BISECTIONS = (-80.0, 40.0), 40
LIMITS = np.append(2.0 ** -np.arange(0.0, 24.5, 0.5), 0.0)


@dataclass(frozen=True, eq=False)
class VolumeLevels:
    """What is known of a volume with levels. `grid`, `dtype`: of its samples."""

    grid: Grid
    dtype: np.dtype[Any]
    errors: FieldError  # of its levels


@dataclass(frozen=True, eq=False)
class Refiner:
    """Chooser of the levels of a volume for a picture.

    `drawn`: bool (bz, by, bx), bricks of which anything may be drawn; the others are at the finest level, which costs
    nothing and leaves their neighbours' borders as they are.
    """

    bound: PictureBound  # of the error of pictures
    field: FieldError  # errors of the levels that may be chosen
    drawn: NDArray[np.bool_]

    def within_error(self, rays: Rays, error: float) -> Levels:
        """Return coarse levels whose picture has no larger error; the finest that help if there are none."""
        pixels, guides = rays.pixels, rays.guides(GUIDES)
        while True:
            weights = self.bound.weights(rays, guides)[..., 1]
            low, high = 0, len(LIMITS) - 1
            while low < high:
                middle = (low + high) // 2
                levels = self._levels(LIMITS[middle], weights)
                holds = self.bound.trace(rays, self.field.of(levels), guides)[0].max(initial=0.0) <= error
                low, high = (low, middle) if holds else (middle + 1, high)
            levels = self._levels(LIMITS[low], weights)
            bounds, _ = self.bound.trace(rays, self.field.of(levels), pixels)
            worst = np.argsort(bounds, kind="stable")[-GUIDES // 16 :]
            worst = worst[bounds[worst] > error]
            missed = ~(pixels[worst][:, None] == guides[None]).all(axis=-1).any(axis=1)
            if not missed.any():
                return levels
            guides = np.concatenate([guides, pixels[worst[missed]]])

    def within_budget(self, rays: Rays, sizes: Floats, fits: Callable[[Levels], bool]) -> Levels:
        """Return the levels of least error that fit; the coarsest if none do.

        `sizes`: float64 (levels,), what a brick takes of the budget at each level. `fits`: returns whether levels,
        uint8 (bz, by, bx), are within the budget.
        """
        guides = rays.guides(GUIDES)
        weights = self.bound.weights(rays, guides)[..., 0] / len(guides)
        parts = [self.bound.terms(errors * TYPICAL)[..., SLAB] * weights for errors in self.field.errors]
        errors, sizes = np.stack(parts), sizes[:, None, None, None] / sizes.max()

        def chosen(price: float) -> Levels:
            levels = np.argmin(errors + math.exp2(price) * sizes, axis=0)
            return np.where(self.drawn, levels, 0).astype(np.uint8)

        uniform = (np.full(self.drawn.shape, level, np.uint8) for level in range(len(sizes)))
        whole = next((levels for levels in uniform if fits(levels)), None)
        low, high = PRICES
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (low, middle) if fits(chosen(middle)) else (middle, high)
        levels = chosen(high)
        if whole is None:
            return levels
        # Samples of one level may take less, as they are not interpolated.
        totals = [np.take_along_axis(errors, each[None].astype(int), 0).sum() for each in (whole, levels)]
        return whole if totals[0] <= totals[1] or not fits(levels) else levels

    def _levels(self, limit: float, weights: Floats) -> Levels:
        """Return the coarsest levels at which no brick contributes more than a limit, by the weights of their slabs."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            most = np.where(weights > 0, limit / weights, np.inf)
        allowed = dilated(self.bound.tolerated(most), np.minimum)
        levels = (self.field.errors[1:] <= allowed).sum(axis=0).astype(np.uint8)
        return np.where(self.drawn, levels, 0).astype(np.uint8)


def field_error(source: MultilevelSource) -> FieldError:
    """Return the errors of a volume's levels in its bricks of cells; see `LevelMap`."""
    shape = BrickLayout(source.grid.shape_zyx, source.brick).counts_zyx
    z, y, x = np.indices(shape, sparse=True)
    errors = np.empty((source.levels, *shape))
    for level in range(len(errors)):
        found = source.bounds(level)
        if level == 0:
            # Bricks of cells end with the first samples of the next bricks.
            (low, high, first), last = found, [n - 1 for n in found.shape[1:]]
            for axis, (count, most) in enumerate(zip(shape, last, strict=True)):
                near, far = np.arange(count), np.minimum(np.arange(1, count + 1), most)
                low = np.minimum(low.take(near, axis), low.take(far, axis))
                high = np.maximum(high.take(near, axis), high.take(far, axis))
                first = np.maximum(first.take(near, axis), first.take(far, axis))
            errors[0] = first
        else:
            errors[level] = np.maximum(found[2][z >> level, y >> level, x >> level], errors[level - 1])
    return FieldError(low - errors[0], high + errors[0], errors, source.dtype.kind != "f")


Owners = Callable[[Floats], NDArray[np.int64]]
"""Returns the rank of each brick by the cost of bricks, both (bz, by, bx)."""


def with_detail(
    plan: Plan, scene: Scene, volumes: Sequence[VolumeLevels | None], owners: Owners, bytes_per_second: float = 0.0
) -> Plan:
    """Return a plan with the levels that its view needs, and the bound of the error of each volume.

    Parameters
    ----------
    plan : with content
    scene : completed
    volumes : what is known of each volume; None of one without levels
    owners : of the plan's bricks
    bytes_per_second : of samples that a rank reads, for volumes with a time

    Raises
    ------
    SceneError
        An error is asked for where no bound of it is known.
    """
    content = plan.content
    parts, told = list(content.volume_layers), list[Detail]()
    sampled = zip(scene.drawn_as("samples").items(), content.volume_layers, volumes, strict=True)
    for number, ((key, section), part, known) in enumerate(sampled):
        asked = section.detail
        if asked == "full" or part.levels is None or known is None:
            continue
        reason = _why_unbounded(part)
        if reason and asked.error is not None:
            text, allowed = f"no bound of the error is known {reason}", "level, memory or seconds"
            raise SceneError(text, where=f"{key}.detail.error", found=asked.error, allowed=allowed)
        grid, brick, field = known.grid, part.levels.brick, known.errors
        drawn = _drawn_bricks(plan, part.cut, part.levels)
        whole = (
            content.domain.volume is not None and plan.march.lattice == "rays" and scene.quality.borders == "overlap"
        )
        bound = PictureBound(part.transfer, part.slab_units, field, drawn, brick, whole=whole, ramps=part.preintegrated)
        view = make_view(scene.camera, scene.image.size, grid)
        rays = Rays(view, grid.shape_zyx, plan.march.step_world, clip_planes(scene.clip, grid))
        size = partial(_bytes, plan, part, known.dtype, owners(plan.cost))
        levels, most = part.levels.levels, math.inf
        # Levels that differ meet at samples of the coarsest.
        mixable = replace(field, errors=field.errors[: (brick & -brick).bit_length()])
        refiner = Refiner(bound, mixable, drawn)
        if asked.error is not None:
            levels, finest = refiner.within_error(rays, asked.error), np.zeros_like(levels)
            # Samples of one level may take less, as they are not interpolated.
            levels = levels if size(levels) < size(finest) else finest
        elif asked.level is None:
            most = asked.memory or (asked.seconds or 0.0) * bytes_per_second
            sizes = np.array([(brick / 2**level + 1) ** 3 for level in range(len(mixable.errors))])
            levels = refiner.within_budget(rays, sizes, partial(_fits, size, most))
        found = _error(bound, rays, field.of(levels), plan.march.residual) if not reason else None
        store = _error(bound, rays, field.errors[0], plan.march.residual) if not reason else None
        counts = tuple(np.bincount(levels[drawn]).tolist())
        reached = size(levels) <= most and (asked.error is None or (found or 0.0) <= asked.error)
        told.append(Detail(number, counts, size(levels), reached, found, store, reason))
        level_map = LevelMap(levels, brick)
        encoding = make_encoding(mixed_type(known.dtype, level_map), part.transfer.domain)
        held = levels_in_bricks(part.cut, level_map)
        parts[number] = replace(part, levels=level_map, brick_levels=held, encoding=encoding)
    return replace(plan, content=replace(content, volume_layers=tuple(parts)), detail=tuple(told))


def _why_unbounded(part: VolumeLayer) -> str:
    """Return with what no bound is known; "" if one is."""
    mode = part.blend_mode
    if part.filter != "linear":
        return f"with interpolation: {part.filter}"
    return "with light, isosurfaces or gradients" if mode.shading or mode.grading or mode.surfaces else ""


def _error(bound: PictureBound, rays: Rays, errors: Floats, residual: float) -> float:
    """Return the largest bound of a pixel, with what rays that end early may lack in both pictures."""
    if not errors.any():
        return 0.0
    found = float(bound.trace(rays, errors, rays.pixels)[0].max(initial=0.0))
    return min(found + 2 * residual, 1.0) if found else 0.0


def _fits(size: Callable[[Levels], int], most: float, levels: Levels) -> bool:
    return size(levels) <= most


def _bytes(plan: Plan, part: VolumeLayer, dtype: np.dtype[Any], owners: NDArray[np.int64], levels: Levels) -> int:
    """Return the bytes of samples at these levels that the rank with most holds for drawing."""
    assert part.levels is not None, "the volume has levels"
    level_map, cut = LevelMap(levels, part.levels.brick), part.cut
    encoding = make_encoding(mixed_type(dtype, level_map), part.transfer.domain)
    item = {"u8": 1, "u16": 2, "f32": 4}[encoding.kind]
    sides = [cut.at(level).most_cells_zyx for level in range(int(levels.max()) + 1)]
    sizes = np.array([item * math.prod(side + 1 + 2 * cut.margin for side in each) for each in sides])
    held = np.where((plan.cost > 0) & cut.bricks_met(), sizes[levels_in_bricks(cut, level_map)], 0)
    return int(np.bincount(owners.reshape(-1), held.reshape(-1)).max())


def _drawn_bricks(plan: Plan, cut: Cut, level_map: LevelMap) -> NDArray[np.bool_]:
    """Return the bricks of a volume, bool (bz, by, bx), that bricks of the domain which are drawn meet."""
    z, y, x = np.indices(level_map.levels.shape)
    begin = level_map.brick * np.stack([x, y, z], axis=-1).astype(np.float64)
    end = np.minimum(begin + level_map.brick, np.array(cut.shape_zyx[::-1]) - 1.0)
    inverse = np.linalg.inv(cut.index_from_domain[:, :3])
    centre = ((begin + end) / 2 - cut.index_from_domain[:, 3]) @ inverse.T
    around = (end - begin) / 2 @ np.abs(inverse).T
    counts = np.array(plan.layout.counts_zyx[::-1])
    # Bricks that just touch it draw nothing of it.
    first = np.clip(np.floor((centre - around) / plan.layout.brick + 1e-6), 0, counts - 1).astype(int)
    last = np.clip(np.ceil((centre + around) / plan.layout.brick - 1e-6), first + 1, counts).astype(int)
    return count_in_boxes(plan.cost > 0, first[..., ::-1], last[..., ::-1]) > 0
