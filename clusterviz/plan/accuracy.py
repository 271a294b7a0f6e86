"""Choice of settings for `quality.max_error`: the cheapest that hold the bound in small pictures.

The error of a step depends on the field, the transfer function and the view, and bounds from slopes alone are wrong by
an order of magnitude. So the scene is drawn with few rays at steps of 2, 1, ½, … voxels, until the errors that
`estimate.py` finds in these pictures are within the bound. Both classifications converge to the same picture, so only
the one that is likely to be cheaper is refined, unless they disagree. The choice is then verified in all pixels. From
frame to frame, pictures around the last step, with the last classification, show if it still holds.

An eighth of the bound is for early ray termination, the rest for the step. docs/measurements/accuracy.md says how often
the choice was right.

The errors of the texture unit's filter and of shorter pixel formats do not fall with the step. Each is chosen only if
it fits into what the step leaves of the bound and costs less: the filter by a measurement on this device, pixels
because they have fewer bytes. Every choice gives its reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.transfer import transfer_function
from clusterviz.errors import SceneError
from clusterviz.plan.blend_mode import Classification, is_preintegrated
from clusterviz.plan.content import Filter
from clusterviz.plan.estimate import (
    FASTEST,
    SLOWEST,
    Pictures,
    Trial,
    difference,
    errors_of,
    largest,
    left_of,
    levels_of,
    logarithms,
    still_missing,
)
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.transfer import TransferFunction, rescale
from clusterviz.scene.values import Scene, Volume

COARSEST, FINEST = -1, 6
"""Levels: a step is 2^-level voxels."""
FIRST = 1
"""Pictures down to this level are always drawn: coarser ones may all miss the same detail."""
TERMINATION = 1 / 8
"""Share of the bound for early ray termination."""
SAFETY = 2.0
"""Safety factor of all estimates."""
VERIFIED_SAFETY, VERIFIED_FINEST = 2.0, FINEST + 1
"""A first view's choice is verified in all pixels, with this safety factor, at steps down to this level. Where opacity
or colour jump, or nearly so, single pixels have far larger errors than all others, which a sample of pixels misses.
Then an estimate needs a picture one level finer, and every view is verified."""
WITNESS = 4
"""Level down to which a first view is drawn for that where planes or faces cut, or where a pixel is the colour of one
scalar: a ray that crosses a corner of the volume within the shortest step has one sample at all of them. Elsewhere it
is drawn down to the first level between whose samples little can hide, but not beyond this one, or with jumps not
beyond `VERIFIED_FINEST`: longer steps may all miss a feature that is thin along one ray. Later views are verified by
steps around their own."""
STEEP = 8.0
"""Slope of opacity or colour, in full scales over the range of clim, above which a transfer function counts as a
jump."""
PLACES = 1025
"""Scalars over clim between which changes of opacity and colour are looked for."""
NARROW = 2.0**-13
"""Share of clim's range below which a change of opacity or colour counts as one at a single scalar. Along a ray, a
trilinear field leaves the line between two samples 1/128 of a voxel apart by less."""
STEADY = math.sqrt(2)
"""A step that still holds is kept until another is cheaper by this factor, so that consecutive frames are similar."""
FEW = 500
"""Covered pixels below which only steps that were drawn are chosen; so are steps of more than half a voxel. With so
few samples errors are erratic, and those of one step do not predict those of another."""
STRAY = 1.5
"""Levels that a choice may move away from the one at which both classifications were compared."""


@dataclass(frozen=True)
class Aim:
    """Bound on the error, and the choices that are allowed.

    Attributes
    ----------
    bound : largest error
    pixels : number of pixels of the whole picture
    classifications : those that may be chosen
    jumps : opacity or colour jump, or nearly so, along rays
    of_one_scalar : a pixel is the colour of one scalar, such as the maximum
    jump : largest change of extinction, or of extinction times colour, at a single scalar, per voxel
    witness : level down to which a first view is verified at least
    last : choice of the frame before, which is updated; None if there is none
    coarsest : level of the longest step that may be chosen
    safety : factor of all errors estimated in a sample of pixels
    """

    bound: float
    pixels: int
    classifications: tuple[Classification, ...]
    jumps: bool = False
    of_one_scalar: bool = False
    jump: float = 0.0
    witness: int = FIRST
    last: Trial | None = None
    coarsest: float = COARSEST
    safety: float = SAFETY

    @property
    def target(self) -> float:
        """Part of the bound for the step."""
        return (1 - TERMINATION) * self.bound

    @property
    def residual(self) -> float:
        """Part of the bound for early ray termination."""
        return TERMINATION * self.bound

    def grazed(self, level: float) -> float:
        """Bound of what a ray can miss that touches the far side of a jump between two samples.

        Where a ray grazes a surface, the way behind it may be anything below a step. It is so rare that pictures at
        longer steps do not show it.
        """
        return -math.expm1(-self.jump * math.exp2(-level))

    @property
    def levels(self) -> tuple[int, ...]:
        """Levels of the pictures that are always drawn, each with half the step of the one before."""
        finest = FIRST if self.last is None else min(max(math.ceil(self.last.level), FIRST) + self.jumps, FINEST)
        return (finest - 2, finest - 1, finest)

    @property
    def first_cost(self) -> float:
        """Cost of those pictures, relative to one of their size with the last choice."""
        return sum(math.exp2(level) for level in self.levels) / math.exp2(self.last.level if self.last else 0.0)

    def following(self, last: Trial, coarsest: float = COARSEST) -> Aim:
        """Return the aim that updates a choice which held for another view or transfer function."""
        return replace(self, classifications=(last.classification,), last=last, coarsest=coarsest)


@dataclass(frozen=True)
class Choice:
    """Chosen settings.

    Attributes
    ----------
    trial : classification and step
    error : estimated error, including the residual of early ray termination
    reason : explanation of the choice of classification
    """

    trial: Trial
    error: float
    reason: str = ""


def make_aim(scene: Scene, spacing: float) -> Aim:
    """Return the aim of a completed scene with a volume and `quality.max_error`.

    Parameters
    ----------
    spacing : smallest distance of samples, world units, which steps are in units of

    Raises
    ------
    SceneError
        No samples keep the bound for certain.
    """
    bound = scene.quality.max_error
    assert bound is not None, "no bound was asked for"
    volumes = [*scene.drawn_as("samples").values()]
    scalar = any(not BLEND_MODES[volume.blending].composited for volume in volumes)
    # Whole slabs are clipped, or lie in one of several volumes, so that opacity jumps at planes and faces.
    clipped = bool(scene.clip.planes) or scene.clip.box is not None
    found = [_steepness(volume, spacing, bound) for volume in volumes]
    steep, jump, witness = (max(each) for each in zip(*found, strict=True))
    for volume, own in zip(volumes, found, strict=True):
        if not BLEND_MODES[volume.blending].composited and (clipped or own.is_steep):
            raise _of_one_scalar(bound, volume, clipped)
    both = all(is_preintegrated(volume, "pre-integrated") for volume in volumes)
    classifications: tuple[Classification, ...] = ("post", "pre-integrated") if both else ("post",)
    if steep and both:  # between two samples, slabs that are integrated before miss nothing that is thin
        classifications = ("pre-integrated",)
    cut = clipped or len(volumes) > 1
    witness = max(witness, WITNESS * (cut or scalar))
    aim = Aim(bound, math.prod(scene.image.size), classifications, cut or steep, scalar, jump, witness)
    least = aim.grazed(VERIFIED_FINEST) / (1 - TERMINATION)
    if least > bound:
        raise _of_a_jump(bound, least, volumes[[own.jump for own in found].index(jump)])
    return aim


def _of_one_scalar(bound: float, volume: Volume, clipped: bool) -> SceneError:
    """Return the error of a pixel with the colour of one scalar, which no step is short enough to find for certain."""
    found = f"{volume.blending}, whose pixels may be on either side of a jump of opacity or colour"
    allowed = f"changes of at most {STEEP:.3g} full scales over clim, a composited mode, or null"
    if clipped:
        found = f"{volume.blending}, of which a ray across a clipped corner may have no sample"
        allowed = "no clip, a composited mode, or null"
    return SceneError(f"{bound:.3g} is out of reach", where="quality.max_error", found=found, allowed=allowed)


def _of_a_jump(bound: float, least: float, volume: Volume) -> SceneError:
    """Return the error of a ray that may touch what lies behind a jump for less than the shortest step."""
    found = f"a jump of opacity or colour of {volume.path}, which a ray may touch between two samples"
    allowed = f"at least {least:.2g}, a change over more than {NARROW:.1g} of clim's range, or null"
    return SceneError(f"{bound:.3g} is out of reach", where="quality.max_error", found=found, allowed=allowed)


class _Steepness(NamedTuple):
    """How fast opacity and colour change over the scalar, and what follows for steps.

    Attributes
    ----------
    is_steep : they jump, or change faster than `STEEP`
    jump : largest change of extinction, or of extinction times colour, at a single scalar, per voxel
    witness : level down to which a first view is verified at least
    """

    is_steep: bool
    jump: float
    witness: int


def _steepness(volume: Volume, spacing: float, bound: float) -> _Steepness:
    if volume.interpolation == "nearest":  # rays graze no corner of a voxel: what they miss falls with the step
        return _Steepness(True, 0.0, WITNESS)
    transfer = transfer_function(volume)
    steep = bool(volume.transfer_2d or volume.shader) or _is_steep(transfer)
    return _Steepness(steep, _jump_of(transfer) * spacing, _witness(transfer, spacing, bound, steep))


def _jump_of(transfer: TransferFunction) -> float:
    """Return the largest change at a single scalar, as `_largest_change`."""
    narrow = NARROW * (transfer.domain[1] / 2 - transfer.domain[0] / 2)
    changes = [0.0]
    for values in (transfer.opacity_values, transfer.colour_values):
        at = np.flatnonzero(np.diff(values / 2) <= narrow)
        if len(at):
            changes.append(_largest_change(transfer, np.nextafter(values[at], -np.inf), values[at + 1]))
    return max(changes)


def _witness(transfer: TransferFunction, spacing: float, bound: float, steep: bool) -> int:
    """Return the first level whose samples hide no more than the bound of a field that changes by clim in a voxel."""
    places, deepest = np.linspace(0.0, 1.0, PLACES), VERIFIED_FINEST if steep else WITNESS
    for level in range(FIRST, deepest):
        half = math.exp2(-level) / 2  # a peak between two samples is no farther away, and this long in the mean
        sides = (rescale(np.clip(places + move, 0.0, 1.0), transfer.domain) for move in (0.0, half))
        if -math.expm1(-_largest_change(transfer, *sides) * half * spacing) <= bound:
            return level
    return deepest


def _largest_change(transfer: TransferFunction, one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the largest change of extinction, or of extinction times colour, between scalars (n,), per world unit."""
    scalars = np.stack([one, other])
    extinction = transfer.extinction(scalars)[..., None]
    shown = np.concatenate([extinction, extinction * transfer.colour(scalars)], axis=-1)
    return float(np.abs(shown[1] - shown[0]).max(initial=0.0))


def _is_steep(transfer: TransferFunction) -> bool:
    """Return True if opacity or colour jumps, or changes faster than `STEEP`."""
    low, high = transfer.domain
    for values, results in (
        (transfer.opacity_values, transfer.opacities[:, None]),
        (transfer.colour_values, transfer.colours),
    ):
        changes = np.abs(np.diff(results, axis=0)).max(axis=1, initial=0.0)
        if np.any(changes * (high / 2 - low / 2) > STEEP * (values[1:] / 2 - values[:-1] / 2)):
            return True
    return False


def next_trial(pictures: Pictures, aim: Aim) -> Trial | None:
    """Return the picture to draw next, or None if there are enough to choose."""
    for classification in aim.classifications:  # the outer loop, since each needs other bricks
        for level in aim.levels:
            if Trial(classification, level) not in pictures:
                return Trial(classification, level)
    errors = errors_of(pictures, aim.pixels, aim.safety)
    disputed = _disputed(pictures, aim)
    if disputed:
        return disputed
    best = min(aim.classifications, key=lambda each: _wanted(errors[each], each, aim.target).cost)
    last = max(errors[best])
    holds = errors[best][last - aim.jumps] <= aim.target
    return None if holds or last >= FINEST else Trial(best, last + 1)


def choose(pictures: Pictures, aim: Aim) -> Choice:
    """Return the cheapest setting that is expected to hold the bound, or else the most accurate one."""
    found, errors = [], errors_of(pictures, aim.pixels, aim.safety)
    few = max(np.count_nonzero(picture.any(axis=-1)) for picture in pictures.values()) < FEW
    for classification, curve in errors.items():
        wanted = _wanted(curve, classification, aim.target).level
        level = math.ceil(wanted) if few or wanted < FIRST else math.ceil(4 * wanted) / 4
        level = min(max(curve), max(aim.coarsest, level))
        found.append(_expected(Trial(classification, level), curve, aim))
    reached = [choice for choice in found if choice.error <= aim.bound]
    if not reached:
        return _with_reason(min(found, key=lambda one: one.error), found, aim)
    cheapest = _with_reason(min(reached, key=lambda choice: choice.trial.cost), found, aim)
    if aim.last and aim.last.cost <= STEADY * cheapest.trial.cost:
        kept = _expected(aim.last, errors[aim.last.classification], aim)
        return replace(kept, reason=cheapest.reason) if kept.error <= aim.bound else cheapest
    return cheapest


def _with_reason(choice: Choice, among: list[Choice], aim: Aim) -> Choice:
    """Return the choice with the reason against the other classification."""
    other = next((one for one in among if one.trial.classification != choice.trial.classification), None)
    if other is None:
        text = "as in the view before" if aim.last else "the only one for what is shown"
    elif other.error > aim.bound:
        text = (
            f"{other.trial.classification} does not hold it down to step {other.trial.step:.3g}, and promises no less"
        )
    else:
        ratio = other.trial.cost / choice.trial.cost
        text = f"{other.trial.classification} at step {other.trial.step:.3g} would cost {ratio:.2g} times as much"
    return replace(choice, reason=text)


def verified(pictures: Sequence[NDArray[Any]], aim: Aim, level: float, coarser: int = 0) -> float:
    """Estimate the error of a whole picture from itself and two others, including the residual.

    Parameters
    ----------
    pictures : at least three pictures (h, w, 4), each with half the step of the one before
    level : of the last picture
    coarser : 0: the last picture is estimated, from longer steps; else the one so many before it
    """
    first, before, finest = pictures[-3:]
    last, earlier = difference(finest, before), difference(before, first)
    # The largest changes of two halvings are in different pixels, so that their ratio is no order of convergence: a
    # narrow peak that both missed appears later. So each pixel has an order of its own, that of jumps where anything
    # jumps, and no error is expected to fall faster than without jumps.
    # So is the order of one scalar, since the sample next to an end of the ray moves by half a step.
    slow = aim.jumps or aim.of_one_scalar
    shares = SLOWEST if slow else np.clip(last / np.maximum(earlier, 1e-30), FASTEST, SLOWEST)
    missing = float((last * shares / (1 - shares)).max())
    least = FASTEST * float(earlier.max())
    missing = max(missing, least if slow else still_missing(least, 4 * least))
    moved = float(difference(finest, pictures[-1 - coarser]).max())
    return VERIFIED_SAFETY * missing + moved + aim.residual + aim.grazed(level)


def has_strayed(choice: Choice, calibrated: Choice, aim: Aim) -> bool:
    """Return True if a choice has moved so far that the other classification may be better now."""
    unreached = choice.error > aim.bound and calibrated.error <= aim.bound
    return unreached or abs(choice.trial.level - calibrated.trial.level) > STRAY


def _expected(trial: Trial, curve: dict[int, float], aim: Aim) -> Choice:
    """Return a setting with its error interpolated between those of its classification."""
    return Choice(trial, math.exp2(np.interp(trial.level, list(curve), logarithms(curve))) + aim.residual)


def _disputed(pictures: Pictures, aim: Aim) -> Trial | None:
    """Return the next picture of the coarser classification, if the two differ by more than their estimated errors."""
    levels = levels_of(pictures)
    if len(levels) < 2:
        return None
    lacking = sum(left_of(pictures, classification, known, aim.pixels) for classification, known in levels.items())
    one, other = (pictures[Trial(classification, known[-1])] for classification, known in levels.items())
    classification, known = min(levels.items(), key=lambda item: item[1][-1])
    agree = largest(difference(one, other), aim.pixels) * (1 - SLOWEST) <= max(lacking, aim.target / aim.safety)
    return None if agree or known[-1] >= FINEST else Trial(classification, known[-1] + 1)


def _wanted(curve: dict[int, float], classification: Classification, target: float) -> Trial:
    """Return the level at which a classification meets the target, by log-linear inter- or extrapolation."""
    levels, logs = list(curve), logarithms(curve)
    over = np.flatnonzero(logs > math.log2(target)).tolist()
    if not over:
        return Trial(classification, levels[0])
    last = over[-1]
    slope = float(logs[min(last, len(levels) - 2)] - logs[min(last, len(levels) - 2) + 1])
    if last == len(levels) - 1:
        slope = min(max(slope, -math.log2(SLOWEST)), -math.log2(FASTEST))
    return Trial(classification, levels[last] + float(logs[last] - math.log2(target)) / slope)


WORTH = 0.9
"""Time of the texture unit over that of exact weights, below which it is worth its error."""


@dataclass(frozen=True)
class Picked:
    """Chosen value of a setting.

    Attributes
    ----------
    value : as in the scene
    error : error that it adds
    reason : explanation for the user
    """

    value: str
    error: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class Probe:
    """Comparison of the texture unit with exact weights, by a small picture.

    Attributes
    ----------
    error : largest difference expected in the whole picture
    share : time over that of exact weights, on the slowest rank; None if the error alone decides
    """

    error: float
    share: float | None


def why_exact(filter: Filter, volumes: int, has_texture_unit: bool) -> str:
    """Return the reason not to try the texture unit; "" if it may be tried.

    Parameters
    ----------
    filter : the plan's filter, with exact weights
    volumes : number of volumes in the scene
    has_texture_unit : all ranks draw by OpenGL
    """
    if not has_texture_unit:
        return "the CPU ray caster draws, which has no texture unit"
    if volumes > 1:
        return "several volumes are not filtered by the texture unit"
    return "nearest voxels are not filtered" if filter == "nearest" else ""


def reduced(aim: Aim, error: float) -> Aim | None:
    """Return the aim with its bound reduced by an error; None if less than half of the bound is left."""
    return replace(aim, bound=aim.bound - error) if error < aim.bound / 2 else None


def pick_filter(probe: Probe, choice: Choice, instead: Choice | None, aim: Aim) -> tuple[Picked, Choice]:
    """Choose the filter, and the step that goes with it.

    Parameters
    ----------
    choice : the step with exact weights
    instead : the step for what the texture unit leaves of the bound; None if too little is left
    """
    added = f"hardware adds about {probe.error:.2g}"
    if probe.share is None or instead is None or instead.error + probe.error > aim.bound:
        return Picked("exact", reason=f"{added}, which the step cannot make up for"), choice
    measured = f"{added} and takes {probe.share:.2f} of the time a sample"
    if probe.share * instead.trial.cost > WORTH * choice.trial.cost:
        return Picked("exact", reason=f"{measured}: no gain with the step that it asks for"), choice
    return Picked("hardware", probe.error, measured), replace(instead, error=instead.error + probe.error)


def pick_pixel(bounds: Mapping[str, float], left: float, ranks: int, colours: bool) -> Picked:
    """Choose the pixel format of partial images.

    Parameters
    ----------
    bounds : largest error of each format but float32, those with the fewest bits first
    left : part of the bound that is left
    ranks : number of ranks that composite
    colours : pixels are colours, not scalars or sums
    """
    if ranks == 1:
        return Picked("float32", reason="one rank sends nothing")
    if not colours:
        return Picked("float32", reason="projections are made of scalars, which are not rounded")
    for pixel, error in bounds.items():
        if error <= left:
            return Picked(pixel, error, f"adds {error:.2g} at most, where {left:.2g} of the bound is left")
    least = min(bounds, key=lambda pixel: bounds[pixel])
    return Picked(
        "float32", reason=f"{least} may add {bounds[least]:.2g}, and {max(left, 0.0):.2g} of the bound is left"
    )
