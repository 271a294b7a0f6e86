"""What is left of a bound on the error once the step has its share: the texture unit's filter, and fewer bits a pixel.

Neither error falls with the step. Both are taken only where they fit into the bound, and cost less: the filter by a
measurement of this device, pixels because they are fewer bytes. Why something was taken or not is told in words.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from clusterviz.plan.accuracy import Aim, Choice
from clusterviz.plan.plan import Filter

WORTH = 0.9
"""Share of the time that the texture unit may take of that of exact weights, to be worth its error."""


@dataclass(frozen=True)
class Picked:
    """A value of a key.

    Attributes
    ----------
    value : as in the scene
    error : that it adds
    reason : why, in words
    """

    value: str
    error: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class Probe:
    """The texture unit beside exact weights, in a small picture.

    Attributes
    ----------
    error : largest difference to be expected in the whole picture
    share : of the time that exact weights take, on the slowest rank; None where the error alone says enough
    """

    error: float
    share: float | None


def why_exact(filter: Filter, volumes: int, has_texture_unit: bool) -> str:
    """Why the texture unit need not be tried; "" where it may be.

    Parameters
    ----------
    filter : of the plan, with exact weights
    volumes : in the scene
    has_texture_unit : whether all ranks draw by OpenGL
    """
    if not has_texture_unit:
        return "the processor's own caster draws, which has no texture unit"
    if volumes > 1:
        return "several volumes are not filtered by the texture unit"
    return "nearest voxels are not filtered" if filter == "nearest" else ""


def reduced(aim: Aim, error: float) -> Aim | None:
    """What is asked of the step where something else takes so much of the bound; None where too little is left."""
    return replace(aim, bound=aim.bound - error) if error < aim.bound / 2 else None


def pick_filter(probe: Probe, choice: Choice, instead: Choice | None, aim: Aim) -> tuple[Picked, Choice]:
    """The filter, and the step that goes with it.

    Parameters
    ----------
    choice : with exact weights
    instead : for what the texture unit leaves of the bound; None where that is too little
    """
    added = f"hardware adds about {probe.error:.2g}"
    if probe.share is None or instead is None or instead.error + probe.error > aim.bound:
        return Picked("exact", reason=f"{added}, which the step cannot make up for"), choice
    measured = f"{added} and takes {probe.share:.2f} of the time a sample"
    if probe.share * instead.trial.cost > WORTH * choice.trial.cost:
        return Picked("exact", reason=f"{measured}: no gain with the step that it asks for"), choice
    return Picked("hardware", probe.error, measured), replace(instead, error=instead.error + probe.error)


def pick_pixel(bounds: Mapping[str, float], left: float, ranks: int, colours: bool) -> Picked:
    """The format of partial images.

    Parameters
    ----------
    bounds : what each format adds at most, those with the fewest bits first; float32 is not among them
    left : of the bound
    ranks : that composite
    colours : whether pixels are colours, and not scalars or sums
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
