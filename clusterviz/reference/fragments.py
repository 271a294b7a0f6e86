"""Reference of meshes, lines and points: the fragments of every ray, in the order in which they are composited.

A fragment is an intersection with its colour and opacity. Front to back, equal depths: the order of the scene, then the
number of the primitive. Tubes and spheres have a fragment where a ray enters them and one where it leaves.

Reference: B. T. Phong: Illumination for computer generated pictures, CACM 18(6), 1975 (interpolated normals).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.geometry.section import GeometrySection, LinesSection, MeshSection, PointsSection
from clusterviz.data.geometry import Attributes, Lines, Mesh, Points
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.reference.intersections import Hits, Primitives, Segments, Spheres, Triangles, intersect
from clusterviz.reference.lighting import lit, unit
from clusterviz.reference.rays import Floats, Rays, kept
from clusterviz.reference.transfer import colour_points, interpolate, opacity_points
from clusterviz.scene.background import background_rgb
from clusterviz.scene.values import Scene

SectionGeometry = tuple[MeshSection, Mesh] | tuple[LinesSection, Lines] | tuple[PointsSection, Points]
WORLD = Grid((1, 1, 1))


@dataclass(frozen=True)
class Fragments:
    """Fragments of n rays, sorted."""

    begins: NDArray[np.int64]  # int64 (n + 1,); ray i has the fragments [begins[i], begins[i + 1])
    t: Floats  # float64 (k,), world length along the ray
    rgba: Floats  # float64 (k, 4), straight
    entry: NDArray[np.int64]  # int64 (k,), number of the entry in the scene's geometry
    normal: Floats  # float64 (k, 3), unit vectors in the world, that light it; those of primitives if nothing is lit


@dataclass(frozen=True)
class PlacedGeometry:
    """Primitives of one entry of a scene, with what colours them."""

    section: GeometrySection
    primitives: Primitives  # m of them
    corners: NDArray[np.int64]  # int64 (m, c), vertices of each primitive
    cells: NDArray[np.int64]  # int64 (m,), the triangle or line of the file that each belongs to
    normals: Floats | None  # float64 (n, 3), of vertices; None for those of the primitives
    # arrays of the file by name
    of_vertices: Attributes
    of_cells: Attributes

    @property
    def bounds(self) -> Floats:
        """Corners of the box around all primitives, float64 (2, 3), or (0, 3)."""
        low, high = self.primitives.low, self.primitives.high
        return np.stack([low.min(axis=0), high.max(axis=0)]) if len(low) else np.empty((0, 3))

    def rgba(self, hits: Hits) -> Floats:
        """Return straight colours and opacities, float64 (k, 4), without light."""
        section, count = self.section, len(hits.t)
        rgba = np.tile([*(background_rgb(section.color) or ()), 1.0], (count, 1))
        if isinstance(section.opacity, float):
            rgba[:, 3] = section.opacity
        if (
            isinstance(section, LinesSection)
            and section.color_by == "direction"
            and isinstance(self.primitives, Segments)
        ):
            way = self.primitives.ends - self.primitives.begins
            rgba[:, :3] = np.abs(way / np.linalg.norm(way, axis=1, keepdims=True))[hits.primitive]
        if section.scalars is None or (isinstance(section, LinesSection) and section.color_by not in (None, "scalars")):
            return rgba
        if section.scalars in self.of_vertices:
            stored = np.asarray(self.of_vertices[section.scalars])
            at = stored[self.corners[hits.primitive]].astype(np.float64)
            values = (at * hits.weights.reshape(*hits.weights.shape, *[1] * (at.ndim - 2))).sum(axis=1)
        elif section.scalars in self.of_cells:
            stored = np.asarray(self.of_cells[section.scalars])
            values = stored[self.cells[hits.primitive]].astype(np.float64)
        else:
            allowed = ", ".join([*self.of_vertices, *self.of_cells]) or "none: the file has no arrays"
            raise InputError("no such array", where=section.path, found=section.scalars, allowed=allowed)
        if values.ndim == 2:
            if values.shape[1] not in (3, 4):
                found = f"{values.shape[1]} components"
                raise InputError("neither scalars nor colours", where=section.path, found=found, allowed="1, 3 or 4")
            full = {"uint8": 255, "uint16": 65535}.get(stored.dtype.name, 1)
            rgba[:, :3] = values[:, :3] / full
            if values.shape[1] == 4:
                rgba[:, 3] *= values[:, 3] / full
            return rgba
        finite = stored[np.isfinite(stored)]
        clim = section.clim or ((float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0))
        rgba[:, :3] = interpolate(values, *colour_points(section.cmap, clim))
        places, opacities = opacity_points(section.opacity, clim)
        rgba[:, 3] = interpolate(values, places, opacities[:, None])[:, 0]
        return rgba


def place(section: GeometrySection, geometry: Mesh | Lines | Points) -> PlacedGeometry:
    """Return the primitives of an entry that can be drawn, in the world.

    Raises InputError: the section is of another kind, or an array of radii is missing or not positive.
    """
    matrix = np.array(section.transform or np.eye(4), np.float64)
    if isinstance(section, MeshSection) and isinstance(geometry, Mesh):
        return _mesh(section, geometry, matrix)
    if isinstance(section, LinesSection) and isinstance(geometry, Lines):
        return _lines(section, geometry, matrix)
    if isinstance(section, PointsSection) and isinstance(geometry, Points):
        return _points(section, geometry, matrix)
    found = f"{type(section).__name__} with {type(geometry).__name__}"
    raise InputError("not what the section is for", where=section.path, found=found)


def find_fragments(rays: Rays, geometry: Sequence[PlacedGeometry], scene: Scene) -> Fragments:
    """Return the fragments of rays in the world that are not clipped.

    `geometry`: in the order of the scene; `scene`: for its lights and clipping.
    """
    parts = [_of_geometry(rays, each, number, scene) for number, each in enumerate(geometry)]
    keys = np.concatenate([np.empty((0, 3), np.int64), *(part[0] for part in parts)])
    t, rgba, normal = (
        np.concatenate([np.empty(0), *(p[1] for p in parts)]),
        np.concatenate([np.empty((0, 4)), *(p[2] for p in parts)]),
        np.concatenate([np.empty((0, 3)), *(p[3] for p in parts)]),
    )
    ray, number, primitive = keys.T
    order = np.lexsort((primitive, number, t, ray))
    begins = np.searchsorted(ray[order], np.arange(len(rays.direction) + 1))
    return Fragments(begins, t[order], rgba[order], number[order], unit(normal[order]))


def joined_fragments(parts: Sequence[Fragments]) -> Fragments:
    """Return the fragments of all parts, of the same rays; at one place those of earlier parts come first."""
    ray = np.concatenate([np.repeat(np.arange(len(part.begins) - 1), np.diff(part.begins)) for part in parts])
    t, rgba = np.concatenate([part.t for part in parts]), np.concatenate([part.rgba for part in parts])
    entry, normal = (np.concatenate([getattr(part, name) for part in parts]) for name in ("entry", "normal"))
    order = np.lexsort((t, ray))
    begins = np.searchsorted(ray[order], np.arange(len(parts[0].begins)))
    return Fragments(begins, t[order], rgba[order], entry[order], normal[order])


def _of_geometry(
    rays: Rays, surface: PlacedGeometry, number: int, scene: Scene
) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
    """Return ray, number and primitive (k, 3), t (k,), colours (k, 4) and normals (k, 3) of one entry's fragments."""
    section, hits = surface.section, intersect(rays, surface.primitives)
    point = rays.start[hits.ray] + hits.t[:, None] * rays.direction[hits.ray]
    seen = kept(point, scene.clip, WORLD)
    if isinstance(section, MeshSection) and section.culling != "none":
        is_front = (hits.normal * rays.direction[hits.ray]).sum(axis=1) < 0
        if section.transform is not None and np.linalg.det(np.array(section.transform)) < 0:
            is_front = ~is_front  # a reflection turns the corners' order, not the mesh inside out
        seen &= is_front if section.culling == "back" else ~is_front
    hits, point = hits.some(seen), point[seen]
    rgba = surface.rgba(hits)
    if isinstance(section, MeshSection) and section.edges:
        is_edge = _to_edges(surface.primitives, hits) < 0.5 * (section.edges.width or 0.0)
        rgba[is_edge] = [*(background_rgb(section.edges.color) or ()), section.edges.opacity]
    normal = hits.normal
    if section.shade:
        if surface.normals is not None:
            normal = (surface.normals[surface.corners[hits.primitive]] * hits.weights[..., None]).sum(axis=1)
        rgba[:, :3] = lit(rgba[:, :3], normal, point, rays.direction[hits.ray], section, scene, WORLD)
    return np.stack([hits.ray, np.full(len(hits.ray), number), hits.primitive], axis=1), hits.t, rgba, normal


def _to_edges(triangles: Primitives, hits: Hits) -> Floats:
    assert isinstance(triangles, Triangles)
    corners = triangles.vertices[triangles.corners[hits.primitive]]
    point, found = (corners * hits.weights[:, :, None]).sum(axis=1), np.full(len(hits.t), np.inf)
    for n in range(3):
        begin, way = corners[:, n], corners[:, (n + 1) % 3] - corners[:, n]
        share = np.clip(((point - begin) * way).sum(axis=1) / (way**2).sum(axis=1), 0, 1)
        found = np.minimum(found, np.linalg.norm(point - begin - share[:, None] * way, axis=1))
    return found


def _moved(positions: NDArray[np.floating], matrix: Floats) -> Floats:
    moved: Floats = positions.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def _mesh(section: MeshSection, mesh: Mesh, matrix: Floats) -> PlacedGeometry:
    cells = np.flatnonzero(mesh.drawable)
    vertices, corners = _moved(mesh.vertices, matrix), mesh.triangles[cells].astype(np.int64)
    normals = None
    stored = mesh.vertex_attributes.get("Normals")
    if section.shading == "smooth" and stored is not None and stored.shape == vertices.shape:
        a, b, c = matrix[:3, :3].T
        cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        normals = stored.astype(np.float64) @ cofactors.T
    elif section.shading == "smooth":
        # As VTK: the sum of the unit normals of the triangles around a vertex.
        edges = vertices[corners[:, 1:]] - vertices[corners[:, :1]]
        edges /= np.abs(edges).max(axis=(1, 2), initial=0, keepdims=True)
        across = np.cross(edges[:, 0], edges[:, 1])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        normals = np.zeros(vertices.shape)
        for corner in corners.T:
            np.add.at(normals, corner, across)
    primitives = Triangles(vertices, corners)
    return PlacedGeometry(
        section, primitives, corners, cells, normals, mesh.vertex_attributes, mesh.triangle_attributes
    )


def _lines(section: LinesSection, lines: Lines, matrix: Floats) -> PlacedGeometry:
    """Return the segments between different finite points; a line of one point has none."""
    points = _moved(lines.points, matrix)
    line = np.repeat(np.arange(len(lines.offsets) - 1), np.diff(lines.offsets))
    is_new = np.ones(len(points), bool)
    is_new[1:] = (points[1:] != points[:-1]).any(axis=1) | (line[1:] != line[:-1])
    chosen = np.flatnonzero(is_new)
    joined = (line[chosen][1:] == line[chosen][:-1]) & np.isfinite(points[chosen][1:] + points[chosen][:-1]).all(axis=1)
    begin = np.flatnonzero(joined)
    corners = np.stack([chosen[begin], chosen[begin + 1]], axis=1)
    number = np.arange(len(corners))
    follows = np.zeros(len(corners), bool)
    follows[1:] = corners[1:, 0] == corners[:-1, 1]
    before = np.where(follows, number - 1, -1)
    after = np.where(np.append(follows[1:], False)[: len(number)], number + 1, -1)
    if section.radius is None:
        raise InputError("no radius", where=section.path, allowed="a completed section")
    primitives = Segments(points[corners[:, 0]], points[corners[:, 1]], section.radius, before, after)
    cells = line[corners[:, 0]]
    return PlacedGeometry(section, primitives, corners, cells, None, lines.point_attributes, lines.line_attributes)


def _points(section: PointsSection, points: Points, matrix: Floats) -> PlacedGeometry:
    if section.style == "arrows":
        return _arrows(section, points, matrix)
    centres = _moved(points.positions, matrix)
    if isinstance(section.radius, str):
        if section.radius not in points.attributes:
            allowed = ", ".join([*points.attributes, "a number"])
            raise InputError("no such array of radii", where=section.path, found=section.radius, allowed=allowed)
        radii = points.attributes[section.radius].astype(np.float64)
    else:
        radii = np.full(len(centres), section.radius)
    drawn = np.flatnonzero(np.isfinite(centres).all(axis=1) & (radii > 0) & np.isfinite(radii))
    primitives = Spheres(centres[drawn], radii[drawn])
    return PlacedGeometry(section, primitives, drawn[:, None], drawn, None, points.attributes, {})


SIDES = 12  # of arrows


def _arrows(section: PointsSection, points: Points, matrix: Floats) -> PlacedGeometry:
    """Return arrows as triangles; see `PointsSection` and VTK's arrow source for their shape."""
    vectors, count = points.attributes[section.direction or ""].astype(np.float64), len(points.positions)
    magnitude = np.linalg.norm(vectors, axis=1)

    def of_each(given: float | str) -> Floats:
        return points.attributes[given].astype(np.float64) if isinstance(given, str) else np.full(count, given)

    length = magnitude if section.length is None else of_each(section.length)
    drawn = np.isfinite(points.positions).all(axis=1) & (magnitude > 0) & (length > 0) & np.isfinite(magnitude + length)
    scale = section.scale or 1.0
    if section.scale is None and not isinstance(section.length, float) and drawn.any():
        placed = points.positions[np.isfinite(points.positions).all(axis=1)].astype(np.float64)
        scale = 0.05 * (np.linalg.norm(np.ptp(placed, axis=0)) or 1.0) / length[drawn].max()
    given = section.radius in points.attributes or "radius" in section.model_fields_set
    shaft = of_each(section.radius) if given else 0.03 * scale * length
    drawn &= (shaft > 0) & np.isfinite(shaft)
    a, b, c = matrix[:3, :3].T
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    corners, normals, cells = list[Floats](), list[Floats](), list[int]()
    for n in np.flatnonzero(drawn):
        axis, long, thin = vectors[n] / magnitude[n], scale * length[n], shaft[n]
        thick = thin * 10 / 3
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        first /= np.linalg.norm(first)
        begin = points.positions[n].astype(np.float64)
        neck, end = begin + 0.65 * long * axis, begin + long * axis
        for side in range(SIDES):
            angles = 2 * np.pi * (side + np.array([0, 1, 0.5])) / SIDES
            p, q, between = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * np.cross(axis, first)
            slopes = [0.35 * long * out + thick * axis for out in (p, q, between)]
            slopes = [slope / np.linalg.norm(slope) for slope in slopes]
            base = [begin + thin * p, begin + thin * q]
            ring = [neck + thin * p, neck + thin * q]
            rim = [neck + thick * p, neck + thick * q]
            corners += [np.array([base[0], base[1], ring[1]]), np.array([base[0], ring[1], ring[0]])]
            normals += [np.array([p, q, q]), np.array([p, q, p])]
            corners += [np.array([ring[0], ring[1], rim[1]]), np.array([ring[0], rim[1], rim[0]])]
            corners += [np.array([begin + thin * first, *base])]
            normals += [np.array([-axis] * 3)] * 3
            corners.append(np.array([*rim, end]))
            normals.append(np.array(slopes))
            cells += [int(n)] * 6
    vertices = _moved(np.array(corners).reshape(-1, 3), matrix)
    triangles = np.arange(len(vertices)).reshape(-1, 3)
    across = np.cross(
        vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
    )
    whole = np.flatnonzero(across.any(axis=1))  # the base's first and last triangle are none
    of_points = {**points.attributes, section.direction or "": magnitude}
    bent = np.array(normals).reshape(-1, 3) @ cofactors.T
    return PlacedGeometry(
        section,
        Triangles(vertices, triangles[whole]),
        triangles[whole],
        np.array(cells, np.int64)[whole],
        bent,
        {},
        of_points,
    )
