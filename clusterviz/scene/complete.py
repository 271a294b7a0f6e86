"""Scene completion: unset keys are filled from information on the content."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.flow.expansion import FlowLines, with_flows
from clusterviz.content.flow.section import FlowInfo
from clusterviz.content.geometry.section import (
    GeometryInfo,
    GeometrySection,
    LinesSection,
    MeshSection,
    PointsSection,
    as_sections,
    is_arrows,
    own_colours,
)
from clusterviz.content.grid.section import GridInfo, GridSection
from clusterviz.content.volume.info import LARGEST, default_clim, range_around
from clusterviz.content.volume.info import VolumeInfo as VolumeInfo
from clusterviz.content.volume.optics import optical_function
from clusterviz.scene.automatic import Info as Info
from clusterviz.scene.automatic import automatic_scene
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.camera import DEFAULT_ORIENTATION, MARGIN, fitted_camera, is_completed
from clusterviz.scene.colormaps import colour_points
from clusterviz.scene.transfer import TransferFunction, opacity_points, rescale
from clusterviz.scene.transfer_2d import Transfer2d, load_table
from clusterviz.scene.values import Scene, Volume

UNCOMPLETED = "a transfer function needs a completed volume; call complete_scene first"
DEFAULT_CMAP = "bone"
RADIUS_OF_DIAGONAL: dict[type[GeometrySection], float] = {
    FlowLines: 1 / 250,
    LinesSection: 1 / 500,
    PointsSection: 1 / 200,
}
"""Radius of tubes and spheres, if none is given, as a share of the diagonal of their box."""
AXES_LABELS = 7.5
"""Margin of a fitted scene with an axes grid, whose labels are outside of the box, as a multiple of the font size."""
DEFAULT_OPACITY = ((0.0, 0.0), (0.3, 0.0), (1.0, 0.9))
"""(share of clim, opacity); the lowest values, in most data air, solvent or noise, are transparent."""


def complete_scene(scene: Scene, infos: Sequence[Info] | VolumeInfo) -> Scene:
    """Return a scene in which no key that rendering needs is unset.

    The function is pure: ranks with equal information get equal scenes.

    Parameters
    ----------
    scene : values that are set are kept
    infos : information on each of `scene.volumes`, then on each of `scene.geometry`, `scene.grids` and `scene.flows`;
        volumes and geometry are those with what flows become

    Returns
    -------
    scene : volumes and grids have cmap, clim, opacity and unit distance, geometry clim and a radius; the camera has
        position, focal_point and view_up; with refraction ranks share the screen
    """
    infos = (infos,) if isinstance(infos, VolumeInfo) else infos
    each, known, gridded = divided_infos(infos)
    scene = with_flows(scene, [info for info in infos if isinstance(info, FlowInfo)])
    if scene.automatic or any(volume.preset for volume in scene.volumes):
        scene = automatic_scene(scene, each, known)
    volumes = tuple(complete_volume(volume, info) for volume, info in zip(scene.volumes, each, strict=True))
    geometry = [complete_geometry(section, info) for section, info in zip(scene.geometry, known, strict=True)]
    grids = tuple(complete_grid(section, info) for section, info in zip(scene.grids, gridded, strict=True))
    scene = scene.model_copy(update={"volumes": volumes, "grids": grids, **as_sections(geometry)})
    if any(volume.refracts for volume in volumes):
        # Rays bend, so that any rank may need any brick.
        scene = scene.model_copy(update={"cluster": scene.cluster.model_copy(update={"mode": "sort-first"})})
    if is_completed(scene.camera):
        return scene
    boxes = [box_corners(info.grown_box(section)) for section, info in zip(geometry, known, strict=True)]
    boxes += [box_corners(info.box) for info in gridded]
    parts = [*(visible_corners(*pair) for pair in zip(volumes, each, strict=True)), *boxes]
    if scene.annotations.outline or scene.annotations.axes:
        parts += [info.corners for info in each]
    corners = np.concatenate(parts or [np.zeros((1, 3))])
    if not corners.size:
        corners = np.concatenate([info.corners for info in each] or [np.zeros((1, 3))])
    # The size of a volume of one sample.
    spacing = min((min(info.spacing) for info in each), default=0.0)
    orientation = next((info.orientation for info in each if info.orientation), "")
    margin = min(0.5, AXES_LABELS * scene.annotations.font_size) if scene.annotations.axes else MARGIN
    axes = {info.axes for info in known} if not (each or gridded) else set()
    up = axes.pop() if len(axes) == 1 else ""
    camera = fitted_camera(
        scene.camera, corners, spacing, scene.image.size, orientation, margin, up or DEFAULT_ORIENTATION
    )
    return scene.model_copy(update={"camera": camera})


def divided_infos(infos: Sequence[Info]) -> tuple[list[VolumeInfo], list[GeometryInfo], list[GridInfo]]:
    """Return the information on volumes, on geometry, and on unstructured grids."""
    volumes = [info for info in infos if isinstance(info, VolumeInfo)]
    geometry = [info for info in infos if isinstance(info, GeometryInfo)]
    return volumes, geometry, [info for info in infos if isinstance(info, GridInfo)]


def content_corners(scene: Scene, infos: Sequence[Info]) -> NDArray[np.float64]:
    """Return the corners of a box around all content of a completed scene, float64 (8, 3), x fastest; (0, 3) of none.

    The box of a single volume has the volume's own directions, any other the world's.
    """
    volumes, geometry, grids = divided_infos(infos)
    if len(infos) == len(volumes) == 1:
        return volumes[0].corners
    boxes = [info.grown_box(section) for section, info in zip(scene.geometry, geometry, strict=True)]
    points = np.concatenate([np.empty((0, 3)), *(info.corners for info in volumes), *boxes, *(g.box for g in grids)])
    return box_corners(np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else points)


def complete_geometry(section: GeometrySection, info: GeometryInfo) -> GeometrySection:
    """Return meshes, lines or points with clim, a radius, the file's own colours and the width of edges."""
    found: dict[str, object] = {}
    if colours := own_colours(section, info.arrays):
        found["scalars"] = colours
    if section.clim is None and section.scalars is not None and info.scalars is not None:
        low, high = info.scalars
        found["clim"] = (low, high) if low < high else range_around(low)
    size = (math.dist(*info.box) if len(info.box) else 0.0) or float(np.abs(info.box).max(initial=0.0)) or 1.0
    share = next((one for kind, one in RADIUS_OF_DIAGONAL.items() if isinstance(section, kind)), 0.0)
    has_radius = info.has_radii or isinstance(getattr(section, "radius", None), float)
    if share and not has_radius and not is_arrows(section):
        found["radius"] = share * size
    if isinstance(section, MeshSection) and section.edges and section.edges.width is None:
        found["edges"] = section.edges.model_copy(update={"width": size / 1000})
    if isinstance(section, LinesSection) and section.color_by is None:
        found["color_by"] = "scalars" if found.get("scalars", section.scalars) else "color"
    return section.model_copy(update=found)


def complete_grid(section: GridSection, info: GridInfo) -> GridSection:
    """Return an unstructured grid with the name of its array, clim, opacity and unit distance."""
    low, high = info.scalars or (0.0, 1.0)
    clim = section.clim or ((low, high) if low < high else range_around(low))
    found: dict[str, object] = {"clim": clim, "array": section.array or info.array or None}
    if section.opacity is None:
        found["opacity"] = _default_opacity(section.cmap, clim)
    if section.opacity_unit_distance is None:
        found["opacity_unit_distance"] = info.cell_size or 1.0
    return section.model_copy(update=found)


def box_corners(box: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the eight corners of a box (2, 3), float64 (8, 3); none of no box (0, 3)."""
    return np.array(
        [[box[i, 0], box[j, 1], box[k, 2]] for k, j, i in np.ndindex(2, 2, 2)] if len(box) else np.empty((0, 3))
    )


def complete_volume(volume: Volume, info: VolumeInfo) -> Volume:
    """Return a volume with its part of the file, and colour map, clim, opacity and unit distance in place of optics."""
    parts = {key: part for key, part in info.parts.items() if getattr(volume, key) is None}
    volume = volume.model_copy(update=parts)
    if volume.optics is not None:
        return volume
    clim = volume.clim or default_clim(info)
    cmap = DEFAULT_CMAP if volume.cmap is None else volume.cmap
    found: dict[str, object] = {"clim": clim, "cmap": cmap}
    if volume.transfer_2d is not None:
        found["transfer_2d"] = _completed_table(volume.transfer_2d, clim, min(info.spacing))
    elif volume.opacity is None:
        found["opacity"] = 1.0 if volume.shader is not None else _default_opacity(cmap, clim)
    if volume.opacity_unit_distance is None:
        found["opacity_unit_distance"] = default_unit_distance(info.shape_zyx, info.spacing)
    if BLEND_MODES[volume.blending].threshold and volume.threshold is None:
        found["threshold"] = clim[0] / 2 + clim[1] / 2
    return volume.model_copy(update=found)


def visible_corners(volume: Volume, info: VolumeInfo) -> NDArray[np.float64]:
    """Return the corners, float64 (n, 3), of all blocks that are not transparent.

    Parameters
    ----------
    volume : a completed volume
    """
    mode = BLEND_MODES[volume.blending]
    if info.blocks is None or mode.shows_transparent or min(info.shape_zyx) == 1:
        return info.corners
    low, high = info.blocks
    surfaces = [each[0] if isinstance(each, tuple) else each for each in volume.isosurfaces]
    seen = np.zeros(low.shape, bool)
    if not mode.only_surfaces:
        seen |= ~transfer_function(volume).is_transparent(low, high)
    for value in surfaces:
        seen |= (low <= value) & (value <= high)
    is_end = np.zeros([side + 1 for side in seen.shape], bool)
    for z, y, x in np.ndindex(2, 2, 2):
        is_end[z : z + seen.shape[0], y : y + seen.shape[1], x : x + seen.shape[2]] |= seen
    ends = np.argwhere(is_end)
    shares = np.minimum(1.0, ends * info.block_sides / (np.array(info.shape_zyx) - 1.0))
    # Corners are in x-fastest order, so corners 1, 2 and 4 end the three edges from the first corner.
    first, edges = info.corners[0], info.corners[[1, 2, 4]] - info.corners[0]
    return np.asarray(first + shares[:, ::-1] @ edges)


def default_unit_distance(shape_zyx: tuple[int, int, int], spacing: tuple[float, float, float]) -> float:
    """Return PyVista's default, diagonal / (mean dimension − 1), or the smallest spacing for a single sample.

    References
    ----------
    PyVista, `Plotter.add_volume`, parameter `opacity_unit_distance`.
    """
    steps = sum(shape_zyx) / 3 - 1
    diagonal = math.hypot(*((n - 1) * s for n, s in zip(shape_zyx[::-1], spacing, strict=True)))
    distance = diagonal / steps if steps > 0 else 0.0
    return distance if 0 < distance < math.inf else min(spacing)


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


def _completed_table(settings: Transfer2d, clim: tuple[float, float], spacing: float) -> Transfer2d:
    """Return a table with both ranges; magnitudes end at a quarter of clim a voxel, as in VTK."""
    steepest = min(0.25 * (clim[1] / 2 - clim[0] / 2) / (spacing / 2), LARGEST)
    magnitudes = settings.magnitudes or (0.0, steepest)
    return settings.model_copy(update={"values": settings.values or clim, "magnitudes": magnitudes})


def _default_opacity(cmap: object, clim: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Return the opacity of a ParaView preset if it has one, else `DEFAULT_OPACITY`, in data values."""
    points: tuple[tuple[float, float], ...] = DEFAULT_OPACITY
    if isinstance(cmap, str) and cmap.lower().endswith(".json"):
        from clusterviz.scene.colormaps import read_preset

        points = read_preset(cmap)[2] or DEFAULT_OPACITY
    places, opacities = np.array(points).T
    values = rescale(places, clim)
    return tuple((float(v), float(a)) for v, a in zip(values, opacities, strict=True))
