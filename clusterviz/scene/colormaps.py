"""Colour maps: a name, a ParaView preset or control points become control points in data values."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import SceneError
from clusterviz.scene.opacity import spread

Colours = tuple[NDArray[np.float64], NDArray[np.float64]]


def colour_points(cmap: str | Sequence[Sequence[float]], clim: tuple[float, float], *, where: str = "cmap") -> Colours:
    """Any colour map of a scene as control points.

    Parameters
    ----------
    cmap : a name, the path of a ParaView preset (.json), or ((value, r, g, b), …) sorted by value
    clim : (low, high) in data values, where the ends of a named map or preset come to lie; points stay where they are
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
        return table[:, 0], table[:, 1:]
    if cmap.lower().endswith(".json"):
        from clusterviz.scene.paraview import read_preset

        places, colours, _ = read_preset(cmap, where=where)
    else:
        places, colours = named_points(cmap, where=where)
    return spread(places, clim), colours


def named_points(name: str, *, where: str = "cmap") -> Colours:
    """A colour map of the `cmap` package over the unit range; matplotlib's where several share a name."""
    import cmap

    catalog = cmap.Catalog()
    stem = name.removesuffix("_r")
    for candidate in (f"matplotlib:{stem}", stem):
        try:
            found = cmap.Colormap(candidate)
        except (ValueError, KeyError, TypeError):
            continue
        places, colours = _stops(found)
        return (1.0 - places[::-1], colours[::-1]) if name.endswith("_r") else (places, colours)
    near = get_close_matches(stem, list(catalog.short_keys()), n=5, cutoff=0.5)
    raise SceneError(
        "unknown colour map",
        where=where,
        found=name,
        allowed=", ".join(near) if near else "a name such as viridis, bone, gray, coolwarm; _r reverses it",
    )


def _stops(colormap: Any) -> Colours:
    """Control points of a colour map of the `cmap` package; one that is a list of flat colours becomes steps."""
    stops = np.asarray(colormap.color_stops, np.float64)
    places, colours = stops[:, 0], stops[:, 1:4]
    if colormap.interpolation == "nearest":
        edges = np.linspace(0.0, 1.0, len(colours) + 1)
        return np.repeat(edges, 2)[1:-1], np.repeat(colours, 2, axis=0)
    return places, colours
