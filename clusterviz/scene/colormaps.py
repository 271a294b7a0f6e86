"""Colour maps: a name, colours, a ParaView preset or control points become control points in data values."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import SceneError
from clusterviz.scene.opacity import spread

Colours = tuple[NDArray[np.float64], NDArray[np.float64]]
FLAT_COLOURS = 512
"""At least so many entries stand for a map of flat colours: the way from one to the next is 1/512 of the map."""


def colour_points(cmap: str | Sequence[Sequence[float]], clim: tuple[float, float], *, where: str = "cmap") -> Colours:
    """Any colour map of a scene as control points.

    Parameters
    ----------
    cmap : a name, the path of a ParaView preset (.json), ((r, g, b), …) evenly over clim, or ((value, r, g, b), …)
        sorted by value
    clim : (low, high) in data values, where the ends of any map but points come to lie; points stay where they are
    where : the file and key that an error names

    Returns
    -------
    values : float64 (n,), ascending; a value that occurs twice is a step
    colours : float64 (n, 3), straight RGB in [0, 1], linear between the values

    Raises
    ------
    SceneError
        No colour map of this name, or a preset that cannot be read.
    """
    if not isinstance(cmap, str):
        table = np.asarray(cmap, np.float64)
        if follows_clim(cmap):
            return spread(np.linspace(0.0, 1.0, len(table)), clim), table
        return table[:, 0], table[:, 1:]
    if cmap.lower().endswith(".json"):
        from clusterviz.scene.paraview import read_preset

        places, colours, _ = read_preset(cmap, where=where)
    else:
        places, colours = named_points(cmap, where=where)
    return spread(places, clim), colours


def follows_clim(cmap: str | Sequence[Sequence[float]]) -> bool:
    """Whether a colour map lies where clim is; points with values lie where these are."""
    return isinstance(cmap, str) or len(cmap[0]) == 3


def named_points(name: str, *, where: str = "cmap") -> Colours:
    """A colour map of the `cmap` package over the unit range; matplotlib's where several share a name."""
    stem = name.removesuffix("_r")
    found = _named(stem)
    if found is None:
        known = {each.lower(): each for each in map_names()}
        near = [known[each] for each in get_close_matches(stem.lower(), known, n=3, cutoff=0.6)]
        examples = ", ".join(near or ("viridis", "bone", "gray", "coolwarm"))
        allowed = f"a name that `clusterviz cmaps` lists, for example {examples}; _r reverses it"
        raise SceneError("unknown colour map", where=where, found=name, allowed=allowed)
    places, colours = _stops(found)
    return (1.0 - places[::-1], colours[::-1]) if name.endswith("_r") else (places, colours)


def map_names() -> dict[str, tuple[str, str]]:
    """Every name of a colour map, in alphabetical order, with its kind and with whose it is."""
    catalog = _package().Colormap.catalog()
    items = {name: catalog[name] for name in sorted(catalog.short_keys(), key=str.lower)}
    return {name: (str(item.category), str(item.namespace)) for name, item in items.items()}


def colours_of(colormap: Any) -> str | list[list[float]]:
    """A colour map of matplotlib or of the `cmap` package as a scene holds it.

    Parameters
    ----------
    colormap : a matplotlib.colors.Colormap or a cmap.Colormap

    Returns
    -------
    cmap : its name, where the scene's map of this name is within a level of 8 bits everywhere, else its colours
        [[r, g, b], …] evenly spread; flat colours are repeated
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
        named = named_points(colormap.name)
    except SceneError:
        named = None
    if named and all(np.abs(np.interp(at, named[0], named[1][:, c]) - colours[:, c]).max() < 1 / 255 for c in range(3)):
        return str(colormap.name)
    found: list[list[float]] = np.repeat(colours, -(-FLAT_COLOURS // count) if flat else 1, axis=0).tolist()
    return found


@cache
def _named(name: str) -> Any:
    """The map of the `cmap` package that a name means; None where there is none."""
    for candidate in (f"matplotlib:{name}", name):
        try:
            return _package().Colormap(candidate)
        except (ValueError, KeyError, TypeError):
            continue
    return None


def _package() -> Any:
    """The `cmap` package, without its warnings of names that several collections have."""
    import logging

    import cmap

    logging.getLogger("cmap").setLevel(logging.ERROR)
    return cmap


def _stops(colormap: Any) -> Colours:
    """Control points of a colour map of the `cmap` package; one that is a list of flat colours becomes steps."""
    stops = np.asarray(colormap.color_stops, np.float64)
    places, colours = stops[:, 0], stops[:, 1:4]
    if colormap.interpolation == "nearest":
        edges = np.linspace(0.0, 1.0, len(colours) + 1)
        return np.repeat(edges, 2)[1:-1], np.repeat(colours, 2, axis=0)
    return places, colours
