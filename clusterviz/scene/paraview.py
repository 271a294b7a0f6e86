"""ParaView's colour-map presets (.json): control points in one of its colour spaces, with opacity where it is there.

As ParaView does when it applies a preset, the preset's own range is stretched over the range of the data (`clim`).
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import SceneError, guard
from clusterviz.scene.colour_spaces import SPACES, between
from clusterviz.scene.yaml_text import read_text

Points = NDArray[np.float64]
PIECES = 256
"""Into how many linear pieces, at least, a map is cut that is curved in RGB."""


def read_preset(path: str, *, where: str = "cmap") -> tuple[Points, Points, tuple[tuple[float, float], ...] | None]:
    """A preset over the unit range.

    Parameters
    ----------
    path : the file; the first preset of it is taken
    where : the file and key that an error names

    Returns
    -------
    places : float64 (n,), ascending from 0 to 1
    colours : float64 (n, 3), straight RGB, linear between the places
    opacity : ((place, opacity), …), or None where the preset has none

    Raises
    ------
    SceneError
        Not a preset, or one with a colour space, midpoints or a logarithm that clusterviz does not know.
    """
    with guard(SceneError, f"{where}: {path}"):
        return _read(_load(path, where), path, where)


def _read(
    preset: dict[str, Any], path: str, where: str
) -> tuple[Points, Points, tuple[tuple[float, float], ...] | None]:
    nodes = _table(preset.get("RGBPoints"), 4, "RGBPoints", where)
    low, width = nodes[0, 0], nodes[-1, 0] - nodes[0, 0]
    if not width > 0:
        raise SceneError("RGBPoints covers no range", where=where, found=path, allowed="two different values")
    space = str(preset.get("ColorSpace", "RGB"))
    if space not in SPACES:
        raise SceneError("unknown ColorSpace", where=where, found=space, allowed=", ".join(SPACES))
    if preset.get("UseLogScale"):
        raise SceneError("a logarithmic preset is not supported yet", where=where, found=path)
    places, colours = _resampled((nodes[:, 0] - low) / width, nodes[:, 1:], space, bool(preset.get("HSVWrap", True)))
    return places, colours, _opacity(preset, float(low), float(width), where)


def _load(path: str, where: str) -> dict[str, Any]:
    try:
        content = json.loads(read_text(path, SceneError, f"{where}: {path}"))
    except ValueError as error:
        raise SceneError(f"the preset is not JSON: {error}", where=where, found=path) from None
    preset = content[0] if isinstance(content, list) and content else content
    if not isinstance(preset, dict):
        raise SceneError("not a ParaView preset", where=where, found=path, allowed='[{"RGBPoints": […], …}]')
    return preset


def _table(numbers: Any, columns: int, name: str, where: str) -> Points:
    """A flat list of numbers as rows, sorted by their first column."""
    try:
        table = np.asarray(numbers, np.float64).reshape(-1, columns)
    except (TypeError, ValueError):
        table = np.empty((0, columns))
    if not len(table) or not np.isfinite(table).all() or (np.diff(table[:, 0]) < 0).any():
        allowed = f"a list of finite numbers, {columns} a point, sorted by value"
        raise SceneError(f"the preset's {name} cannot be used", where=where, allowed=allowed)
    if ((table[:, 1:] < 0) | (table[:, 1:] > 1)).any():
        raise SceneError(f"the preset's {name} is out of range", where=where, allowed="0 to 1")
    return table


def _resampled(places: Points, colours: Points, space: str, wrap: bool) -> tuple[Points, Points]:
    """Pieces that are straight in RGB, for a map that is straight between its nodes in another space."""
    if space == "RGB":
        return places, colours
    found_places, found_colours = [places[:1]], [colours[:1]]
    for left in range(len(places) - 1):
        count = max(1, int(np.ceil(PIECES * (places[left + 1] - places[left]))))
        share = np.linspace(0.0, 1.0, count + 1)
        inner = between(space, colours[left], colours[left + 1], share, wrap)
        inner[-1] = colours[left + 1]
        skip = 0 if space == "Step" else 1
        found_places.append((places[left] + (places[left + 1] - places[left]) * share)[skip:])
        found_colours.append(inner[skip:])
    return np.concatenate(found_places), np.clip(np.concatenate(found_colours), 0.0, 1.0)


def _opacity(preset: dict[str, Any], low: float, width: float, where: str) -> tuple[tuple[float, float], ...] | None:
    if preset.get("Points") is None:
        return None
    table = _table(preset["Points"], 4, "Points", where)
    if (table[:, 2] != 0.5).any() or (table[:, 3] != 0.0).any():
        raise SceneError("midpoints and sharpness of opacity are not supported yet", where=where, allowed="0.5 and 0")
    return tuple((float((value - low) / width), float(alpha)) for value, alpha in table[:, :2])
