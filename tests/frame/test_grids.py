"""Unstructured grids in scenes: unset keys are filled, objects in memory are taken, and what is wrong is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from data.cells import lattice, mixed
from data.grid_writers import pvtu, vtu
from frame.views import check_same, moving, on_ranks, pixels, so_far

import clusterviz
from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.content.diff import check_same_volume
from clusterviz.content.grid.section import GridSection, KBuffer
from clusterviz.content.summary import scene_summary
from clusterviz.content.visibility import visibility_warnings
from clusterviz.data import open_scene, read_piece
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vtk_cells import as_grid
from clusterviz.errors import ClustervizError, SceneError
from clusterviz.frame.opening import open_content
from clusterviz.frame.run import Options, Run
from clusterviz.scene.files import dump_scene, load_scene
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, ImageSettings, Scene

BOX = lattice(2, 3, 4, spacing=0.5)


def opened(grid: UnstructuredGrid, **keys: Any) -> tuple[Scene, Any]:
    scene = Scene(grids=(GridSection(path="g.vtu", **keys),))
    scene, found, _ = open_content(Run(LoopbackChannel(), Options()), scene, [grid])
    assert found is not None
    return scene, found


def test_unset_keys_are_filled_from_the_grid() -> None:
    section = opened(BOX)[0].grids[0]
    high = float(BOX.point_arrays["f"].max())
    assert (section.clim, section.opacity_unit_distance) == ((0.0, high), pytest.approx(0.5))
    assert section.opacity == ((0.0, 0.0), (pytest.approx(0.3 * high), 0.0), (pytest.approx(high), 0.9))
    doubled = np.diag([2.0, 2.0, 2.0, 1.0]).tolist()
    assert opened(BOX, transform=doubled)[0].grids[0].opacity_unit_distance == pytest.approx(1.0)
    given = {"clim": (1.0, 2.0), "opacity": 0.5, "opacity_unit_distance": 3.0}
    scene = opened(BOX, **given)[0]
    assert {name: getattr(scene.grids[0], name) for name in given} == given
    assert scene_summary(scene).startswith("grids[0] clim 1 to 2 (viridis), opacity 0.5; camera")
    assert opened(mixed(), array="kind")[0].grids[0].clim == (4.0, 8.0)


def damaged(**changes: Any) -> UnstructuredGrid:
    values = {"points": BOX.points.copy(), "f": BOX.point_arrays["f"].copy()}
    for name, value in changes.items():
        values[name][0] = value
    return UnstructuredGrid("g", values["points"], BOX.cells, {"f": values["f"]})


def twice(grid: UnstructuredGrid) -> UnstructuredGrid:
    """All cells, and some of them again."""
    cells = {kind: np.concatenate([corners, corners[:2]]) for kind, corners in grid.cells.items()}
    return UnstructuredGrid("g", grid.points, cells, grid.point_arrays)


@pytest.mark.parametrize(
    ("grid", "keys", "texts"),
    [
        (BOX, {"opacity": 0.5}, []),
        (damaged(f=np.nan), {"opacity": 0.5}, ["grids[0] (g.vtu): ", " of 24 cells are left out"]),
        (damaged(points=np.inf), {"opacity": 0.5}, [" of 24 cells are left out: a corner or value is not finite"]),
        (BOX, {"opacity": 0.0}, ["grids[0] (g.vtu): opacity is 0 all over the data's range 0 to ", "nothing is drawn"]),
        (BOX, {"clim": (90, 91)}, ["grids[0] (g.vtu): clim 90 to 91 lies beyond the data's range 0 to "]),
        (UnstructuredGrid("g", np.zeros((4, 3)), {"tetra": np.arange(4)[None]}, {"f": np.ones(4)}), {}, ["1 of 1"]),
        (twice(BOX), {"opacity": 0.5}, ["grids[0] (g.vtu): cells overlap others"]),
        (UnstructuredGrid("g", np.zeros((0, 3)), {}, {"f": np.ones(0)}), {}, ["grids[0] (g.vtu): nothing is drawn"]),
    ],
)
def test_what_is_not_visible_is_said(grid: UnstructuredGrid, keys: dict[str, Any], texts: list[str]) -> None:
    scene, found = opened(grid, **keys)
    cost = found.plan(scene).cost.sum()
    said = "\n".join(visibility_warnings(scene, found.infos, is_blank=False).values())
    assert bool(said) == bool(texts)
    assert all(text in said for text in texts), said
    assert (cost > 0) == (not texts or " of 24" in said or "overlap" in said)


def pyvista_like() -> SimpleNamespace:
    cells = [row for corners in mixed().cells.values() for row in corners]
    offset = np.cumsum([0, *map(len, cells)])
    data = {"point_data": mixed().point_arrays, "cell_data": mixed().cell_arrays}
    types = np.array([12, 13, 14, 10])
    rows = [[4, 5, 6, 8].index(len(cell)) for cell in cells]
    types = np.array([10, 14, 13, 12])[rows]
    return SimpleNamespace(
        points=mixed().points, celltypes=types, offset=offset, cell_connectivity=np.concatenate(cells), **data
    )


def meshio_like() -> SimpleNamespace:
    blocks = [SimpleNamespace(type=kind, data=corners) for kind, corners in mixed().cells.items()]
    of_cells = {"kind": np.split(mixed().cell_arrays["kind"], 4)}
    return SimpleNamespace(points=mixed().points, cells=blocks, point_data=mixed().point_arrays, cell_data=of_cells)


@pytest.mark.parametrize("make", [mixed, pyvista_like, meshio_like])
def test_grids_of_other_libraries_are_taken(make: Callable[[], Any]) -> None:
    found = as_grid(make(), "grids[0]")
    for kind, corners in mixed().cells.items():
        np.testing.assert_array_equal(found.cells[kind], corners)
    np.testing.assert_array_equal(found.points, mixed().points)
    np.testing.assert_array_equal(found.point_arrays["f"], mixed().point_arrays["f"])
    np.testing.assert_array_equal(found.cell_arrays["kind"], mixed().cell_arrays["kind"])


def test_arrays_are_points_tetrahedra_and_scalars() -> None:
    points, cells = np.eye(4, 3), np.arange(4)[None]
    assert not as_grid((points, cells, np.ones(4)), "g").array(None)[1]
    assert as_grid((points, cells, np.ones(1)), "g").array(None)[1]
    with pytest.raises(ClustervizError, match="g: not an unstructured grid; found int; allowed points, tetrahedra"):
        as_grid(3, "g")
    with pytest.raises(ClustervizError, match="out of range"):
        as_grid((points, cells + 1, np.ones(4)), "g")


def test_a_file_is_a_scene_and_scenes_are_read_back(tmp_path: Path) -> None:
    scene = open_scene(vtu(tmp_path / "a.vtu"), ["array=f", "visibility={k: 6}", "time=0.5"])
    assert scene.grids[0].path == str(tmp_path / "a.vtu")
    assert not scene.volumes
    (tmp_path / "a.yaml").write_text(dump_scene(scene))
    assert load_scene(tmp_path / "a.yaml") == scene


def test_frames_may_differ_in_colours_and_opacity_only() -> None:
    first = Scene(grids=(GridSection(path="a"),))
    check_same_volume(first, Scene(grids=(GridSection(path="a", opacity=0.3, cmap="hot"),)))
    with pytest.raises(SceneError, match=r"grids\[0\].array: was null, is \"T\".*or cmap, clim, .* of grids"):
        check_same_volume(first, Scene(grids=(GridSection(path="a", array="T"),)))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"array": "kind", "shade": True},
            r"\.shade: values of cells have no gradient to light; found true, and values of cells; allowed false, or "
            "values of points",
        ),
        (
            {"visibility": {"k": 6}},
            r"\.visibility: a k-buffer draws one unstructured grid, and nothing else; found {k: 6} and grids\[1\]; "
            "allowed exact",
        ),
    ],
)
def test_what_is_not_drawn_is_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=r"grids\[0\]" + message):
        clusterviz.render(Scene(), grids=[{"path": mixed(), "array": "f", **keys}, {"path": BOX}])


def test_objects_are_drawn_as_files_are(tmp_path: Path) -> None:
    """Their pictures are compared with the reference in tests/render/test_cells.py."""
    camera = {"position": (9.0, 7.0, 5.0), "focal_point": (1.0, 0.5, 1.0)}
    scenes: list[tuple[Any, dict[str, Any]]] = [
        (str(vtu(tmp_path / "a.vtu")), {"array": "f", "opacity": 0.6}),
        (pyvista_like(), {"array": "f", "opacity": 0.6}),
        (Scene(), {"grids": [{"path": meshio_like(), "array": "f", "opacity": 0.6}]}),
    ]
    first, *others = (
        np.asarray(clusterviz.render(given, size=(24, 18), camera=camera, step=1.0, background="black", **keys))
        for given, keys in scenes
    )
    assert first[..., 3].max() > 0.5
    for other in others:
        np.testing.assert_allclose(other, first, atol=1e-5)


def drawn_scene(**keys: Any) -> tuple[Scene, list[UnstructuredGrid]]:
    """Two grids whose fields are linear, of which one is mirrored into the other."""
    mirror = ((-1.0, 0.0, 0.0, 3.0), (0.0, 1.0, 0.0, 0.5), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    sections = GridSection(path="a", opacity=0.3), GridSection(path="b", array="f", cmap="hot", transform=mirror)
    camera = Camera(position=(9.0, 7.0, 6.0), focal_point=(1.0, 0.8, 0.7), view_up=(0, 0, 1))
    scene = Scene(grids=sections, camera=camera, image=ImageSettings(size=(30, 24)))
    return with_settings(scene, keys) if keys else scene, [BOX, mixed()]


WAYS: list[tuple[int, dict[str, Any]]] = [
    (2, {"brick": 80, "distribution": "interleaved"}),
    (3, {"brick": 64}),
    (2, {"brick": 100, "distribution": "replicated"}),
    (3, {"brick": 64, "mode": "sort-first"}),
    (5, {"brick": 100, "mode": "hybrid", "groups": 2}),
    (7, {"brick": 600}),  # more ranks than bricks
]


def test_pictures_are_the_same_on_any_ranks() -> None:
    """And so is the sum of their segments, where bricks are."""
    scene, given = drawn_scene()
    alone = {
        brick: on_ranks(1, [with_settings(scene, {"brick": brick})], given, device="cpu")
        for brick in {keys["brick"] for _, keys in WAYS}
    }
    for ranks, keys in WAYS:
        found = on_ranks(ranks, [with_settings(scene, keys)], given, device="cpu")
        check_same(found, alone[keys["brick"]], 1e-6)
        check_same(found, alone[600], 4e-6)
        counts = [sum(one.samples for one in each[0].statistics.per_rank) for each in (found, alone[keys["brick"]])]
        assert counts[0] == counts[1] > 400, keys
        assert pixels(found[0])[..., 3].max() > 0.5


def test_pieces_are_drawn_on_any_ranks_as_the_joined_file_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each piece is read by one rank, and points that pieces share are numbered as those of one file."""
    whole, pieces, read = vtu(tmp_path / "whole.vtu"), pvtu(tmp_path / "a.pvtu"), list[str]()
    recorded = lambda file: read.append(file.path.name) or read_piece(file)  # noqa: E731
    monkeypatch.setattr("clusterviz.content.grid.kind.read_piece", recorded)
    camera = Camera(position=(9.0, 7.0, 6.0), focal_point=(1.0, 0.8, 0.7), view_up=(0, 0, 1))
    for array in ("f", "kind"):
        section = GridSection(path=str(whole), array=array, opacity=0.6, opacity_unit_distance=1.0, clim=(0, 9))
        scene = Scene(grids=(section,), camera=camera, image=ImageSettings(size=(24, 20)))
        scene = with_settings(scene, {"brick": 100})
        alone, counts = on_ranks(1, [scene], device="cpu"), in_bricks(1, scene)
        assert pixels(alone[0])[..., 3].max() > 0.5
        assert counts.shape != (2, 1, 1, 1)
        for ranks, path in ((1, pieces), (2, pieces), (3, pieces), (3, whole), (2, tmp_path / "a_*.vtu")):
            scene = with_settings(scene, {"grids.0.path": str(path)})
            check_same(on_ranks(ranks, [scene], device="cpu"), alone, 1e-6)
            read.clear()
            np.testing.assert_array_equal(in_bricks(ranks, scene), counts)
            assert sorted(read) == (["whole.vtu"] * ranks if path == whole else ["a_0.vtu", "a_1.vtu"])


def in_bricks(ranks: int, scene: Scene) -> np.ndarray:
    """Return the tetrahedra and points of each brick."""

    def plan(channel: Channel) -> np.ndarray:
        completed, found, _ = open_content(Run(channel, Options()), scene)
        assert found is not None
        content = found.plan(completed).content
        assert content is not None
        return content.cells[0].in_bricks

    return run_loopback(ranks, plan)[0]


OTHER_PIECES: list[tuple[str, bytes, bytes, str]] = [
    ("f", b"", b"", "a_1.vtu: no such file"),
    ("f", b'Name="f"', b'Name="g"', "a_1.vtu: no such array; found f; allowed g, kind"),
    (
        "f",
        b'Float32" Name="f"',
        b'Float64" Name="f"',
        "a_1.vtu: a piece is unlike the others; found f of points, float64",
    ),
    (
        "f",
        b'Float32" Name=""',
        b'Float64" Name=""',
        "points float64; allowed f of points, float32, points float32, as in",
    ),
    ("kind", b'Name="f"', b'Name="kind"', "found kind of points, float32, .*; allowed kind of cells, float64"),
    ("f", b'Name="types"', b'Name="kinds"', "a_1.vtu: Cells lack an array"),
]


@pytest.mark.parametrize("ranks", [1, 2, 3])
@pytest.mark.parametrize(("array", "old", "new", "message"), OTHER_PIECES)
def test_a_piece_that_does_not_fit_is_named(
    array: str, old: bytes, new: bytes, message: str, ranks: int, tmp_path: Path
) -> None:
    scene, piece = Scene(grids=(GridSection(path=str(pvtu(tmp_path / "a.pvtu")), array=array),)), tmp_path / "a_1.vtu"
    if old:
        assert old in piece.read_bytes()
        piece.write_bytes(piece.read_bytes().replace(old, new))
    else:
        piece.unlink()
    with pytest.raises(ClustervizError, match=message):
        run_loopback(ranks, lambda channel: open_content(Run(channel, Options()), scene))


def test_k_buffers_draw_the_same_on_any_ranks_and_tell_of_wrong_pixels() -> None:
    moved = BOX.points * [1, 1, 6] + np.random.default_rng(2).uniform(-0.1, 0.1, BOX.points.shape)
    grid = UnstructuredGrid("g", moved, BOX.cells, BOX.point_arrays)
    section = GridSection(path="g", opacity=0.4, visibility=KBuffer(k=16))
    camera = Camera(position=(20.0, 16.0, 12.0), focal_point=(0.5, 0.7, 6.0), view_up=(0, 0, 1))
    scene = Scene(grids=(section,), camera=camera, image=ImageSettings(size=(30, 24)))
    alone = on_ranks(1, [scene], [grid], device="cpu")
    assert pixels(alone[0])[..., 3].max() > 0.5
    for ranks, keys in [WAYS[0], WAYS[1]]:
        check_same(on_ranks(ranks, [with_settings(scene, keys)], [grid], device="cpu"), alone, 1e-5)
    with pytest.warns(
        UserWarning, match=r"grids\[0\].visibility: \d+ pixels with segments out of order; use a larger k"
    ):
        (small,) = on_ranks(1, [with_settings(scene, {"grids.0.visibility": {"k": 2}})], [grid], device="cpu")
    assert small.statistics.as_json()["kbuffer"]["wrong_pixels"] > 1
    assert alone[0].statistics.as_json()["kbuffer"]["wrong_pixels"] == 0


def test_tetrahedra_migrate_and_are_read_when_they_become_visible() -> None:
    scene, given = drawn_scene(brick=128)
    around = [(9, 7, 6), (-6, 4, 3), (2, 9, 2), (9, 7, -6), (4, -9, 6)]
    changes: list[dict[str, Any]] = [{"position": place} for place in around]
    changes += [
        {"grids.0.opacity": [[4, 0], [8, 0.9]]},
        {"grids.0.opacity": [[2, 0.5], [8, 0.9]], "grids.1.cmap": "bone"},
    ]
    scenes = [with_settings(scene, change) for change in changes]
    frames = on_ranks(3, moving(scenes), given, device="cpu")
    check_same(frames, [on_ranks(1, [scene], given, device="cpu")[0] for scene in scenes])
    assert so_far(frames, "bricks_received") > 0
