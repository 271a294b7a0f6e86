"""Colour maps: names, colour lists and ParaView presets as control points in data values.

The range of a preset is mapped to the range of the data (`clim`), as in ParaView.

Reference: K. Moreland, "Diverging Color Maps for Scientific Visualization", ISVC 2009: Msh space and the interpolation
through white (section 5). CIE 1976 L*a*b* with the D65 white point and the sRGB transfer curve, as in VTK's vtkMath.
"""

from __future__ import annotations

import colorsys
import json
import logging
from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import SceneError, guard
from clusterviz.scene.transfer import rescale
from clusterviz.scene.yaml_text import read_text

Floats = NDArray[np.float64]
SPACES = ("RGB", "HSV", "Lab", "CIELAB", "Diverging", "Step")

XYZ_FROM_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = np.array([0.9505, 1.0, 1.089])
MIN_SEGMENTS = 256
"""Smallest number of linear segments for a map that is interpolated in another space than RGB."""


def read_preset(path: str, *, where: str = "cmap") -> tuple[Floats, Floats, tuple[tuple[float, float], ...] | None]:
    """Read a preset, over [0, 1].

    Raises SceneError: the file is not a preset, or uses an unsupported colour space, midpoints or a logarithmic scale.

    Returns `places`, float64 (n,), ascending from 0 to 1; `colours`, float64 (n, 3), straight RGB, linear between the
    places; `opacity`, ((place, opacity), …), or None if the preset has none.

    `path`: the file; its first preset is read. `where`: the file and key named in errors.
    """
    with guard(SceneError, f"{where}: {path}"):
        return _read(_load(path, where), path, where)


def _read(
    preset: dict[str, Any], path: str, where: str
) -> tuple[Floats, Floats, tuple[tuple[float, float], ...] | None]:
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


def _table(numbers: Any, columns: int, name: str, where: str) -> Floats:
    """Return a flat list of numbers as a table, validated and sorted by its first column."""
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


def _resampled(places: Floats, colours: Floats, space: str, wrap: bool) -> tuple[Floats, Floats]:
    """Return control points that are linear in RGB for a map that is linear in another space."""
    if space == "RGB":
        return places, colours
    found_places, found_colours = [places[:1]], [colours[:1]]
    for left in range(len(places) - 1):
        count = max(1, int(np.ceil(MIN_SEGMENTS * (places[left + 1] - places[left]))))
        share = np.linspace(0.0, 1.0, count + 1)
        inner = interpolate_colours(space, colours[left], colours[left + 1], share, wrap)
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


def interpolate_colours(space: str, first: Floats, second: Floats, share: Floats, wrap: bool = True) -> Floats:
    """Interpolate between two colours in a colour space.

    `space`: one of `SPACES`; `first`, `second`: float64 (3,), straight RGB; `share`: float64 (n,), 0 for the first
    colour, 1 for the second; `wrap`: HSV only: interpolate hues along the shorter arc. Returns float64 (n, 3), straight
    RGB; outside [0, 1] for colours outside the gamut.
    """
    if space == "Step":  # as in VTK, a segment has the colour of its right end
        return np.broadcast_to(second, (len(share), 3)).copy()
    if space == "HSV":
        return _between_hsv(first, second, share, wrap)
    if space in ("Lab", "CIELAB"):
        return rgb_from_lab(_mix(lab_from_rgb(first), lab_from_rgb(second), share))
    if space == "Diverging":
        return _between_diverging(first, second, share)
    return _mix(first, second, share)


def lab_from_rgb(rgb: Floats) -> Floats:
    """Convert sRGB (…, 3) to CIE L*a*b* (…, 3)."""
    linear = np.where(rgb > 0.04045, ((rgb + 0.055) / 1.055) ** 2.4, rgb / 12.92)
    scaled = linear @ XYZ_FROM_RGB.T / WHITE
    f = np.where(scaled > 0.008856, np.cbrt(scaled), 7.787 * scaled + 16 / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def rgb_from_lab(lab: Floats) -> Floats:
    """Convert CIE L*a*b* (…, 3) to sRGB (…, 3)."""
    y = (lab[..., 0] + 16) / 116
    f = np.stack([y + lab[..., 1] / 500, y, y - lab[..., 2] / 200], -1)
    scaled = np.where(f**3 > 0.008856, f**3, (f - 16 / 116) / 7.787)
    linear = (scaled * WHITE) @ np.linalg.inv(XYZ_FROM_RGB).T
    return np.asarray(np.where(linear > 0.0031308, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055, 12.92 * linear))


def msh_from_lab(lab: Floats) -> Floats:
    """Convert CIE L*a*b* (3,) to Msh (3,): magnitude, saturation angle, hue angle."""
    magnitude = float(np.linalg.norm(lab))
    saturation = float(np.arccos(np.clip(lab[0] / magnitude, -1, 1))) if magnitude > 0.001 else 0.0
    hue = float(np.arctan2(lab[2], lab[1])) if saturation > 0.001 else 0.0
    return np.array([magnitude, saturation, hue])


def lab_from_msh(msh: Floats) -> Floats:
    """Convert Msh (…, 3) to CIE L*a*b* (…, 3)."""
    m, s, h = msh[..., 0], msh[..., 1], msh[..., 2]
    return np.stack([m * np.cos(s), m * np.sin(s) * np.cos(h), m * np.sin(s) * np.sin(h)], -1)


def _mix(first: Floats, second: Floats, share: Floats) -> Floats:
    return (1 - share)[:, None] * first + share[:, None] * second


def _between_hsv(first: Floats, second: Floats, share: Floats, wrap: bool) -> Floats:
    a, b = np.array(colorsys.rgb_to_hsv(*first)), np.array(colorsys.rgb_to_hsv(*second))
    if wrap and abs(a[0] - b[0]) > 0.5:
        (a if a[0] > b[0] else b)[0] -= 1
    mixed = _mix(a, b, share)
    return np.array([colorsys.hsv_to_rgb(h % 1.0, s, v) for h, s, v in mixed])


def _between_diverging(first: Floats, second: Floats, share: Floats) -> Floats:
    a, b = msh_from_lab(lab_from_rgb(first)), msh_from_lab(lab_from_rgb(second))
    turn = abs(a[2] - b[2])
    if min(a[1], b[1]) > 0.05 and min(turn, 2 * np.pi - turn) > np.pi / 3:
        # Between two saturated colours of different hue lies a white that is at least as bright as both.
        white = np.array([max(a[0], b[0], 88.0), 0.0, 0.0])
        left = _between_msh(a, white, 2 * share)
        return np.where((share < 0.5)[:, None], left, _between_msh(white, b, 2 * share - 1))
    return _between_msh(a, b, share)


def _between_msh(a: Floats, b: Floats, share: Floats) -> Floats:
    a, b = a.copy(), b.copy()
    if a[1] < 0.05 < b[1]:
        a[2] = _adjusted_hue(b, a[0])
    elif b[1] < 0.05 < a[1]:
        b[2] = _adjusted_hue(a, b[0])
    return rgb_from_lab(lab_from_msh(_mix(a, b, np.clip(share, 0, 1))))


def _adjusted_hue(saturated: Floats, magnitude: float) -> float:
    """Return the hue of an unsaturated end for which the path to it appears straight."""
    m, s, h = saturated
    if m >= magnitude - 0.1:
        return float(h)
    spin = s * np.sqrt(magnitude**2 - m**2) / (m * np.sin(s))
    return float(h + spin if h > -np.pi / 3 else h - spin)


Colours = tuple[NDArray[np.float64], NDArray[np.float64]]
MIN_FLAT_ENTRIES = 512
"""Smallest number of entries for a map of flat colours; the transition between two colours is 1/512 of the map."""


def colour_points(cmap: str | Sequence[Sequence[float]], clim: tuple[float, float], *, where: str = "cmap") -> Colours:
    """Return the control points of a scene's colour map.

    Raises SceneError: the colour map is unknown, or the preset cannot be read.

    Parameters
    ----------
    cmap : a name, the path of a ParaView preset (.json), ((r, g, b), …) evenly over clim, or ((value, r, g, b), …)
        sorted by value
    clim : (low, high) in data values, the range of the map; control points with values do not depend on it
    where : the file and key named in errors

    Returns
    -------
    values : float64 (n,), ascending; a repeated value is a step
    colours : float64 (n, 3), straight RGB in [0, 1], linear between the values
    """
    if not isinstance(cmap, str):
        table = np.asarray(cmap, np.float64)
        if follows_clim(cmap):
            return rescale(np.linspace(0.0, 1.0, len(table)), clim), table
        return table[:, 0], table[:, 1:]
    if cmap.lower().endswith(".json"):
        places, colours, _ = read_preset(cmap, where=where)
    else:
        places, colours = named_colour_points(cmap, where=where)
    return rescale(places, clim), colours


def follows_clim(cmap: str | Sequence[Sequence[float]]) -> bool:
    """Return whether a colour map spans clim; control points with values do not."""
    return isinstance(cmap, str) or len(cmap[0]) == 3


def named_colour_points(name: str, *, where: str = "cmap") -> Colours:
    """Return the control points of a named map of the `cmap` package over [0, 1]; matplotlib's maps take precedence.

    Raises SceneError: the name is unknown.
    """
    stem = name.removesuffix("_r")
    found = _named(stem)
    if found is None:
        known = {each.lower(): each for each in map_names()}
        near = [known[each] for each in get_close_matches(stem.lower(), known, n=3, cutoff=0.6)]
        examples = ", ".join(near or ("viridis", "bone", "gray", "coolwarm"))
        allowed = f"a name that `clusterviz cmaps` lists, for example {examples}; _r reverses it"
        raise SceneError("unknown colour map", where=where, found=name, allowed=allowed)
    places, colours = _control_points(found)
    return (1.0 - places[::-1], colours[::-1]) if name.endswith("_r") else (places, colours)


def map_names() -> dict[str, tuple[str, str]]:
    """Return the names of all colour maps in alphabetical order, with category and origin."""
    catalog = _cmap_package().Colormap.catalog()
    items = {name: catalog[name] for name in sorted(catalog.short_keys(), key=str.lower)}
    return {name: (str(item.category), str(item.namespace)) for name, item in items.items()}


def scene_cmap(colormap: Any) -> str | list[list[float]]:
    """Return a matplotlib or `cmap` colour map in the form that scenes use.

    `colormap`: a matplotlib.colors.Colormap or a cmap.Colormap. Returns its name if the scene's map of this name
    differs by less than 1/255 everywhere, else colours [[r, g, b], …] at equal distances; flat colours are repeated.
    """
    theirs = hasattr(colormap, "color_stops")
    count = 256 if theirs else int(colormap.N)
    flat = colormap.interpolation == "nearest" if theirs else count < 256
    if theirs and flat:
        count = len(colormap.color_stops)
    entries = np.arange(count)
    at = (entries + 0.5) / count if flat else entries / max(1, count - 1)
    colours = np.asarray(colormap(at if theirs else entries), np.float64)[:, :3]
    try:
        named = named_colour_points(colormap.name)
    except SceneError:
        named = None
    if named and all(np.abs(np.interp(at, named[0], named[1][:, c]) - colours[:, c]).max() < 1 / 255 for c in range(3)):
        return str(colormap.name)
    found: list[list[float]] = np.repeat(colours, -(-MIN_FLAT_ENTRIES // count) if flat else 1, axis=0).tolist()
    return found


@cache
def _named(name: str) -> Any:
    for candidate in (f"matplotlib:{name}", name):
        try:
            return _cmap_package().Colormap(candidate)
        except (ValueError, KeyError, TypeError):
            continue
    return None


def _cmap_package() -> Any:
    """Import the `cmap` package without its warnings about ambiguous names."""
    import cmap

    logging.getLogger("cmap").setLevel(logging.ERROR)
    return cmap


def _control_points(colormap: Any) -> Colours:
    stops = np.asarray(colormap.color_stops, np.float64)
    places, colours = stops[:, 0], stops[:, 1:4]
    if colormap.interpolation == "nearest":
        edges = np.linspace(0.0, 1.0, len(colours) + 1)
        return np.repeat(edges, 2)[1:-1], np.repeat(colours, 2, axis=0)
    return places, colours
