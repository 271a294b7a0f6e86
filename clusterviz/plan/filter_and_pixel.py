"""Choice of filter and pixel format for `quality.max_error`, within what the step leaves of the bound.

The errors of the texture unit's filter and of shorter pixel formats do not fall with the step. Each is chosen only if
it fits into the bound and costs less: the filter by a measurement on this device, pixels because they have fewer
bytes. Every choice gives its reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from clusterviz.plan.accuracy import Aim, Choice
from clusterviz.plan.plan import Filter

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
