"""Units of length: factors that bring the axes of a volume to one unit."""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.errors import warn_of_data

METRES = {
    **dict.fromkeys(("angstrom", "\u00c5", "\u212b"), 1e-10),
    **dict.fromkeys(("picometer", "pm"), 1e-12),
    **dict.fromkeys(("nanometer", "nm"), 1e-9),
    **dict.fromkeys(("micrometer", "micron", "\u00b5m", "\u03bcm", "um"), 1e-6),
    **dict.fromkeys(("millimeter", "mm"), 1e-3),
    **dict.fromkeys(("centimeter", "cm"), 1e-2),
    **dict.fromkeys(("decimeter", "dm"), 0.1),
    **dict.fromkeys(("meter", "m"), 1.0),
    **dict.fromkeys(("kilometer", "km"), 1e3),
    **dict.fromkeys(("inch", "in"), 0.0254),
    **dict.fromkeys(("foot", "ft"), 0.3048),
}
"""Lengths of units; micro and ångström have several characters."""
SPACING = "spacing: [x, y, z] of the volume"
"""Key of a scene that replaces what a file says."""


def unit_factors(units: Sequence[str]) -> list[float] | None:
    """Return the factor of each unit to the first one that is not empty; 1 for empty ones.

    None: units differ, and one of them is not known. Plurals and British spelling are known.
    """
    named = [unit for unit in units if unit]
    if len(set(named)) < 2:
        return [1.0] * len(units)
    metres = {unit: METRES.get(unit.removesuffix("s").replace("metre", "meter"), 0.0) for unit in named}
    if not all(metres.values()):
        return None
    return [metres[unit] / metres[named[0]] if unit else 1.0 for unit in units]


def axis_factors(units: Sequence[str], where: str) -> list[float]:
    """Return the factors of the units of x, y and z to one unit; warn of those that are not known, and return 1."""
    found = unit_factors(units)
    if found is None:
        what = "the axes have different units, whose numbers are taken as they are: the picture may be flat or long"
        warn_of_data(what, where=where, found=", ".join(unit or "none" for unit in units), allowed=SPACING)
    return found or [1.0] * len(units)
