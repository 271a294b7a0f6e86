"""Bound of the error of a picture that is drawn from an inexact field, by the error of the field in each brick.

The field f̃ that is drawn differs from the true one, f, by at most e in a brick, where f lies in [low, high]. Then the
largest change of a function g of the scalar is D = max |g(s + t) − g(s)| over s in [low, high] and |t| ≤ e.

Let slab k of a ray have the opacity a and the straight colour c, and what lies behind it the colour X. Front to back,
slab k shows A(X) = c a + (1 − a) X, and the pixel is A₁(A₂(…)) of the background. The true slabs A and the drawn ones Ã
are exchanged one after the other, those in front first, so

    |P̃ − P| ≤ Σₖ Tₖ |Ãₖ(X̃) − Aₖ(X̃)|,   with the true transparency Tₖ = Π_{j<k} (1 − a_j) in front of slab k.

Each term is linear in X̃, which lies in [0, 1], so it is largest at one of both: it is at most the change D of c a, or
that of (1 − c) a. Nothing here depends on the background, and the bound holds for colours and opacities alike.

A brick's slabs, of which n have their midpoint in it, so contribute at most D (1 + x + … + xⁿ⁻¹) behind a true
transparency of x = e^{−κh} at most a slab, where κ is the least extinction over [low, high]. As together they are one
such operator, they change a pixel by no more than the greatest opacity that they can have. What lies in front is at
least xⁿ. The pixel changes by 1 at most.

A slab that is cut short, or integrated along a ramp (pre-integration), is a limit of thinner ones, of which each
changes by its length times the change of κ c or of κ (1 − c). That is its bound.

Rounding of the renderer is not included, nor that of the picture's file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.kernels.compiled import CompiledKernel
from clusterviz.plan.encoding import FAR, in_units_of_clim
from clusterviz.plan.view import View
from clusterviz.scene.transfer import OPAQUE, TransferFunction, distinct, interpolate

Floats = NDArray[np.float64]
SLAB, SHARE, THIN, DENSE = range(4)
"""Terms of a brick: bounds of what a slab changes, and a shorter one; least and greatest optical depth of a slab."""
EYE, RIGHT, UP, FORWARD, LENS, CENTRE, EXTENT, LATTICE = range(8)
"""Rows of the camera: four vectors in index space; distance of pixels, and whether projection is parallel; half the
picture in pixels; the domain in cells; cells of a brick and length of a slab."""
BINS = 4096
TINY = 1e-12
_TRACE = CompiledKernel(
    "clusterviz.plan.picture_bound_kernel",
    "bound_rays",
    "int64[:,::1]; float64[:,::1]; float64[:,::1]; float64[:,:,:,::1]; int64; float64[::1]; float64[:,:,:,::1]; "
    "float64[:,::1]; float64[:,::1]; int64[:,::1]",
    [Path(__file__), Path(__file__).with_name("picture_bound_kernel.py")],
)


class Change:
    """Largest change of functions of a scalar that varies by an error, in constant time by tables.

    Parameters
    ----------
    low, high : float64 (k, n), bounds of each function in each bin of the scalar; bins are equally wide, but for the
        outer ones, which are endless
    slope : float64 (n,), bound of the slope of all functions in each bin, per bin
    """

    def __init__(self, low: Floats, high: Floats, slope: Floats) -> None:
        count = low.shape[1]
        self.widths = np.array(
            sorted({*range(1, 9), *(int(2 ** (n / 4)) for n in range(12, 4 * count.bit_length())), count})
        )
        lowest, highest = _ranges(low, np.minimum), _ranges(high, np.maximum)
        changes = np.empty((len(self.widths) + 1, count))
        at = np.arange(count)
        for row, width in zip(changes, self.widths.tolist(), strict=False):
            begin, end = np.maximum(at - width, 0), np.minimum(at + width, count - 1)
            least, most = _extreme(lowest, begin, end, np.minimum), _extreme(highest, begin, end, np.maximum)
            row[:] = np.maximum(most - low, high - least).max(axis=0)
        begin, end = np.maximum(at - 1, 0), np.minimum(at + 1, count - 1)
        changes[-1] = np.maximum(slope, np.maximum(slope[begin], slope[end]))
        self._tables = _ranges(changes, np.maximum)

    def largest(self, begin: NDArray[np.int64], end: NDArray[np.int64], error: Floats) -> Floats:
        """Return the largest change, float64 (…), of scalars in bins [begin, end] by errors, in bins."""
        row = np.searchsorted(self.widths, np.minimum(error, self.widths[-1]))
        found: Floats = _extreme(self._tables, begin, end, np.maximum, row)
        small = error < 1
        steep = _extreme(self._tables, begin[small], end[small], np.maximum, np.full(small.sum(), len(self.widths)))
        with np.errstate(invalid="ignore"):
            found[small] = np.where(error[small] > 0, np.fmin(found[small], steep * error[small]), 0.0)
        return found

    def tolerated(self, begin: NDArray[np.int64], end: NDArray[np.int64], most: Floats) -> Floats:
        """Return the errors (n,), in bins, at which scalars in bins [begin, end] change by no more than given."""
        rows, widths = len(self.widths), np.concatenate([[0.0], self.widths, [np.inf]])
        level, last = _level(begin, end)
        found = np.zeros(len(begin), np.int64)
        for row in range(rows):
            found += np.maximum(self._tables[level, row, begin], self._tables[level, row, last]) <= most
        found += found == rows
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            slow = most / np.maximum(self._tables[level, rows, begin], self._tables[level, rows, last])
        return np.where(found > 0, widths[found], np.nan_to_num(np.minimum(slow, 1.0)))


def _ranges(values: Floats, pick: np.ufunc) -> Floats:
    """Return the extremes of 1, 2, 4, … columns from each on, float64 (log n, k, n)."""
    tables = [values]
    for n in range(values.shape[1].bit_length() - 1):
        before, following = tables[-1], np.arange(values.shape[1]) + (1 << n)
        tables.append(pick(before, before[:, np.minimum(following, values.shape[1] - 1)]))
    return np.stack(tables)


def _extreme(
    tables: Floats,
    begin: NDArray[np.int64],
    end: NDArray[np.int64],
    pick: np.ufunc,
    row: NDArray[np.int64] | None = None,
) -> Floats:
    """Return the extremes (k, …) of columns [begin, end], or those (…) of one row for each."""
    level, last = _level(begin, end)
    if row is not None:
        return np.asarray(pick(tables[level, row, begin], tables[level, row, last]))
    return np.asarray(pick(tables[level, :, begin], tables[level, :, last])).T


def _level(begin: NDArray[np.int64], end: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return which table of `_ranges` has half of columns [begin, end] or more, and where the last ones begin."""
    level = np.frexp((end - begin + 1).astype(np.float64))[1].astype(np.int64) - 1
    return level, end + 1 - (1 << level)


@dataclass(frozen=True, eq=False)
class Classified:
    """Opacity and colour of a volume in bins of the scalar, in units of clim.

    Attributes
    ----------
    low, per_unit : scalar at which the second bin begins, and bins per unit; the first and the last bin are endless
    opacity : float64 (2, n), least and greatest opacity over the unit distance in each bin
    colour : float64 (2, 3, n), least and greatest colour
    slopes : float64 (2, n), bounds of the slopes of opacity and of colour, per bin
    """

    low: float
    per_unit: float
    opacity: Floats
    colour: Floats
    slopes: Floats

    def bin_of(self, units: Floats, shift: float) -> NDArray[np.int64]:
        """Return the bins of scalars in units of clim, shifted by a part of a bin; NaN is in the last one."""
        place = np.nan_to_num((units - self.low) * self.per_unit + 1 + shift, nan=np.inf)
        return np.asarray(np.clip(np.floor(place), 0, BINS + 1), np.int64)

    def depth(self, slab_units: float) -> Floats:
        """Return least and greatest optical depth of a slab, float64 (2, n), by its length in unit distances."""
        depth: Floats = -slab_units * np.log1p(-np.minimum(self.opacity, OPAQUE))
        return depth

    def change(self, slab_units: float, whole: bool) -> Change:
        """Return the change of a slab, or if it may be shorter that of its optical depth, each with its colour."""
        (opacity_slope, colour_slope), found = self.slopes, self.depth(slab_units)
        with np.errstate(over="ignore"):
            steep = slab_units / (1 - np.minimum(self.opacity[1], OPAQUE))
            if whole:
                steep = (
                    steep * np.exp(-found[int(slab_units < 1)])
                    if slab_units < 1
                    else slab_units * np.ones(found.shape[1])
                )
                found = -np.expm1(-found)
        low = np.concatenate([found[0] * self.colour[0], found[0] * (1 - self.colour[1]), found[:1]])
        high = np.concatenate([found[1] * self.colour[1], found[1] * (1 - self.colour[0]), found[1:]])
        with np.errstate(invalid="ignore"):
            slope = np.nan_to_num(steep * opacity_slope, nan=np.inf, posinf=np.inf) + found[1] * colour_slope
        return Change(low, high, slope)


def classified(transfer: TransferFunction) -> Classified:
    """Return a transfer function in bins between its first and its last control point."""
    knots = distinct(transfer.opacity_values, transfer.colour_values, np.array(transfer.domain))
    units = np.clip(in_units_of_clim(knots, *transfer.domain), -FAR, FAR)
    low, per_unit = float(units[0]), BINS / float(units[-1] - units[0])
    bottom, top = transfer.domain
    edges = low + np.arange(BINS + 1) / per_unit
    values = bottom * (1 - edges) + top * edges

    def extremes(control: Floats, results: Floats) -> tuple[Floats, Floats]:
        """Return least and greatest results, float64 (2, k, n), and the largest slope (n,)."""
        at_edges = interpolate(values, control, results).T
        first, last = results[0][:, None], results[-1][:, None]
        ends = np.concatenate([first, at_edges], axis=1), np.concatenate([at_edges, last], axis=1)
        least, most = np.minimum(*ends), np.maximum(*ends)
        where = (np.clip(in_units_of_clim(control, bottom, top), -FAR, FAR) - low) * per_unit + 1
        slope = np.zeros(BINS + 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = np.nan_to_num(
                np.abs(np.diff(results, axis=0)).max(axis=1) / np.diff(where), nan=0.0, posinf=np.inf
            )
        for shift in (-1e-6, 1e-6):  # a control point is in the bins on both sides of an edge
            own = np.clip(np.floor(where + shift), 0, BINS + 1).astype(int)
            np.minimum.at(least.T, own, results)
            np.maximum.at(most.T, own, results)
        for begin, end, steep in zip(where[:-1], where[1:], slopes, strict=True):
            piece = slice(max(int(begin - 1e-6), 0), int(end + 1e-6) + 1)
            slope[piece] = np.maximum(slope[piece], steep)
        return np.stack([least, most]), slope

    opacity, opacity_slope = extremes(transfer.opacity_values, transfer.opacities[:, None])
    colour, colour_slope = extremes(transfer.colour_values, transfer.colours)
    return Classified(low, per_unit, opacity[:, 0], colour, np.stack([opacity_slope, colour_slope]))


@dataclass(frozen=True, eq=False)
class FieldError:
    """Error of the field in each brick of a plan's lattice, at each level.

    Attributes
    ----------
    low, high : float64 (bz, by, bx), bounds of the true scalars, also on the brick's faces; inf and -inf without any
    errors : float64 (levels, bz, by, bx), rising with the level; inf or NaN where nothing is known
    valid : no sample is NaN or infinite
    """

    low: Floats
    high: Floats
    errors: Floats
    valid: bool = True

    def of(self, levels: NDArray[np.uint8]) -> Floats:
        """Return the errors, float64 (bz, by, bx), of bricks of these levels.

        Their faces are those of coarser neighbours.
        """
        own: Floats = np.take_along_axis(self.errors, levels[None].astype(np.int64), axis=0)[0]
        found = own
        for level in range(1, int(levels.max()) + 1):
            around = dilated(np.where(levels == level, own, 0.0), np.maximum)
            found = np.where(levels < level, np.maximum(found, around), found)
        return found


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of a picture in the index space of a volume.

    Attributes
    ----------
    view : the camera over the volume's grid
    shape_zyx : samples of the volume
    step_world : length of a slab in world units
    planes : float64 (n, 4), see `clip_planes`
    """

    view: View
    shape_zyx: Index
    step_world: float
    planes: Floats

    @property
    def pixels(self) -> NDArray[np.int64]:
        """All pixels, int64 (n, 2), row by row."""
        width, height = self.view.size
        return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)

    def guides(self, most: int) -> NDArray[np.int64]:
        """Return pixels spread evenly over the picture, int64 (n, 2), at most a given number."""
        width, height = self.view.size
        side = math.ceil(math.sqrt(width * height / most))
        across, down = np.arange(min(side, width) // 2, width, side), np.arange(min(side, height) // 2, height, side)
        return np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)


class PictureBound:
    """Bound of the error of pictures of a volume, whatever the camera.

    Parameters
    ----------
    transfer : the transfer function
    slab_units : length of a slab in opacity unit distances
    field : the error of the volume's bricks
    drawn : bool (bz, by, bx), bricks of which anything may be drawn
    brick : cells along the side of these
    whole : slabs are counted from where rays enter the volume, and sampled at midpoints; nothing cuts or shifts them
    ramps : slabs are classified between their ends
    """

    def __init__(
        self,
        transfer: TransferFunction,
        slab_units: float,
        field: FieldError,
        drawn: NDArray[np.bool_],
        brick: int,
        *,
        whole: bool = True,
        ramps: bool = False,
    ) -> None:
        self._field, self._drawn, self._brick, self._ramps = field, drawn, brick, ramps
        self._domain, self._cuts = transfer.domain, int(not whole)
        arrays = (transfer.colour_values, transfer.colours, transfer.opacity_values, transfer.opacities)
        found = _tables(*(array.tobytes() for array in arrays), transfer.domain, slab_units, whole and not ramps)
        self._binned, self._share, self._slab, self._least, self._most = found

    @cached_property
    def _bins(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Bins of the true scalars of those bricks that are drawn, first and last one, and which bricks these are."""
        low, high = in_units_of_clim(self._field.low, *self._domain), in_units_of_clim(self._field.high, *self._domain)
        shown = self._drawn & (low <= high)
        return self._binned.bin_of(low[shown], -1e-6), self._binned.bin_of(high[shown], 1e-6), shown

    def terms(self, errors: Floats) -> Floats:
        """Return the terms of the bricks, float64 (bz, by, bx, 4), by the errors of the field that is drawn in them."""
        low, high, binned = self._field.low, self._field.high, self._binned
        if self._ramps:  # their ends may lie in the next brick
            low, high, errors = dilated(low, np.minimum), dilated(high, np.maximum), dilated(errors, np.maximum)
        errors = np.where(np.isnan(errors), np.inf, errors)
        # An endless error means that anything may be there, or nothing.
        known = np.isfinite(errors) & (low <= high)
        low, high = np.where(known, low, -np.inf), np.where(known, high, np.inf)
        low, high = in_units_of_clim(low, *self._domain), in_units_of_clim(high, *self._domain)
        with np.errstate(over="ignore", invalid="ignore"):
            errors = errors / (self._domain[1] - self._domain[0])
            begin, end = binned.bin_of(low, -1e-6), binned.bin_of(high, 1e-6)
            wide = binned.bin_of(low - errors, -1e-6), binned.bin_of(high + errors, 1e-6)
        found, shown = np.zeros((*errors.shape, 4)), self._drawn & (known | (errors > 0))
        in_bins = errors[shown] * binned.per_unit
        share = np.minimum(self._share.largest(begin[shown], end[shown], in_bins), 1.0)
        found[shown, SHARE] = found[shown, SLAB] = share
        if self._slab is not self._share:
            found[shown, SLAB] = self._slab.largest(begin[shown], end[shown], in_bins)
        found[shown, DENSE] = _extreme(self._most, wide[0][shown], wide[1][shown], np.maximum)[0]
        # Voxels without a value absorb nothing.
        sure = shown & known & self._field.valid
        found[sure, THIN] = _extreme(self._least, begin[sure], end[sure], np.minimum)[0]
        return found

    def tolerated(self, most: Floats) -> Floats:
        """Return the errors of the field, float64 (bz, by, bx), at which a slab changes by no more than given."""
        begin, end, shown = self._bins
        bins, found = self._slab.tolerated(begin, end, most[shown]), np.full(most.shape, np.inf)
        found[shown] = bins * (self._domain[1] - self._domain[0]) / self._binned.per_unit
        return found

    def weights(self, rays: Rays, pixels: NDArray[np.int64]) -> Floats:
        """Return how much each brick's slabs count, float64 (bz, by, bx, 2): in all rays, and at most in one."""
        terms = self.terms(np.zeros(self._drawn.shape))
        terms[..., [SLAB, SHARE]], terms[..., DENSE] = np.where(self._drawn, TINY, 0.0)[..., None], np.inf
        return self._trace(rays, terms, pixels)[1] / TINY

    def trace(self, rays: Rays, errors: Floats, pixels: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Bound the error of pixels.

        Parameters
        ----------
        rays : of the picture
        errors : float64 (bz, by, bx), of the field that is drawn in each brick
        pixels : int64 (n, 2), x and y

        Returns
        -------
        bounds : float64 (n,), of colours and opacity, premultiplied or over any background
        shares : float64 (bz, by, bx, 2), the sum over the rays of what a brick contributes, and the largest
        """
        return self._trace(rays, self.terms(errors), pixels)

    def _trace(self, rays: Rays, terms: Floats, pixels: NDArray[np.int64]) -> tuple[Floats, Floats]:
        view = rays.view
        camera = np.zeros((8, 3))
        camera[:4] = view.eye, view.right, view.up, view.forward
        camera[LENS, :2], camera[CENTRE, :2] = (view.pixel, view.parallel), view.centre
        camera[EXTENT] = np.array(rays.shape_zyx[::-1]) - 1
        camera[LATTICE, :2] = self._brick, rays.step_world
        bounds, shares = np.empty(len(pixels)), np.zeros((*terms.shape[:3], 2))
        planes = np.ascontiguousarray(rays.planes, np.float64).reshape(-1, 4)
        scratch = np.empty((sum(terms.shape) + 3, 4)), np.empty((3, 3)), np.empty((3, 3), np.int64)
        _TRACE(pixels, camera, planes, terms, self._cuts, bounds, shares, *scratch)
        return bounds, shares


@lru_cache(maxsize=4)
def _tables(
    colour_values: bytes,
    colours: bytes,
    opacity_values: bytes,
    opacities: bytes,
    domain: tuple[float, float],
    slab_units: float,
    whole: bool,
) -> tuple[Classified, Change, Change, Floats, Floats]:
    """Return the tables of a transfer function, which is given so that frames with equal ones share them.

    Returns
    -------
    binned : the function in bins
    share, slab : changes of slabs that are cut, and of whole ones
    least, most : ranges of the optical depth of a slab
    """
    values, opacity_knots = np.frombuffer(colour_values), np.frombuffer(opacity_values)
    straight = np.frombuffer(colours).reshape(-1, 3)
    binned = classified(TransferFunction(values, straight, opacity_knots, np.frombuffer(opacities), 1.0, domain))
    share, depth = binned.change(slab_units, whole=False), binned.depth(slab_units)
    slab = binned.change(slab_units, whole=True) if whole else share
    return binned, share, slab, _ranges(depth[:1], np.minimum), _ranges(depth[1:], np.maximum)


def dilated(values: Floats, pick: np.ufunc) -> Floats:
    """Return the extremes of each brick and its 26 neighbours."""
    for axis in range(3):
        moved = np.moveaxis(values, axis, 0)
        found = moved.copy()
        pick(found[1:], moved[:-1], out=found[1:])
        pick(found[:-1], moved[1:], out=found[:-1])
        values = np.moveaxis(found, 0, axis)
    return np.ascontiguousarray(values)
