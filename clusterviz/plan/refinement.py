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
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import MultilevelSource
from clusterviz.plan.picture_bound import SLAB, FieldError, Floats, PictureBound, Rays, dilated

Levels = NDArray[np.uint8]
GUIDES = 4096
"""Rays, at most, by which limits are compared; the result is checked by all."""
TYPICAL = 1 / 16
"""Error of most of a brick over its bound; between 1/8 and 1/32, pictures of heads had the least errors."""
PRICES, BISECTIONS = (-80.0, 40.0), 40
LIMITS = np.append(2.0 ** -np.arange(0.0, 24.5, 0.5), 0.0)


@dataclass(frozen=True, eq=False)
class Refiner:
    """Chooser of the levels of a volume for a picture.

    Attributes
    ----------
    bound : of the error of pictures
    field : errors of the levels that may be chosen
    drawn : bool (bz, by, bx), bricks of which anything may be drawn; the others are at the finest level, which costs
        nothing and leaves their neighbours' borders as they are
    """

    bound: PictureBound
    field: FieldError
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

        Parameters
        ----------
        sizes : float64 (levels,), what a brick takes of the budget at each level
        fits : returns whether levels, uint8 (bz, by, bx), are within the budget
        """
        guides = rays.guides(GUIDES)
        weights = self.bound.weights(rays, guides)[..., 0] / len(guides)
        parts = [self.bound.terms(errors * TYPICAL)[..., SLAB] * weights for errors in self.field.errors]
        errors, sizes = np.stack(parts), sizes[:, None, None, None] / sizes.max()

        def chosen(price: float) -> Levels:
            levels = np.argmin(errors + math.exp2(price) * sizes, axis=0)
            return np.where(self.drawn, levels, 0).astype(np.uint8)

        low, high = PRICES
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (low, middle) if fits(chosen(middle)) else (middle, high)
        return chosen(high)

    def _levels(self, limit: float, weights: Floats) -> Levels:
        """Return the coarsest levels at which no brick contributes more than a limit, by the weights of their slabs."""
        with np.errstate(divide="ignore", invalid="ignore"):
            most = np.where(weights > 0, limit / weights, np.inf)
        allowed = dilated(self.bound.tolerated(most), np.minimum)
        levels = (self.field.errors[1:] <= allowed).sum(axis=0).astype(np.uint8)
        return np.where(self.drawn, levels, 0).astype(np.uint8)


def field_error(source: MultilevelSource, valid: bool) -> FieldError:
    """Return the errors of a volume's levels in its bricks of cells; see `LevelMap`.

    Parameters
    ----------
    source : the volume; levels that may be mixed with others are 0 … log₂ of its bricks' side
    valid : all samples are finite
    """
    shape = BrickLayout(source.grid.shape_zyx, source.brick).counts_zyx
    z, y, x = np.indices(shape, sparse=True)
    errors = np.empty((min(source.levels, source.brick.bit_length()), *shape))
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
    return FieldError(low - errors[0], high + errors[0], errors, valid)
