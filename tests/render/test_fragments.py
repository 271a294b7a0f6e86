"""Meshes, lines and points in the ray casters: against the float64 reference, alone and with volumes, in any parts."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any, get_args

import moderngl
import numpy as np
import pytest
from render import scenes
from render.scenes import Prepared, noise

from clusterviz.comm import LoopbackChannel
from clusterviz.content.geometry.section import GeometrySection, LinesSection, MeshSection, PointsSection
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import DeviceError
from clusterviz.frame import Options, Run, prepare
from clusterviz.gl.device import Device
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox, Piece, build_tree
from clusterviz.reference import render_reference
from clusterviz.render import opengl
from clusterviz.render.abuffer import fills, raster, tiles
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.render_result import RenderResult
from clusterviz.scene.values import Camera, Clip, Cluster, Fill, ImageSettings, Light, Quality, Resolve, Scene, Volume
from clusterviz.spmd.width import WIDTHS, Width

Entry = tuple[GeometrySection, Mesh | Lines | Points]
Part = tuple[Volume, np.ndarray, Grid]
LIGHTS = (Light(position=(30, 20, 60), focal_point=(5, 5, 5)), Light(type="headlight", intensity=0.5))


FILLS, RESOLVES = get_args(Fill)[1:], get_args(Resolve)[1:]
EACH = pytest.mark.parametrize("caster", [pytest.param("gl", marks=pytest.mark.gl), "cpu"])


@pytest.fixture
def where(request: pytest.FixtureRequest, caster: str) -> moderngl.Context | None:
    """The context, or None for the CPU."""
    return request.getfixturevalue("context") if caster == "gl" else None


def volume(low: float, high: float, green: float, **keys: Any) -> Volume:
    width = high - low
    points = ((low, 0.0), (low + 0.5 * width, 0.0), (low + 0.6 * width, 0.05), (high, 0.4))
    colours = ((low, 0.0, green, 1.0), (high, 1.0, 1.0 - green, 0.4))
    return Volume(path="a", clim=(low, high), opacity=points, cmap=colours, opacity_unit_distance=3.0, **keys)


BYTES = (volume(20, 230, 1.0), noise((19, 23, 26), np.uint8), Grid((19, 23, 26)))
FLOATS = (volume(-0.8, 0.8, 0.0), noise((15, 12, 17)), Grid((15, 12, 17), (0.9, 0.8, 1.0), (5, 4, 3)))
CAMERAS = {
    "outside": Camera(position=(60, 50, 40), focal_point=(12, 10, 9), view_up=(0, 0, 1)),
    "inside": Camera(position=(12, 10, 7), focal_point=(10, 12, 18), view_up=(0, 1, 0), view_angle=80),
    "parallel": Camera(position=(60, -50, 40), focal_point=(12, 10, 9), view_up=(0, 0, 1), parallel_scale=14),
    "far": Camera(position=(6e6, 5e6, 4e6), focal_point=(12, 10, 9), view_up=(0, 0, 1), view_angle=2.5e-4),
}


def sphere(radius: float, centre: tuple[float, float, float], count: int = 12) -> Mesh:
    """A closed surface with an array of its vertices and one of its triangles."""
    v, u = np.meshgrid(np.arange(count + 1), np.arange(2 * count), indexing="ij")
    theta, phi = np.pi * v / count, np.pi * u / count
    unit = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    index = np.arange(unit[..., 0].size).reshape(unit.shape[:2])
    # One vertex for each pole, and none twice.
    index[0], index[-1] = index[0, 0], index[-1, 0]
    a, b = index[:-1], index[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))])
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[distinct]
    vertices = (radius * unit.reshape(-1, 3) + centre).astype(np.float32)
    return Mesh(
        "m",
        vertices,
        triangles,
        {"height": vertices[:, 2].astype(np.float64)},
        {"number": np.arange(len(triangles)) % 7},
    )


def section(**keys: Any) -> MeshSection:
    return MeshSection(path="m", **keys)


def prepared(scene: Scene, parts: tuple[Part, ...], entries: tuple[Entry, ...]) -> Prepared:
    kinds = {"mesh": Mesh, "lines": Lines, "points": Points}
    given = [Geometry(**{name: one for name, kind in kinds.items() if isinstance(one, kind)}) for _, one in entries]
    sources = [ArraySource(part[1], part[2]) for part in parts]
    sections: dict[str, list[Any]] = {"meshes": [], "lines": [], "points": []}
    for look, one in entries:
        sections[{Mesh: "meshes", Lines: "lines", Points: "points"}[type(one)]].append(look)
    scene = scene.model_copy(update={key: tuple(some) for key, some in sections.items()})
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, [*sources, *given])
    assert share.plan is not None
    return Prepared(share.plan, bricks)


def scene_of(parts: tuple[Part, ...], camera: str = "outside", brick: int = 64, **keys: Any) -> Scene:
    return Scene(
        volumes=tuple(part[0] for part in parts),
        camera=CAMERAS[camera],
        image=ImageSettings(size=keys.pop("size", (40, 30))),
        quality=Quality(step=keys.pop("step", 0.7), **keys.pop("quality", {})),
        cluster=Cluster(brick=brick),
        **keys,
    )


def expected(scene: Scene, parts: tuple[Part, ...], entries: tuple[Entry, ...]) -> np.ndarray:
    return render_reference(scene, [p[2] for p in parts], [p[1] for p in parts], geometry=entries)


def drawn(
    where: Any, scene: Scene, parts: tuple[Part, ...], entries: tuple[Entry, ...], leaves: int = 1, **limits: Any
) -> np.ndarray:
    return scenes.drawn(where, prepared(scene, parts, entries), leaves, **limits)[0]


def by_schemes(given: Prepared, fill: Fill, resolve: Resolve) -> Prepared:
    content = replace(given.plan.content, fill=fill, resolve=resolve)
    return Prepared(replace(given.plan, content=content), given.bricks)


INNER, OUTER = sphere(5.0, (12.1, 10.3, 9.2)), sphere(8.3, (12.4, 10.9, 9.1), 9)
PLAIN = (
    (section(shade=False, color="red", opacity=0.4), OUTER),
    (section(shade=False, color="blue", opacity=0.7), INNER),
)
LIT = (
    (section(color="ivory", opacity=0.3, specular=0.4, specular_power=12.0, ambient=0.1, diffuse=0.8), OUTER),
    (section(scalars="height", opacity=((5.0, 0.1), (14.0, 0.9)), shading="flat"), INNER),
)
MIRROR = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, -1, 18.1), (0, 0, 0, 1))
CULLED = tuple(
    (one.model_copy(update=keys), mesh)
    for (one, mesh), keys in zip(PLAIN, ({"culling": "front"}, {"culling": "back", "transform": MIRROR}), strict=True)
)
EDGED = (
    (section(opacity=0.3, transform=np.diag([1, 1.3, 0.9, 1]).tolist(), edges={"color": "red", "width": 0.7}), OUTER),
    (section(opacity=0.0, shade=False, edges={"color": "lime", "width": 0.4, "opacity": 0.6}), INNER),
)
SHELLS = (BYTES[0].model_copy(update={"isosurfaces": (100.0, (150.0, 0.5)), "blending": "isosurface"}), *BYTES[1:])
CUT = {"clip": Clip(planes=(((11, 9, 9), (0.2, 1, 1)),))}
STEPS, BEGINS = np.random.default_rng(2).normal(0, 1.4, (3, 12, 3)), np.array([[12, 8, 9], [9, 12, 8], [12, 11, 12]])
PATHS = BEGINS[:, None] + np.cumsum(STEPS, axis=1)
ATOMS = np.random.default_rng(3).normal((12, 10, 9), 3.0, (25, 3))
FIBRES = Lines("l", PATHS.reshape(-1, 3).astype(np.float32), np.array([0, 12, 24, 36]), {"x": PATHS[..., 0].ravel()})
BALLS = Points("p", ATOMS, {"radius": np.linspace(0.4, 2.5, 25), "rgb": np.random.default_rng(4).random((25, 3))})
MIXED: tuple[Entry, ...] = (
    (LinesSection(path="l", radius=0.7, opacity=0.6, color_by="direction", specular=0.5, specular_power=9.0), FIBRES),
    (PointsSection(path="p", scalars="rgb", opacity=0.5), BALLS),
)
VECTORS = np.random.default_rng(6).normal(0, 2.0, (25, 3))
VECTORS[3], VECTORS[4, 1] = 0, np.nan
FLOW, BESIDE = (
    Points("p", ATOMS + n, {"v": VECTORS, "size": np.linspace(-1.0, 6, 25), "thin": np.linspace(0.1, 0.5, 25)})
    for n in (0, 0.7)
)
STRAIGHT: dict[str, Any] = {"path": "p", "style": "arrows", "direction": "v"}
ASIDE = ((0.9, 0.3, 0, -3.0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
ARROWS: tuple[Entry, ...] = (
    (PointsSection(**STRAIGHT, scale=2.5, scalars="v", opacity=0.6, specular=0.3, specular_power=9.0), FLOW),
    (PointsSection(**STRAIGHT, length="size", radius="thin", color="red", opacity=0.5, shade=False), BESIDE),
    (PointsSection(**STRAIGHT, length=5.0, radius=0.2, transform=ASIDE), FLOW),
)
SCALED = ((0.9, 0.3, 0, -3.0), (0, 1.2, 0, -1.0), (0.1, 0, 0.8, 2.0), (0, 0, 0, 1.0))
WHOLE: tuple[Entry, ...] = (
    (section(shade=False, color="red", transform=SCALED), sphere(3.0, (12.1, 8.3, 9.2))),
    (LinesSection(path="l", radius=1.1, scalars="x", color_by="scalars", clim=(5.0, 15.0)), FIBRES),
)
CASES = {
    "alone": ((), PLAIN, {}, ("outside", "inside", "parallel", "far")),
    "alone, lit": ((), LIT, {"lights": LIGHTS}, ("outside", "inside")),
    "volumes": ((BYTES, FLOATS), PLAIN, {}, ("outside", "inside", "parallel")),
    "isosurfaces, lit, clipped": ((SHELLS, FLOATS), LIT, {"lights": LIGHTS} | CUT, ("outside",)),
    "clipped, culled": ((), CULLED, CUT, ("inside", "parallel")),
    "edges": ((BYTES,), EDGED, {}, ("outside", "inside")),
    "arrows": ((BYTES,), ARROWS, {"lights": LIGHTS}, ("outside", "inside")),
    "jittered": ((BYTES, FLOATS), PLAIN, {"quality": {"jitter": True}}, ("inside",)),
    "tubes and spheres": ((BYTES, FLOATS), MIXED, {"lights": LIGHTS}, ("outside", "inside", "parallel", "far")),
    "meshes, tubes and spheres, clipped": ((), (*LIT, *MIXED), CUT, ("outside",)),
    "one volume": ((BYTES,), PLAIN, {}, ("outside",)),
    "opaque": ((BYTES, FLOATS), WHOLE, {}, ("outside", "inside")),
    "opaque in front of others": ((BYTES, FLOATS), (*PLAIN, *WHOLE, *MIXED), {}, ("outside",)),
    "long slabs, twice": ((BYTES, FLOATS), (*PLAIN, *LIT), {"step": 9.0}, ("outside",)),
}


@pytest.mark.cover(
    "isosurfaces, lit, clipped-outside-gl",
    "jittered-inside-gl",
    "isosurfaces, lit, clipped-outside-cpu",
    "arrows-outside-gl",
    "opaque-outside-gl",
    "long slabs, twice-outside-gl",
    "edges-outside-gl",
    "tubes and spheres-outside-gl",
)
@EACH
@pytest.mark.parametrize(("name", "camera"), [(name, camera) for name in CASES for camera in CASES[name][3]])
def test_pictures_are_the_reference(where: Any, caster: str, name: str, camera: str) -> None:
    parts, entries, keys, _ = CASES[name]
    scene = scene_of(parts, camera, **keys)
    right = expected(scene, parts, entries)
    found = drawn(where, scene, parts, entries)
    assert right[..., 3].max() > 0.3
    wrong = np.abs(found - right).max(axis=-1) > 1e-5
    assert wrong.mean() <= (0.005 if "isosurfaces" in name else 0)


@pytest.mark.cover("volumes-gl", "alone-gl")
@EACH
@pytest.mark.parametrize(("parts", "step"), [((BYTES, FLOATS), 2.0), ((), 0.7)], ids=["volumes", "alone"])
def test_neither_parts_nor_bricks_nor_memory_nor_vectors_change_the_picture(
    where: Any, caster: str, parts: tuple[Part, ...], step: float
) -> None:
    """Long slabs reach far beyond their bricks."""
    first = drawn(None, scene_of(parts, "inside", 64, step=step), parts, LIT)
    for brick, leaves in ((9, 5), (13, 1)):
        limits: dict[str, Any] = {"block_bytes": 1 << 16} if where else {"width": WIDTHS[-1]}
        found = drawn(where, scene_of(parts, "inside", brick, step=step), parts, LIT, leaves, **limits)
        assert np.abs(found - first).max() <= 2e-6, brick


@pytest.mark.cover("gl")
@EACH
def test_bricks_of_other_ranks_within_a_box_are_left_to_them(where: Any, caster: str) -> None:
    """Every second brick of the whole box."""
    scene = prepared(scene_of((), "outside", 9), (), LIT)
    box, layout = build_tree(scene.plan.cost, 1).leaves[0].box, scene.plan.layout
    even = np.indices(layout.counts_zyx).sum(axis=0) % 2 == 0
    counts = [
        scenes.draw_pieces(where, scene, (Piece(0, box, own),))[0][0].fragments for own in (even, ~even, even | ~even)
    ]
    assert counts[0].any()
    assert counts[1].any()
    assert np.array_equal(counts[0] + counts[1], counts[2])


@EACH
def test_a_ray_through_an_edge_or_a_vertex_meets_one_triangle(where: Any, caster: str) -> None:
    """Every second pixel looks at a vertex of a grid, the others at edges, diagonals included; OpenGL rasterises."""
    cells = np.stack(np.meshgrid(np.arange(9), np.arange(9), indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
    squares = np.array([[i, i + 1, i + 10, i + 9] for i in range(72) if i % 9 < 8])
    triangles = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    sheet = np.column_stack([cells + 6, 9.5 + 0.1 * np.sin(cells[:, 0])]).astype(np.float32)
    mesh = Mesh("m", sheet, triangles)
    scene = scene_of((), size=(17, 17))
    # Pixel (i, j) looks at (6 + i / 2, 14 - j / 2).
    camera = Camera(position=(10, 10, -20), focal_point=(10, 10, 0), view_up=(0, 1, 0), parallel_scale=4.25)
    scene = scene.model_copy(update={"camera": camera})
    given = prepared(scene, (), ((section(shade=False, opacity=0.5), mesh),))
    found = rasterised(where, given) if where else on_cpu(given)
    alpha = scenes.whole(found.partial, (17, 17))[..., 3]
    assert np.array_equal(np.unique(alpha[1:-1, 1:-1]), [0.5])
    assert np.isin(alpha, [0.0, 0.5]).all()


def test_equal_fragments_are_in_the_order_of_the_list() -> None:
    """The same surface several times, its triangles turned and listed otherwise."""
    mesh = INNER
    turned = Mesh("m", mesh.vertices, mesh.triangles[:, [2, 0, 1]])
    entries = tuple(
        (section(shade=False, color=colour, opacity=0.5), one)
        for colour, one in (("red", mesh), ("lime", turned), ("blue", mesh))
    )
    scene = scene_of((), "inside")
    found = drawn(None, scene, (), entries)
    assert np.abs(found - expected(scene, (), entries)).max() <= 1e-6
    assert found[..., 0].max() == 0.5


@pytest.mark.long
@EACH
def test_all_schemes_give_the_same_picture(where: Any, caster: str) -> None:
    """More fragments than the pools begin with and than are sorted at once, some equal, with a volume."""
    coarse = sphere(5.0, (12.1, 10.3, 9.2), 5)
    entries = (*LIT, *((section(opacity=0.01 * n), coarse) for n in range(1, 18)), *MIXED)
    # Programs for few classes on OpenGL, which compiles long.
    first = prepared(scene_of((BYTES,), size=(8, 8) if where else (40, 30)), (BYTES,), entries)
    fragments = scenes.draw_pieces(where, first, (Piece(0, BrickBox((0, 0, 0), first.plan.layout.counts_zyx)),))[0][0]
    assert 32 < fragments.fragments.max() <= 64
    pairs = list(product(FILLS, RESOLVES)) if caster == "cpu" else list(zip(FILLS, RESOLVES, strict=True))
    right = scenes.drawn(where, by_schemes(first, "dynamic", "static"))[0]
    for fill, resolve in pairs:
        assert np.array_equal(scenes.drawn(where, by_schemes(first, fill, resolve))[0], right), (fill, resolve)


@pytest.mark.cover("8-lists-gl")
@EACH
@pytest.mark.parametrize("fill", FILLS)
@pytest.mark.parametrize("share", [8, 1])
def test_a_limit_of_memory_divides_the_picture(
    where: Any, caster: str, fill: Fill, share: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In rows, of which as few as cannot be divided take more."""
    first = by_schemes(prepared(scene_of((), "inside", size=(40, 45)), (), LIT), fill, "static")
    whole = scenes.drawn(where, first)[0]
    monkeypatch.setattr(fills, "MOST_BYTES", 40 * 8 * 9 * share)
    assert np.array_equal(scenes.drawn(where, first)[0], whole)


@pytest.mark.parametrize("fill", FILLS)
def test_no_memory_for_one_more_page_is_an_error_or_divides(fill: Fill) -> None:
    """Three fragments in a pixel, and more in each pass."""
    asked = []

    def run(step: str, lists: fills.Lists, fragments: int, pages: int) -> None:
        asked.append(fragments)
        lists[fills.HEAD + 1 :: 2] = 20
        if step != "count" and fragments >= 20 * (len(lists) - fills.HEAD) // 2:
            raise MemoryError

    with pytest.raises(DeviceError, match=r"no memory for the fragments of 8 x 8 pixels; needed \d+ bytes"):
        fills.store_fragments(fill, Rect(8, 16, 16, 24), fills.Pools(), run)
    assert len(asked) == 2
    with pytest.raises(fills.ManyFragmentsError):
        fills.store_fragments(fill, Rect(0, 0, 8, 16), fills.Pools(), run)


def test_opaque_geometry_alone_has_one_place_for_each_pixel() -> None:
    chosen = [prepared(scene_of(()), (), entries).plan.content.fill for entries in (WHOLE, PLAIN, (*PLAIN, *WHOLE))]
    assert chosen == ["fixed", "auto", "auto"]


@pytest.mark.cover("gl")
@EACH
def test_lists_of_pixels_and_of_tiles_give_one_picture(
    where: Any, caster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, pictures = scene_of((), "inside", size=(41, 30)), []
    for small in (0, np.inf):
        monkeypatch.setattr(tiles, "SMALL", small)
        pictures.append(drawn(where, scene, (), (*LIT, *MIXED)))
    assert np.array_equal(*pictures)


@pytest.mark.parametrize(
    ("asked", "schemes"),
    [
        ({}, ("auto", "static")),
        ({"fill": "fixed"}, ("fixed", "static")),
        ({"fill": "pages"}, ("pages", "peeling")),
        ({"fill": "lists", "resolve": "static"}, ("lists", "static")),
        ({"resolve": "both"}, ("auto", "both")),
    ],
)
def test_schemes_are_keys_of_the_scene(asked: dict[str, str], schemes: tuple[str, str]) -> None:
    scene = scene_of((), quality={"abuffer": asked}, size=(8, 8))
    content = prepared(scene, (), PLAIN).plan.content
    assert content
    assert (content.fill, content.resolve) == schemes


def test_the_fill_is_chosen_by_the_fragments_of_the_last_frame() -> None:
    """Fixed places where most pixels have many, and not for the first frame."""
    pools, plan = fills.Pools(), prepared(scene_of((), size=(8, 8)), (), PLAIN).plan
    for counts, fill in (([], "dynamic"), ([0] * 9, "fixed"), ([20] * 8 + [24], "fixed"), ([0] * 99 + [24], "dynamic")):
        if counts:
            pools.note(np.array(counts, np.uint32))
        content = fills.with_fill(plan, pools).content
        assert content
        assert content.fill == fill


@pytest.mark.gl
def test_llvmpipe_refuses_what_it_would_leave_out(context: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    if "llvmpipe" not in context.info["GL_RENDERER"]:
        pytest.skip("another driver ends no loops")
    monkeypatch.setattr(opengl, "LLVMPIPE_ITERATIONS", 100)
    with pytest.raises(DeviceError, match="too many primitives in a tile for llvmpipe; found "):
        drawn(context, scene_of((), "inside"), (), LIT)


@pytest.mark.cover("fixed-peeling-False-cpu", "pages-static-True-cpu")
@EACH
@pytest.mark.parametrize(
    ("fill", "resolve", "coincident"),
    [("dynamic", "static", False), ("fixed", "peeling", False), ("pages", "static", True)],
)
def test_many_fragments_in_one_pixel(where: Any, caster: str, fill: Fill, resolve: Resolve, coincident: bool) -> None:
    """Far beyond what is sorted at once, and elsewhere none."""
    count = 10000
    if where:
        count = 3000 if fill == "dynamic" else 200
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1.5, 0]]) * 0.1 + [10.2, 10.2, 0]
    depths = np.random.default_rng(1).permutation(np.linspace(2, 18, count))
    vertices = (corners + (0 * depths + 7 if coincident else depths)[:, None, None] * [0, 0, 1]).reshape(-1, 3)
    mesh = Mesh("m", vertices, np.arange(3 * count).reshape(-1, 3), {}, {"z": depths})
    camera = Camera(position=(10, 10, -20), focal_point=(10, 10, 0), view_up=(0, 1, 0), parallel_scale=2.0)
    scene = scene_of((), size=(10, 10)).model_copy(update={"camera": camera})
    entries = ((section(shade=False, scalars="z", opacity=0.001, clim=(2.0, 18.0)), mesh),)
    found = scenes.drawn(where, by_schemes(prepared(scene, (), entries), fill, resolve))[0]
    assert 1 <= (found[..., 3] > 0).sum() <= 2
    assert np.abs(found - expected(scene, (), entries)).max() <= 2e-5


@pytest.mark.cover
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 1e9), (1e-9, 0.0), (1e9, 0.0)])
def test_neither_units_nor_the_origin_matter(scale: float, offset: float) -> None:
    """From within the meshes; with one lane, too."""
    first, near = drawn(None, scene_of((), "inside"), (), PLAIN), CAMERAS["inside"]
    places = {name: tuple(scale * x + offset for x in getattr(near, name)) for name in ("position", "focal_point")}
    scene = scene_of((), "inside").model_copy(update={"camera": near.model_copy(update=places)})
    entries = tuple(
        (one, replace(mesh, vertices=scale * mesh.vertices.astype(np.float64) + offset)) for one, mesh in PLAIN
    )
    assert np.abs(drawn(None, scene, (), entries, width=Width(1, "one lane")) - first).max() <= 1e-6


@pytest.mark.parametrize(("position", "scale"), [((-20, 10, 9), 8.0), ((10, 10, -20), None), ((10, 10, 9), None)])
def test_a_plane_alone(position: tuple[float, float, float], scale: float | None) -> None:
    """Seen edge-on, from its front, and from within."""
    corners = np.array([[4.0, 4, 9], [16, 4, 9], [16, 16, 9], [4, 16, 9]])
    entries = ((section(opacity=0.5), Mesh("m", corners, np.array([[0, 2, 1], [0, 3, 2]]))),)
    camera = Camera(position=position, focal_point=(12, 10.001, 9), view_up=(0.1, 0.2, 1), parallel_scale=scale)
    scene = scene_of(()).model_copy(update={"camera": camera})
    assert np.abs(drawn(None, scene, (), entries) - expected(scene, (), entries)).max() <= 1e-6


SQUARE = np.array([[5.0, 5, 9], [16, 4, 9], [16, 16, 10], [4, 16, 9.5], [10, 10, 14], [10, 10, 14], [np.nan, 1, 2]])
OPEN, FAN = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 2, 1], [0, 2, 3], [0, 2, 4], [2, 0, 4]])
NEEDLE = np.array([[5.0, 5, 9], [5 + 1e-7, 5, 9], [17, 15, 11], [1e3, 3, 9], [-1e3, 9, 9], [12, 1e3, 12]])
TWISTED = np.stack([np.arange(16), (np.arange(16) + 1) % 16, (np.arange(16) + 2) % 16], axis=1)
TURN = np.pi * np.repeat(np.arange(8), 2) / 8
WIDE = np.tile([4.0, 8.0], 8) - 6
BAND = np.stack(
    [(6 + WIDE * np.cos(TURN)) * np.cos(2 * TURN), (6 + WIDE * np.cos(TURN)) * np.sin(2 * TURN), WIDE * np.sin(TURN)], 1
)
FLAWED = {
    "nothing": (np.empty((0, 3)), np.empty((0, 3), int)),
    "no triangle that can be drawn": (SQUARE, np.array([[0, 1, 1], [4, 5, 0], [6, 0, 1]])),
    "not finite, degenerate": (SQUARE, np.concatenate([OPEN, [[0, 1, 6], [2, 2, 2], [4, 5, 1]]])),
    "open": (SQUARE, OPEN),
    "four triangles at an edge, two of them equal": (SQUARE, FAN),
    "not orientable": (BAND + 10, TWISTED),
    "a needle, and one far beyond all others": (NEEDLE, np.array([[0, 1, 2], [3, 4, 5]])),
}


@pytest.mark.cover
@pytest.mark.parametrize("name", FLAWED)
def test_flawed_meshes_are_drawn_as_the_reference_draws_them(name: str) -> None:
    """Lit by normals that triangles share, from outside and from within, in small bricks."""
    entries = ((section(opacity=0.5), Mesh("m", *FLAWED[name])), PLAIN[1])
    for camera in ("outside", "inside"):
        scene = scene_of((), camera, 9)
        right = expected(scene, (), entries)
        assert np.abs(drawn(None, scene, (), entries) - right).max() <= 1e-5
        assert (right[..., 3] > 0.1).any()


@pytest.mark.parametrize("angle", [0.0, 1e-5, 4e-4, 2e-3, 0.1])
def test_nearly_straight_lines_have_one_surface(angle: float) -> None:
    """The inner side of a bend, seen through a window a few times as wide as what two tubes share there."""
    path = np.array([[0, 10, 10], [10, 10, 10], [20, 10 + 10 * angle, 10.0], [30, 10 + 30 * angle, 10]])
    entries = ((LinesSection(path="l", radius=1.0, shade=False, opacity=0.5), Lines("l", path, np.array([0, 4]))),)
    window = 2.1 * max(angle, 1e-4)  # no pixel is where one surface begins, but for rounding
    camera = Camera(position=(10, 40, 10), focal_point=(10, 10, 10), view_up=(0, 0, 1), parallel_scale=window)
    scene = scene_of((), size=(40, 30)).model_copy(update={"camera": camera})
    found = drawn(None, scene, (), entries)
    assert np.abs(found[..., 3] - 0.75).max() <= 1e-6
    assert np.abs(expected(scene, (), entries) - found).max() <= 1e-6


def soup(count: int, size: float, thin: float = 1.0, flat: bool = False) -> Mesh:
    """Triangles of any size anywhere; thin ones are slivers, flat ones lie in planes of the lattice, some edge-on."""
    rng = np.random.default_rng(count)
    corners = rng.uniform(4, 16, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    along = corners[:, 0] + (corners[:, 1] - corners[:, 0]) * rng.random((count, 1))
    corners[:, 2] = along + thin * (corners[:, 2] - along)
    corners[..., ::2] = np.round(corners[..., ::2]) if flat else corners[..., ::2]
    return Mesh("m", corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


# Of any shape; beyond the eye's plane, and far beyond the picture and what rasterisers take.
SOUPS = [
    soup(400, 0.2),
    soup(20, 20.0),
    soup(300, 3.0, 1e-2),
    soup(99, 5.0, 1e-6),
    soup(20, 1e5),
    soup(40, 4.0, 1.0, True),
]
SOUP: tuple[Entry, ...] = tuple((section(shade=False, opacity=0.1), mesh) for mesh in SOUPS)
LOOKS: dict[str, tuple[tuple[Part, ...], tuple[Entry, ...], dict[str, Any]]] = {
    "clipped, culled": ((), (*CULLED, *SOUP), CUT),
    "meshes, tubes, spheres and arrows": ((), (*LIT, *MIXED, *ARROWS), {"lights": LIGHTS}),
    "opaque": ((), WHOLE, {}),
    "opaque in front of others": ((), (*SOUP, *WHOLE, *MIXED), {}),
}


def on_cpu(given: Prepared) -> RenderResult:
    """What a CPU draws of all bricks."""
    return scenes.draw_pieces(None, given, (whole_piece(given),))[0][0]


def rasterised(context: moderngl.Context, given: Prepared) -> RenderResult:
    """What OpenGL draws of all bricks if the rasteriser finds the fragments."""
    caster = opengl_caster(context, given.plan, raster=True)
    caster.load(given.plan, given.shown)
    found = caster.draw(given.plan, (whole_piece(given),))[0]
    caster.release()
    return found


def whole_piece(given: Prepared) -> Piece:
    return Piece(0, BrickBox((0, 0, 0), given.plan.layout.counts_zyx))


@pytest.mark.cover("meshes, tubes, spheres and arrows")
@pytest.mark.gl
@pytest.mark.parametrize("name", LOOKS)
def test_the_rasteriser_finds_the_fragments_of_tile_lists(context: Any, name: str) -> None:
    parts, entries, keys = LOOKS[name]
    caster = None
    for camera in CAMERAS:
        given = prepared(scene_of(parts, camera, **keys), parts, entries)
        right = on_cpu(given)
        caster = caster or opengl_caster(context, given.plan, raster=True)
        caster.drop(given.bricks)
        caster.load(given.plan, given.shown)
        found = caster.draw(given.plan, (whole_piece(given),))[0]
        assert right.fragments.any()
        assert np.array_equal(found.fragments, right.fragments), camera
        assert np.abs(found.partial.rgba - right.partial.rgba).max() <= 4e-6, camera
    assert caster
    caster.release()


@pytest.mark.gl
def test_the_rasteriser_sorts_many_fragments_and_makes_room(context: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than are sorted at once; in one part, and in parts that memory allows."""
    shell = sphere(5.0, (12.1, 10.3, 9.2), 4)
    many = Mesh(
        "m",
        np.tile(shell.vertices, (150, 1)),
        np.concatenate([shell.triangles + n * len(shell.vertices) for n in range(150)]),
    )
    given = prepared(scene_of((), size=(24, 20)), (), ((section(shade=False, opacity=0.005), many),))
    right = on_cpu(given)
    assert right.fragments.max() >= 300
    monkeypatch.setattr(raster, "FIRST_ROOM", 0)
    calls = []
    for most in (fills.MOST_BYTES, 8 * int(right.fragments.sum()) // 2):
        monkeypatch.setattr(fills, "MOST_BYTES", most)
        caster = opengl_caster(context, given.plan, raster=True)
        caster.load(given.plan, given.shown)
        found = caster.draw(given.plan, (whole_piece(given),))[0]
        calls.append(caster.counts.dispatches)
        caster.release()
        assert np.array_equal(found.fragments, right.fragments)
        assert np.abs(found.partial.rgba - right.partial.rgba).max() <= 4e-6
    assert calls[0] == 2 * 3 + 1  # and again, with room
    assert calls[1] > 7


@pytest.mark.gl
def test_a_moving_camera_sends_no_primitives(context: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four calls, and one wait; if there was no room for all fragments, both twice."""
    monkeypatch.setattr(raster, "is_llvmpipe", lambda _: False)  # as on GPUs
    monkeypatch.setattr(raster, "FIRST_ROOM", 1)
    first, second = (prepared(scene_of((), camera), (), (*PLAIN, *MIXED)) for camera in ("outside", "parallel"))
    plan = replace(second.plan, content=first.plan.content)
    piece = whole_piece(first)
    caster, counts = opengl_caster(context, first.plan, raster=True), []
    caster.load(first.plan, first.shown)
    for each in (plan, plan, first.plan):
        before = replace(caster.counts)
        drawn = caster.draw(each, (piece,))[0]
        counts.append(caster.counts.since(before))
    right = on_cpu(first)
    assert np.array_equal(drawn.fragments, right.fragments)
    assert np.abs(drawn.partial.rgba - right.partial.rgba).max() <= 4e-6
    assert np.array_equal(drawn.work, right.work)
    assert counts[0].uploaded > 10_000
    assert [(one.dispatches, one.waits) for one in counts] == [(8, 4), (4, 1), (4, 1)]
    assert counts[1].made == counts[2].made == 0
    assert max(counts[1].uploaded, counts[2].uploaded) < 2000  # the camera's numbers, and the block of the frame
    caster.release()


@pytest.mark.gl
def test_the_device_and_the_schemes_choose_between_the_rasteriser_and_tile_lists(
    context: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, rect = prepared(scene_of(()), (), PLAIN), Rect(0, 0, 40, 30)
    discarding = prepared(scene_of((), quality={"early_discarding": 0.0}), (), PLAIN).plan
    wide = replace(rect, x_end=1 << 20)
    chosen = raster.Rasteriser(Device(context), True)
    asked = [
        (given.plan, rect),
        (by_schemes(given, "pages", "static").plan, rect),
        (by_schemes(given, "dynamic", "peeling").plan, rect),
        (discarding, rect),
        (given.plan, wide),
    ]
    assert [chosen.serves(*one) for one in asked] == [True, False, False, False, False]
    assert not raster.Rasteriser(Device(context), False).serves(given.plan, rect)
    for ends, blocks, found in ((True, 16, False), (False, 16, True), (False, 0, False)):
        monkeypatch.setattr(raster, "is_llvmpipe", lambda _, ends=ends: ends)
        monkeypatch.setitem(context.info, "GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS", blocks)
        assert raster.has_rasteriser(context) == found
