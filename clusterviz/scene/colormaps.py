"""Colour maps: names, colour lists and ParaView presets as control points in data values."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import SceneError
from clusterviz.scene.opacity import rescale

Colours = tuple[NDArray[np.float64], NDArray[np.float64]]
MIN_FLAT_ENTRIES = 512
"""Smallest number of entries for a map of flat colours; the transition between two colours is 1/512 of the map."""


def colour_points(cmap: str | Sequence[Sequence[float]], clim: tuple[float, float], *, where: str = "cmap") -> Colours:
    """Return the control points of a scene's colour map.

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

    Raises
    ------
    SceneError
        The colour map is unknown, or the preset cannot be read.
    """
    if not isinstance(cmap, str):
        table = np.asarray(cmap, np.float64)
        if follows_clim(cmap):
            return rescale(np.linspace(0.0, 1.0, len(table)), clim), table
        return table[:, 0], table[:, 1:]
    if cmap.lower().endswith(".json"):
        from clusterviz.scene.paraview import read_preset

        places, colours, _ = read_preset(cmap, where=where)
    else:
        places, colours = named_colour_points(cmap, where=where)
    return rescale(places, clim), colours


def follows_clim(cmap: str | Sequence[Sequence[float]]) -> bool:
    """Return whether a colour map spans clim; control points with values do not."""
    return isinstance(cmap, str) or len(cmap[0]) == 3


def named_colour_points(name: str, *, where: str = "cmap") -> Colours:
    """Return the control points of a named map of the `cmap` package over [0, 1]; matplotlib's maps take precedence.

    Raises
    ------
    SceneError
        The name is unknown.
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

    Parameters
    ----------
    colormap : a matplotlib.colors.Colormap or a cmap.Colormap

    Returns
    -------
    cmap : its name if the scene's map of this name differs by less than 1/255 everywhere, else colours
        [[r, g, b], …] at equal distances; flat colours are repeated
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
    """Return the map of the `cmap` package with a name, or None."""
    for candidate in (f"matplotlib:{name}", name):
        try:
            return _cmap_package().Colormap(candidate)
        except (ValueError, KeyError, TypeError):
            continue
    return None


def _cmap_package() -> Any:
    """Import the `cmap` package without its warnings about ambiguous names."""
    import logging

    import cmap

    logging.getLogger("cmap").setLevel(logging.ERROR)
    return cmap


def _control_points(colormap: Any) -> Colours:
    """Return the control points of a map of the `cmap` package; flat colours become steps."""
    stops = np.asarray(colormap.color_stops, np.float64)
    places, colours = stops[:, 0], stops[:, 1:4]
    if colormap.interpolation == "nearest":
        edges = np.linspace(0.0, 1.0, len(colours) + 1)
        return np.repeat(edges, 2)[1:-1], np.repeat(colours, 2, axis=0)
    return places, colours
