"""The witness of isosurfaces, alone or in a volume: roots by bisection, between the ends of every slab."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.reference.clipping import kept
from clusterviz.reference.fields import SAMPLERS, gradient_at
from clusterviz.reference.grading import needs_gradient, optics
from clusterviz.reference.lighting import lit
from clusterviz.reference.rays import Floats, Rays
from clusterviz.reference.slabs import slabs
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.values import Scene

HALVINGS = 40  # of a slab: far below what a picture can show


def march_surfaces(rays: Rays, voxels: NDArray[Any], length: float, scene: Scene, grid: Grid) -> Floats:
    """The colours of some rays, (n, 4).

    A slab with valid ends has two parts (`parts`). A part whose ends are on different sides of a value has its surface
    there; of several, the one that is nearer in value to the begin is in front. Of each, the crossing that bisection
    finds is taken. In a composited
    volume the parts of a slab before, between and behind its surfaces absorb light as its midpoint does.
    """
    volume = scene.volumes[0]
    classify, sample = transfer_function(volume), SAMPLERS[volume.interpolation]
    wanted = sorted(
        (entry if isinstance(entry, tuple) else (entry, float(classify.opacity(entry)))) for entry in volume.isosurfaces
    )
    rgba = np.zeros((len(rays.direction), 4))

    def absorb(pixels: NDArray[np.int64], alpha: Floats, colour: Floats) -> None:
        share = (1 - rgba[pixels, 3:]) * alpha[:, None]
        rgba[pixels] += share * np.append(colour, np.ones((len(pixels), 1)), axis=1)

    def gradients(point: Floats) -> Floats | None:
        return gradient_at(volume, voxels, point) if needs_gradient(volume) else None

    def lit_up(colour: Floats, gradient: Floats | None, point: Floats, pixels: NDArray[np.int64]) -> Floats:
        if gradient is None or not volume.shade:
            return colour
        return lit(colour, gradient, point, rays.direction[pixels], volume, scene.lights, grid)

    for slab in slabs(rays, voxels.shape, length, lambda: rgba[:, 3] < 1):
        start, direction = rays.start[slab.rays], rays.direction[slab.rays]
        ends = [sample(voxels, *(start + t[:, None] * direction).T) for t in (slab.begin, slab.end)]
        (front, front_valid), (behind, behind_valid) = ends
        valid = front_valid & behind_valid
        cut, at_cut = turn(Rays(start, direction), voxels, sample, slab.begin, slab.end, front, behind)
        middle, known = sample(voxels, *slab.point.T)
        known &= kept(slab.point, scene.clip, grid) & (volume.blending == "composite")
        gradient = gradients(slab.point)
        glow, extinction = optics(volume, classify, middle, gradient, grid)
        glow, extinction = lit_up(glow, gradient, slab.point, slab.rays), np.where(known, extinction, 0)
        begin = slab.begin.copy()
        for low, at_low, high, at_high in ((slab.begin, front, cut, at_cut), (cut, at_cut, slab.end, behind)):
            low = low.copy()
            for value, opacity, rises in both_ways(wanted):
                here = np.flatnonzero(valid & ((at_low < value) != (at_high < value)) & ((at_high > at_low) == rises))
                if not here.size:
                    continue
                some = Rays(start[here], direction[here])
                found = root(some, voxels, sample, value, rises, low[here], high[here])
                there = np.isfinite(found)
                gap = np.where(there, found - begin[here], 0)
                absorb(slab.rays[here], -np.expm1(-extinction[here] * gap), glow[here])
                begin[here] = np.where(there, found, begin[here])
                low[here] = np.where(there, found, low[here])
                point = some.start + begin[here][:, None] * some.direction
                colour = lit_up(classify.colour(np.full(len(here), value)), gradients(point), point, slab.rays[here])
                absorb(slab.rays[here], np.where(there & kept(point, scene.clip, grid), opacity, 0), colour)
        absorb(slab.rays, -np.expm1(-extinction * (slab.end - begin)), glow)
    return rgba


def both_ways(wanted: list[tuple[float, float]]) -> Iterator[tuple[float, float, bool]]:
    """Values, opacities and whether the field rises, as a field that rises meets them, then as one that falls does."""
    yield from ((*entry, True) for entry in wanted)
    yield from ((*entry, False) for entry in reversed(wanted))


def turn(
    rays: Rays, voxels: NDArray[Any], sample: Any, begin: Floats, end: Floats, front: Floats, behind: Floats
) -> tuple[Floats, Floats]:
    """Where slabs are cut in two, and the field there: one that a surface both enters and leaves is not missed.

    At the extremum of the parabola through the field at a slab's begin, middle and end; at the end, if there is none
    between them, or no valid field at one of these places.
    """
    half = (end - begin) / 2
    middle, known = sample(voxels, *(rays.start + (begin + half)[:, None] * rays.direction).T)
    slope, bend = behind - front, front - 2 * middle + behind
    turns = known & (np.abs(slope) < 2 * np.abs(bend))
    place = np.where(turns, begin + half - half * slope / np.where(turns, 2 * bend, 1), end)
    field, valid = sample(voxels, *(rays.start + place[:, None] * rays.direction).T)
    turns &= valid
    return np.where(turns, place, end), np.where(turns, field, behind)


def root(rays: Rays, voxels: NDArray[Any], sample: Any, value: float, rises: bool, low: Floats, high: Floats) -> Floats:
    """Where along each ray, between low and high, the field crosses a value; NaN if it is invalid on the way there."""
    met = np.ones(len(low), bool)
    for _ in range(HALVINGS):
        middle = low + (high - low) / 2
        scalar, valid = sample(voxels, *(rays.start + middle[:, None] * rays.direction).T)
        met &= valid
        before = (scalar < value) == rises
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.where(met, low, np.nan)
