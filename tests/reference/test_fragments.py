"""The reference of meshes, lines and points against closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clusterviz.content.geometry.section import LinesSection, MeshSection, PointsSection
from clusterviz.data.geometry import Lines, Mesh, Points
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.reference import render_reference
from clusterviz.reference.fragments import find_fragments, place
from clusterviz.reference.intersections import Hits, Segments, Spheres, Triangles, intersect
from clusterviz.reference.rays import Rays
from clusterviz.scene.values import Camera, Clip, ImageSettings, Quality, Scene, Volume

SHAPE = (9, 5, 5)
GRID = Grid(SHAPE)  # 4 × 4 × 8 units
KAPPA = -np.log1p(-0.3) / 2
AXIS = Camera(position=(2.0, 2.0, -20.0), focal_point=(2.0, 2.0, 0.0), view_up=(0, 1, 0), parallel_scale=0.5)
FLAT: dict[str, Any] = {"path": "a", "shade": False}
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
FACES = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
BLUE = np.array([0, 0, 1.0])


def fog(colour: tuple[float, float, float] = (1.0, 0.0, 0.0), opacity: float = 0.3) -> Volume:
    return Volume(path="a", cmap=((0.0, *colour),), clim=(0.0, 1.0), opacity=opacity, opacity_unit_distance=2.0)


def scene_of(*volumes: Volume, camera: Camera = AXIS, size: tuple[int, int] = (1, 1), **keys: Any) -> Scene:
    return Scene(volumes=volumes, camera=camera, image=ImageSettings(size=size), **keys)


def square(z: float, low: float = 0.0, high: float = 4.0, name: str = "m", **arrays: Any) -> Mesh:
    """Two triangles across the z axis, with the front towards −z."""
    vertices = np.array([[low, low, z], [high, low, z], [high, high, z], [low, high, z]])
    return Mesh(name, vertices, np.array([[0, 2, 1], [0, 3, 2]]), **arrays)


def octahedron(radius: float, centre: tuple[float, float, float] = (2.1, 2.2, 4.0)) -> Mesh:
    return Mesh("m", radius * OCTAHEDRON + centre, FACES)


def rays_of(starts: Any, directions: Any) -> Rays:
    starts, directions = np.broadcast_arrays(np.asarray(starts, float), np.asarray(directions, float))
    return Rays(starts.copy(), directions / np.linalg.norm(directions, axis=1, keepdims=True))


def by_ray(hits: Hits, count: int) -> list[np.ndarray]:
    return [np.sort(hits.t[hits.ray == n]) for n in range(count)]


def absorbed(*parts: tuple[float, float, np.ndarray]) -> np.ndarray:
    """Composite (extinction, length, colour) or (−1, opacity, colour) front to back."""
    through, rgb = 1.0, np.zeros(3)
    for kappa, amount, colour in parts:
        alpha = amount if kappa < 0 else -np.expm1(-kappa * amount)
        rgb, through = rgb + through * alpha * colour, through * (1 - alpha)
    return np.array([*rgb, 1 - through])


RED, GREEN = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])


@pytest.mark.parametrize(
    ("z", "step"), [(0.0, 0.5), (0.0, 3.0), (1.0, 1.0), (1.3, 0.37), (4.0, 0.5), (4.0, 3.0), (7.999, 1.0), (8.0, 0.37)]
)
def test_a_sheet_in_fog_divides_its_slab(z: float, step: float) -> None:
    """Also on the faces of the volume and on the borders of slabs, whatever the length of slabs is."""
    scene = scene_of(fog(), quality=Quality(step=step))
    section = MeshSection(**FLAT, color="blue", opacity=0.4)
    found = render_reference(scene, GRID, np.ones(SHAPE), geometry=[(section, square(z))])[0, 0]
    expected = absorbed((KAPPA, z, RED), (-1, 0.4, BLUE), (KAPPA, 8 - z, RED))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_surfaces_beyond_the_volume_widen_the_box_and_count_once() -> None:
    section = MeshSection(**FLAT, color="blue", opacity=0.4)
    sheets = [square(z, -3, 7) for z in (-5.3, -1.0, 2.0, 8.0, 11.7)]
    found = render_reference(scene_of(fog()), GRID, np.ones(SHAPE), geometry=[(section, sheet) for sheet in sheets])
    sheet = (-1, 0.4, BLUE)
    expected = absorbed(sheet, sheet, (KAPPA, 2, RED), sheet, (KAPPA, 6, RED), sheet, sheet)
    # A slab that the volume's face cuts is inside by its midpoint: the lattice begins elsewhere now.
    np.testing.assert_allclose(found[0, 0], expected, rtol=0, atol=0.05)
    fine = scene_of(fog(), quality=Quality(step=1e-2))
    found = render_reference(fine, GRID, np.ones(SHAPE), geometry=[(section, sheet) for sheet in sheets])
    np.testing.assert_allclose(found[0, 0], expected, rtol=0, atol=1e-3)


def test_a_sphere_in_two_fogs() -> None:
    """The ray meets it at 3 and 5, where the second fog begins at 4."""
    scene = scene_of(fog(), fog((0.0, 1.0, 0.0), 0.6), quality=Quality(step=0.25))
    second = Grid(SHAPE, origin=(0.0, 0.0, 4.0))
    section = PointsSection(**FLAT, color="blue", opacity=0.5, radius=1.0)
    points = Points("p", np.array([[2.0, 2.0, 4.0], [np.nan, 2.0, 4.0]]))
    voxels = np.ones(SHAPE)
    found = render_reference(scene, [GRID, second], [voxels, voxels], geometry=[(section, points)])[0, 0]
    other = -np.log1p(-0.6) / 2
    mixed = (KAPPA * RED + other * GREEN) / (KAPPA + other)
    shell = (-1, 0.5, BLUE)
    parts = (KAPPA, 3, RED), shell, (KAPPA, 1, RED), (KAPPA + other, 1, mixed), shell, (KAPPA + other, 3, mixed)
    np.testing.assert_allclose(found, absorbed(*parts, (other, 4, GREEN)), rtol=0, atol=1e-13)


def test_nested_shells_from_outside_and_inside() -> None:
    colours = {"red": RED, "lime": GREEN, "blue": BLUE}
    shells = [
        (MeshSection(**FLAT, color=name, opacity=alpha), octahedron(radius))
        for name, alpha, radius in (("blue", 0.3, 1.0), ("red", 0.5, 3.0), ("lime", 0.7, 2.0))
    ]
    found = render_reference(scene_of(), [], [], geometry=shells)[0, 0]
    front = [(-1, 0.5, colours["red"]), (-1, 0.7, colours["lime"]), (-1, 0.3, colours["blue"])]
    np.testing.assert_allclose(found, absorbed(*front, *front[::-1]), rtol=0, atol=1e-14)
    inside = AXIS.model_copy(update={"position": (2.0, 2.0, 4.0), "focal_point": (2.0, 2.0, 9.0)})
    found = render_reference(scene_of(camera=inside), [], [], geometry=shells)[0, 0]
    np.testing.assert_allclose(found, absorbed(*front[::-1]), rtol=0, atol=1e-14)


def test_equal_depths_keep_the_order_of_the_scene_and_of_the_triangles() -> None:
    vertices = np.array([[-7.1, -3.3, 0.2], [9.3, -4.4, 1.1], [1.7, 11.9, -2.3]])
    turns = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0], [0, 2, 1], [1, 0, 2]])
    names = ("red", "lime", "blue")
    sections = [MeshSection(**FLAT, color=name, opacity=0.5) for name in names]
    for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        geometry = [(sections[n], Mesh("m", vertices, turns[[n, n + 3]])) for n in order]
        found = render_reference(scene_of(), [], [], geometry=geometry)[0, 0]
        colours = [(-1, 0.75, (RED, GREEN, BLUE)[n]) for n in order]
        np.testing.assert_allclose(found, absorbed(*colours), rtol=0, atol=1e-14)
    # The numbers of triangles in one mesh, by their own colours.
    own = Mesh("m", vertices, turns, {}, {"c": np.eye(3)[[0, 1, 2, 0, 1, 2]]})
    found = render_reference(scene_of(), [], [], geometry=[(MeshSection(**FLAT, opacity=0.5, scalars="c"), own)])[0, 0]
    np.testing.assert_allclose(found, absorbed(*[(-1, 0.5, c) for c in (RED, GREEN, BLUE)] * 2), rtol=0, atol=1e-14)
    rays = rays_of(np.random.default_rng(3).normal(0, 1, (200, 3)) - np.array([0, 0, 20]), [[0.01, 0.02, 1]])
    hits = intersect(rays, Triangles(vertices, turns))
    assert all(len(set(t)) == 1 and len(t) == 6 for t in by_ray(hits, 200))


def test_no_ray_passes_between_triangles_or_meets_two() -> None:
    """Rays through vertices, along edges and beside them; a lattice of squares, cut along either diagonal."""
    x, y = np.meshgrid(np.arange(7.0), np.arange(7.0))
    vertices = np.stack([x.ravel(), y.ravel(), np.random.default_rng(1).integers(0, 5, 49)], axis=1)
    corner = np.array([n for n in range(42) if n % 7 < 6])
    square = np.stack([corner, corner + 1, corner + 8, corner + 7], axis=1)
    turned = np.where((corner % 2 == 0)[:, None], square, np.roll(square, 1, axis=1))
    triangles = np.concatenate([turned[:, [0, 1, 2]], turned[:, [2, 0, 3]]])
    at = np.stack(np.meshgrid(np.arange(0.5, 6, 0.25), np.arange(0.5, 6, 0.25)), axis=-1).reshape(-1, 2)
    for sign in (1, -1):
        rays = rays_of(np.column_stack([at, np.full(len(at), -9.0 * sign)]), [[0, 0, sign]])
        assert np.bincount(intersect(rays, Triangles(vertices, triangles)).ray, minlength=len(at)).tolist() == [
            1
        ] * len(at)
    towards = vertices[OCTAHEDRON.shape[0] : 40] - [3.1, 2.9, -20]  # from a point, through vertices
    hits = intersect(rays_of([[3.1, 2.9, -20.0]], towards), Triangles(vertices, triangles))
    is_inner = ((vertices[6:40, :2] > 0) & (vertices[6:40, :2] < 6)).all(axis=1)
    assert (np.bincount(hits.ray, minlength=len(towards))[is_inner] % 2 == 1).all()


def test_a_closed_mesh_is_left_as_often_as_it_is_entered() -> None:
    """Through vertices and edges, and past its silhouette exactly at them."""
    targets = np.concatenate([OCTAHEDRON, (OCTAHEDRON[FACES[:, 0]] + OCTAHEDRON[FACES[:, 1]]) / 2])
    starts = np.array([[5.0, 0, 0], [0, 5, 0], [3, 4, 5], [5, 5, 0], [1, 5, 0]])
    for start in starts:
        hits = intersect(rays_of([start], targets - start), Triangles(OCTAHEDRON, FACES))
        assert (np.bincount(hits.ray, minlength=len(targets)) % 2 == 0).all()


def test_triangles_on_edge_and_far_away() -> None:
    rays = rays_of([[2.0, 2.0, -20.0]], [[0.0, 0, 1], [0, 1e-3, 1]])
    upright = Triangles(np.array([[2.0, 0, 0], [2, 9, 0], [2, 0, 9], [2, 9, 9]]), np.array([[0, 1, 2], [1, 2, 3]]))
    assert len(intersect(rays, upright).t) == 0
    far = np.array([[-1e9, -1e9, 5.0], [1e9, -1e9, 5], [2, 1e9, 5]])
    np.testing.assert_allclose(intersect(rays, Triangles(far, np.array([[0, 1, 2]]))).t[0], 25, rtol=1e-14)
    hits = intersect(rays_of([[2.0, 2.0, -1e9]], [[0.0, 0, 1]]), Spheres(np.array([[2.5, 2, 4.0]]), np.array([1.0])))
    np.testing.assert_allclose(hits.t - 1e9, 4 + np.array([-1, 1]) * 0.75**0.5, rtol=0, atol=2.5e-7)


def test_chords_of_spheres_are_exact() -> None:
    random = np.random.default_rng(5)
    centres, radii = random.uniform(-3, 3, (40, 3)), random.uniform(0.1, 1.5, 40)
    rays = rays_of(random.uniform(-4, 4, (60, 3)), random.normal(size=(60, 3)))
    hits = intersect(rays, Spheres(centres, radii))
    away = rays.start[:, None] - centres
    b = (away * rays.direction[:, None]).sum(axis=2)
    square = b**2 - (away**2).sum(axis=2) + radii**2
    with np.errstate(invalid="ignore"):
        expected = np.stack([-b - np.sqrt(square), -b + np.sqrt(square)])
    assert len(hits.t) == (expected >= 0).sum()
    np.testing.assert_allclose(np.sort(hits.t), np.sort(expected[expected >= 0]), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(hits.normal, axis=1), radii[hits.primitive], rtol=1e-12)


def tube(points: Any, radius: float = 0.5) -> Segments:
    points = np.asarray(points, float)
    lines = Lines("l", points, np.array([0, len(points)]))
    return place(LinesSection(**FLAT, radius=radius), lines).primitives  # type: ignore[return-value]


def test_joints_of_tubes_are_no_surfaces() -> None:
    """A straight tube of four segments, one without length, is that of one; every ray but those that touch it."""
    random = np.random.default_rng(7)
    rays = rays_of(random.uniform(-3, 3, (400, 3)), random.normal(size=(400, 3)))
    along = np.array([1.0, 2.0, -0.5])
    whole = by_ray(intersect(rays, tube([-along, along])), 400)
    parts = by_ray(intersect(rays, tube([along * t for t in (-1, -0.9, 0.25, 0.25, 1)])), 400)
    assert sum(len(t) for t in whole) > 50
    for one, several in zip(whole, parts, strict=True):
        np.testing.assert_allclose(several, one, atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_tubes_are_entered_and_left_where_the_distance_to_the_line_is_the_radius(seed: int) -> None:
    random = np.random.default_rng(seed)
    a, b, c = random.uniform(-1, 1, (3, 3)) * [2, 2, 1]
    rays = rays_of(random.uniform(-4, 4, (300, 3)), random.normal(size=(300, 3)))

    def distance(points: np.ndarray) -> np.ndarray:
        found = []
        for begin, end in ((a, b), (b, c)):
            way = end - begin
            share = np.clip((points - begin) @ way / (way @ way), 0, 1)
            found.append(np.linalg.norm(points - begin - share[..., None] * way, axis=-1))
        return np.min(found, axis=0)

    hits = intersect(rays, tube([a, b, c]))
    points = rays.start[hits.ray] + hits.t[:, None] * rays.direction[hits.ray]
    np.testing.assert_allclose(distance(points), 0.5, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(hits.normal, axis=1), 0.5, atol=1e-9)
    for n, t in enumerate(by_ray(hits, 300)):
        cuts = np.concatenate([[0], t, [t[-1] + 2 if len(t) else 20]])
        middles = rays.start[n] + (cuts[:-1] + np.diff(cuts) / 2)[:, None] * rays.direction[n]
        starts_inside = distance(rays.start[n]) < 0.5
        assert (distance(middles) < 0.5).tolist() == [(k + starts_inside) % 2 == 1 for k in range(len(middles))]


def test_lines_end_at_positions_that_are_not_finite() -> None:
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [np.nan, 0, 0], [2, 0, 0], [2, 0, 0], [3, 0, 0], [9, 9, 9], [5, 0, 0], [6, 0, 0]]
    )
    placed = place(LinesSection(**FLAT, radius=1.0), Lines("l", points, np.array([0, 6, 7, 7, 9])))
    segments: Any = placed.primitives
    assert placed.corners.tolist() == [[0, 1], [3, 5], [7, 8]]
    assert placed.cells.tolist() == [0, 0, 3]
    assert (segments.before.tolist(), segments.after.tolist()) == ([-1] * 3, [-1] * 3)
    chain = place(LinesSection(**FLAT, radius=1.0), Lines("l", points[[0, 1, 3, 5]], np.array([0, 4])))
    assert (chain.primitives.before.tolist(), chain.primitives.after.tolist()) == ([-1, 0, 1], [1, 2, -1])  # type: ignore[attr-defined]


HEAT = np.array([0.0, 1.0, 2.0, 1.0])  # of the corners of a square: x + y over 4
COLOURS: dict[str, tuple[dict[str, Any], dict[str, Any], tuple[float, ...]]] = {
    "vertices": ({"scalars": "h"}, {"vertex_attributes": {"h": HEAT}}, (0.5, 0.5, 0.5, 1)),
    "clim": ({"scalars": "h", "clim": (0.0, 4.0)}, {"vertex_attributes": {"h": HEAT}}, (0.25, 0.25, 0.25, 1)),
    "opacity": (
        {"scalars": "h", "opacity": [(0.0, 0.0), (2.0, 0.5)]},
        {"vertex_attributes": {"h": HEAT}},
        (0.125, 0.125, 0.125, 0.25),
    ),
    "faces": ({"scalars": "h"}, {"triangle_attributes": {"h": np.array([0, 7])}}, (1, 1, 1, 1)),
    "bytes": (
        {"scalars": "c"},
        {"vertex_attributes": {"c": np.array([[255, 0, 51, 102]] * 4, np.uint8)}},
        (0.4, 0, 0.08, 0.4),
    ),
    "colour": ({"color": "#ff0033", "opacity": 0.5}, {}, (0.5, 0, 0.1, 0.5)),
    "nan": ({"scalars": "h"}, {"triangle_attributes": {"h": np.array([3.0, np.nan])}}, (0, 0, 0, 0)),
}


@pytest.mark.parametrize("name", COLOURS)
def test_colours_and_opacities(name: str) -> None:
    keys, arrays, expected = COLOURS[name]
    section = MeshSection(**FLAT, **{"cmap": [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)], **keys})
    camera = AXIS.model_copy(update={"position": (1.5, 2.5, -9.0), "focal_point": (1.5, 2.5, 0.0)})
    found = render_reference(scene_of(camera=camera), [], [], geometry=[(section, square(1, **arrays))])[0, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_direction_culling_transform_clipping_and_light() -> None:
    def drawn(section: Any, geometry: Any, **keys: Any) -> np.ndarray:
        return render_reference(scene_of(**keys), [], [], geometry=[(section, geometry)])[0, 0]

    line = Lines("l", np.array([[-1.0, 2, 3], [2, 2, 3], [2, 6, 6]]), np.array([0, 3]))
    shown = LinesSection(**FLAT, radius=0.25, color_by="direction")
    assert drawn(shown.model_copy(update={"radius": 0.2}), line).tolist() == pytest.approx([1, 0, 0, 1], abs=1e-12)
    front, back = (MeshSection(**FLAT, culling=side) for side in ("back", "front"))
    assert (drawn(front, square(1))[3], drawn(back, square(1))[3]) == (1, 0)
    mirror = ((-1, 0, 0, 4), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    mirrored = (one.model_copy(update={"transform": mirror}) for one in (front, back))
    assert [drawn(one, square(1))[3] for one in mirrored] == [1, 0]
    moved = MeshSection(**FLAT, transform=((1, 0, 0, 9), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))
    assert drawn(moved, square(1))[3] == 0
    turned = MeshSection(**FLAT, transform=((0, -1, 0, 4), (1, 0, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))
    assert drawn(turned, square(1))[3] == 1
    clip = Clip(planes=(((0, 0, 2), (0, 0, 1)),))
    assert [drawn(front, square(z), clip=clip)[3] for z in (1, 3)] == [0, 1]
    # A slope of 45 degrees under a headlight; and a sphere beside its middle.
    slope = Mesh("m", np.array([[0.0, 0, 0], [4, 0, 4], [4, 4, 4], [0, 4, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    for shading in ("flat", "smooth"):
        lit = MeshSection(path="a", shading=shading, ambient=0.1, diffuse=0.5)
        np.testing.assert_allclose(drawn(lit, slope)[:3], 0.1 + 0.5 * 0.5**0.5, atol=1e-12)
    normals = replace(slope, vertex_attributes={"Normals": np.tile([0, 0, 5.0], (4, 1))})
    np.testing.assert_allclose(drawn(MeshSection(path="a"), normals)[:3], 1, atol=1e-12)
    np.testing.assert_allclose(drawn(MeshSection(path="a", shading="flat"), normals)[:3], 0.5**0.5, atol=1e-12)
    ball = Points("p", np.array([[2.6, 2, 3]]), {"radius": np.array([1.0])})
    np.testing.assert_allclose(drawn(PointsSection(path="a"), ball)[:3], 0.8, atol=1e-12)


def test_many_primitives_are_all_found_once() -> None:
    """Divided or not, pairs of rays and primitives are the same."""
    random = np.random.default_rng(2)
    vertices = random.uniform(-1, 1, (900, 3))
    triangles = Triangles(vertices, np.arange(900).reshape(300, 3))
    rays = rays_of(random.uniform(-2, 2, (500, 3)), random.normal(size=(500, 3)))
    hits, plain = intersect(rays, triangles), triangles.meet(rays, np.arange(500), np.arange(300)).some
    every = triangles.meet(rays, np.arange(500), np.arange(300))
    every = plain(every.t >= 0)
    order, other = np.lexsort((hits.primitive, hits.ray)), np.lexsort((every.primitive, every.ray))
    np.testing.assert_array_equal(hits.ray[order], every.ray[other])
    np.testing.assert_array_equal(hits.t[order], every.t[other])
    fragments = find_fragments(rays, [place(MeshSection(**FLAT), Mesh("m", vertices, triangles.corners))], scene_of())
    assert fragments.begins[-1] == len(hits.t)
    assert all(
        (np.diff(fragments.t[a:b]) >= 0).all() for a, b in zip(fragments.begins, fragments.begins[1:], strict=False)
    )


def test_what_has_no_meaning_is_refused() -> None:
    points = Points("p", np.zeros((2, 3)))
    for section, geometry, said in (
        (PointsSection(**FLAT), points, "no such array of radii; found radius"),
        (MeshSection(**FLAT), points, "MeshSection with Points"),
    ):
        with pytest.raises(InputError, match=said):
            place(section, geometry)
    gone = MeshSection(**FLAT, scalars="gone"), square(1, vertex_attributes={"h": HEAT})
    with pytest.raises(InputError, match="no such array; found gone; allowed h"):
        render_reference(scene_of(), [], [], geometry=[gone])
    empty = Mesh("m", np.empty((0, 3)), np.empty((0, 3), int))
    assert not render_reference(scene_of(), [], [], geometry=[(MeshSection(**FLAT), empty)]).any()
    with pytest.raises(InputError, match="not a colour"):
        MeshSection(path="a", color="transparent")
