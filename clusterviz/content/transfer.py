"""Transfer functions of completed volumes and unstructured grids."""

from __future__ import annotations

import numpy as np

from clusterviz.content.facts import range_around
from clusterviz.content.grid.section import GridSection
from clusterviz.content.volume.optics import optical_function
from clusterviz.content.volume.section import Volume
from clusterviz.scene.colormaps import colour_points, read_preset
from clusterviz.scene.transfer import TransferFunction, opacity_points, rescale
from clusterviz.scene.transfer_2d import load_table

UNCOMPLETED = "a transfer function needs a completed volume; call complete_scene first"
DEFAULT_OPACITY = ((0.0, 0.0), (0.3, 0.0), (1.0, 0.9))
"""(share of clim, opacity); the lowest values, in most data air, solvent or noise, are transparent."""


def transfer_function(volume: Volume | GridSection) -> TransferFunction:
    """Return the transfer function of a completed volume or unstructured grid.

    For a two-dimensional table, the opacity of a scalar is the maximum over all magnitudes. If clim is a single value,
    colours and opacity presets have a step there, and the domain is a range around it. Of optics, it is that of the
    first wavelength, see `OpticalFunction.at`.

    Raises
    ------
    SceneError
        The colour map is not known or its preset cannot be read.
    ValueError
        The volume is not completed.
    """
    if isinstance(volume, Volume) and volume.optics is not None:
        return optical_function(volume.optics).at(0)
    clim, unit, cmap, opacity = volume.clim, volume.opacity_unit_distance, volume.cmap, volume.opacity
    table = volume.transfer_2d if isinstance(volume, Volume) else None
    if clim is None or unit is None or cmap is None:
        raise ValueError(UNCOMPLETED)
    colour_values, colours = colour_points(cmap, clim, where=f"{volume.path}: cmap")
    if table is not None:
        opacity_values, opacities = load_table(table, where=f"{volume.path}: transfer_2d").max_opacity_points
    elif opacity is not None:
        opacity_values, opacities = opacity_points(opacity, clim)
    else:
        raise ValueError(UNCOMPLETED)
    domain = clim if clim[0] < clim[1] else range_around(clim[0])
    return TransferFunction(colour_values, colours, opacity_values, opacities, unit, domain)


def default_opacity(cmap: object, clim: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Return the opacity of a ParaView preset if it has one, else `DEFAULT_OPACITY`, in data values."""
    points: tuple[tuple[float, float], ...] = DEFAULT_OPACITY
    if isinstance(cmap, str) and cmap.lower().endswith(".json"):
        points = read_preset(cmap)[2] or DEFAULT_OPACITY
    places, opacities = np.array(points).T
    values = rescale(places, clim)
    return tuple((float(v), float(a)) for v, a in zip(values, opacities, strict=True))
