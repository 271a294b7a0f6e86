"""clusterviz from Python: what the front door offers, alone and under mpirun, and what it does not import."""

from __future__ import annotations

import io
import pickle
import pydoc
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image as Pillow

import clusterviz
from clusterviz.comm import LoopbackChannel
from clusterviz.data.geometry import Lines, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.vectors import VectorArray
from clusterviz.errors import DataError, InputError, OutputError, SceneError
from clusterviz.frame import render_frame
from clusterviz.image.finish import finish
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.validation_messages import KEY_PATHS

ROOT = Path(__file__).parents[1]
VOXELS = np.random.default_rng(0).random((12, 13, 14), np.float32)
SMALL: dict[str, Any] = {"size": (24, 18), "brick": 8}


def test_every_name_is_there_and_they_are_few() -> None:
    assert len(clusterviz.__all__) <= 12
    for name in clusterviz.__all__:
        assert name in dir(clusterviz)
        assert getattr(clusterviz, name) is not None
    assert {name for name in dir(clusterviz) if not name.startswith("_")} <= set(clusterviz.__all__)
    assert clusterviz.__version__ == version("clusterviz")
    assert (Path(clusterviz.__file__).parent / "py.typed").is_file()
    with pytest.raises(AttributeError, match="nonsense"):
        clusterviz.nonsense  # noqa: B018


def test_the_import_is_light_and_starts_no_mpi() -> None:
    script = """
import sys
import clusterviz
heavy = {"numpy", "numba", "mpi4py", "moderngl", "pydantic", "rich", "typer"} & set(sys.modules)
image = clusterviz.render("field:gaussian:8", size=(4, 3), opacity=0)
sys.exit(f"{heavy} {image.shape}" if heavy or image.shape != (3, 4, 4) or "mpi4py.MPI" in sys.modules else 0)
"""
    # Nothing is seen where opacity is 0, of which a warning tells.
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_function_is_not_replaced_by_the_room_of_its_name() -> None:
    script = "import clusterviz.render.caster, clusterviz.frame; assert clusterviz.render.__name__ == 'render'"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


@pytest.mark.gl
def test_an_array_a_source_a_file_and_a_scene_give_the_same_picture(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", VOXELS)
    (tmp_path / "scene.yaml").write_text("volumes: [{path: a.npy}]\n")
    scene = clusterviz.load_scene(tmp_path / "scene.yaml")
    given = (VOXELS, ArraySource(VOXELS), str(tmp_path / "a.npy"), tmp_path / "a.npy", tmp_path / "scene.yaml", scene)
    pictures = [clusterviz.render(each, **SMALL, automatic=True) for each in given]
    for picture in pictures:
        assert picture is not None
        assert (picture.dtype, picture.shape) == (np.float32, (18, 24, 4))
        assert picture.max() > 0
        assert np.array_equal(picture, pictures[0])


@pytest.mark.gl
def test_spacing_origin_and_direction_place_an_array_as_a_grid_does() -> None:
    turned = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    grid = clusterviz.Grid(VOXELS.shape, (1.0, 2.0, 3.0), (5.0, 6.0, 7.0), turned)
    keys: dict[str, Any] = {"spacing": grid.spacing, "origin": grid.origin, "direction": np.array(turned)}
    view = {**SMALL, "position": (60.0, 50.0, 70.0), "focal_point": (0.0, 10.0, 25.0)}
    expected = clusterviz.render(VOXELS, grid=grid, **view)
    assert expected is not None
    assert expected.max() > 0
    assert not np.array_equal(clusterviz.render(VOXELS, **view), expected)
    np.testing.assert_array_equal(clusterviz.render(VOXELS, **keys, **view), expected)
    np.testing.assert_array_equal(
        clusterviz.render(VOXELS, grid=clusterviz.Grid(VOXELS.shape), **keys, **view), expected
    )


def test_only_files_have_time_steps_and_channels() -> None:
    for key in ({"time": 0}, {"channel": "red"}):
        with pytest.raises(InputError, match="only files have time steps and channels"):
            clusterviz.render(VOXELS, **key)


@pytest.mark.gl
def test_several_arrays_are_several_volumes() -> None:
    small, grid = VOXELS[:9, :8, :7], clusterviz.Grid((9, 8, 7), origin=(2.0, 3.0, 1.0))
    keys = {"volumes.1.cmap": "hot", "volumes.0.opacity": 0.1}
    found = clusterviz.render([VOXELS, ArraySource(small, grid)], size=(20, 16), **keys)
    placed = clusterviz.render([VOXELS, small], grid=[None, grid], size=(20, 16), **keys)
    alone = clusterviz.render(VOXELS, size=(20, 16), opacity=0.1)
    assert found is not None
    assert placed is not None
    assert alone is not None
    assert np.array_equal(found, placed)
    assert np.abs(found - alone).max() > 0.01
    with pytest.raises(InputError, match="a list of other things"):
        clusterviz.render([VOXELS, "a.npy"])
    with pytest.raises(InputError, match="grid: not one for each volume; found 1; allowed 2"):
        clusterviz.render([VOXELS, small], grid=[grid])


@pytest.mark.gl
def test_settings_are_keys_of_the_scene() -> None:
    scene = clusterviz.Scene(volumes=(clusterviz.Volume(path="field:gaussian:8"),))
    settings = {**SMALL, "cmap": "viridis", "clim": np.array([0.1, 0.9]), "opacity": 0.2, "step": np.float32(0.5)}
    changed = with_settings(scene, settings)
    assert (changed.volumes[0].clim, changed.quality.step, changed.image.size) == ((0.1, 0.9), 0.5, (24, 18))
    picture = clusterviz.render(scene, **settings)
    assert picture is not None
    assert np.array_equal(picture, render_frame(changed, LoopbackChannel()).image)  # type: ignore[arg-type]


@pytest.mark.gl
def test_a_notebook_shows_a_scene_as_its_picture() -> None:
    scene = with_settings(clusterviz.Scene(volumes=(clusterviz.Volume(path="field:gaussian:8"),)), SMALL)
    image = clusterviz.render(scene)
    assert image is not None
    assert image.max() > 0
    assert scene._repr_png_() == image._repr_png_()


def test_a_picture_is_an_array_that_shows_and_saves_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = clusterviz.render("field:gaussian:8", size=(6, 4), opacity=0.5, background=(1.0, 0.0, 0.0))
    assert image is not None
    pixels = np.asarray(image)
    assert (type(pixels), pixels.dtype, image.shape) == (np.ndarray, np.float32, (4, 6, 4))
    assert (pixels[..., :3].max(axis=-1) <= pixels[..., 3] + 1e-6).all()  # premultiplied
    crop = image[1:3, 2:5]
    assert isinstance(crop, clusterviz.Image)
    assert crop.background == (1.0, 0.0, 0.0)
    for plain in (image[..., 3], image[0], image * 2, image + image):
        assert type(plain) is np.ndarray
    assert isinstance(image.max(), np.float32)
    for again in (pickle.loads(pickle.dumps(image)), image.copy()):
        assert again.background == image.background
        assert np.array_equal(again, image)

    seen: list[Any] = []
    monkeypatch.setattr("PIL.ImageShow.show", lambda picture: seen.append(np.asarray(picture)) or True)
    image.show()
    image.save(tmp_path / "a.png")
    clusterviz.write_image(tmp_path / "b.png", image, (1.0, 0.0, 0.0))
    png = image._repr_png_()
    assert png is not None
    expected = finish(pixels, (1.0, 0.0, 0.0))
    for file in (tmp_path / "a.png", tmp_path / "b.png", io.BytesIO(png)):
        with Pillow.open(file) as opened:
            seen.append(np.asarray(opened))
    assert len(seen) == 4
    assert all(np.array_equal(each, expected) for each in seen)

    monkeypatch.setattr("PIL.ImageShow.show", lambda _: False)
    with pytest.raises(OutputError, match="no program shows pictures"):
        image.show()


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: clusterviz.Camera(positon=(1, 2, 3)), "Camera: positon: unknown key, did you mean position?"),
        (lambda: clusterviz.Camera(position=(1, 2)), "Camera: position: too few values; found [1, 2]"),
        (lambda: clusterviz.Volume(), "Volume: path: missing"),
        (lambda: clusterviz.Scene(camera={"positon": 1}), "Scene: camera.positon: unknown key, did you mean position?"),
        (lambda: clusterviz.Scene(volumes=[{"path": "a", "clim": 1}]), "Scene: volumes[0].clim: not a list"),
    ],
)
def test_a_wrong_section_is_an_error_of_ours(make: Callable[[], object], text: str) -> None:
    with pytest.raises(SceneError, match=re.escape(text)):
        make()


@pytest.mark.parametrize("kind", [clusterviz.Volume, clusterviz.Camera, clusterviz.Scene])
def test_the_help_of_a_section_lists_its_keys_on_two_screens(kind: Any) -> None:
    text = pydoc.render_doc(kind, renderer=pydoc.plaintext)
    lines = text.splitlines()
    assert sum(1 + len(line) // 120 for line in lines) <= 100
    assert all(f" {name} : " in text for name in kind.model_fields)
    assert "model_validate" not in text


@pytest.mark.gl
def test_a_mesh_in_memory_is_drawn_in_whatever_form_it_comes() -> None:
    vertices = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [4, 4, 1.0]])
    faces = np.array([[0, 1, 3], [0, 3, 2]])
    forms: list[Any] = [
        (vertices, faces),
        SimpleNamespace(vertices=vertices, faces=faces),  # as trimesh
        SimpleNamespace(points=vertices, faces=np.array([4, 0, 1, 3, 2]), point_data={}, cell_data={}),  # as pyvista
    ]
    sheet = {"color": "red", "opacity": 0.5, "shade": False}
    for form in forms:
        found = clusterviz.render(clusterviz.Scene(), meshes=[{"path": form, **sheet}], size=(20, 16))
        assert found is not None
        assert set(np.unique(found[..., 3]).tolist()) == {0.0, 0.5}
        np.testing.assert_array_equal(found[..., 0], found[..., 3])
    no_cells: dict[str, Any] = {"points": 1.0 * vertices, "faces": [], "point_data": {}, "cell_data": {}}
    for more in ({"lines": np.array([4, 0, 1, 3, 2])}, {"lines": []}, {}):  # lines, or points, of pyvista
        found = clusterviz.render(SimpleNamespace(**no_cells, **more), size=(20, 16), radius=0.3)
        assert found is not None
        assert 0.02 < (found[..., 3] > 0).mean() < 0.6
    volume = np.ones((4, 4, 4), np.float32)
    both = clusterviz.render(volume, meshes=[*forms, (vertices + 1, faces)], opacity=0.1, size=(20, 16))
    assert both is not None
    assert both[..., 3].max() == 1
    with pytest.raises(DataError, match=r"meshes\[1\]: not geometry; found int"):
        clusterviz.render(clusterviz.Scene(), meshes=[forms[0], {"path": 3}])


CORNERS = np.array([[0, 0, 0], [4.0, 0, 0], [0, 4, 0], [0, 0, 4]])
SWIRL = np.stack(np.meshgrid(*[np.linspace(-1, 1, 6)] * 3, indexing="ij"), axis=-1)
ALONE: list[tuple[str, Any, Any, dict[str, Any]]] = [
    ("meshes", (CORNERS, np.array([[0, 1, 2], [0, 2, 3]])), None, {}),
    ("grids", (CORNERS, np.array([[0, 1, 2, 3]]), np.arange(4.0)), None, {}),
    ("points", CORNERS, Points("array", CORNERS), {"radius": 0.4}),
    ("lines", [CORNERS], Lines("array", CORNERS, np.array([0, 4])), {"radius": 0.4}),
    ("flows", [SWIRL], VectorArray(SWIRL), {}),
]


@pytest.mark.gl
@pytest.mark.parametrize(("section", "content", "alone", "keys"), ALONE, ids=[section for section, *_ in ALONE])
def test_content_of_any_kind_is_drawn_without_a_scene(
    section: str, content: Any, alone: Any, keys: dict[str, Any]
) -> None:
    found = clusterviz.render(**{section: content}, **keys, size=(20, 16))
    assert found is not None
    assert found[..., 3].max() > 0.1
    np.testing.assert_array_equal(clusterviz.render(content if alone is None else alone, **keys, size=(20, 16)), found)


@pytest.mark.gl
def test_a_tuple_of_volumes_is_no_mesh() -> None:
    pair = np.ones((3, 4, 3)), np.ones((2, 5, 3), int)
    found, expected = (clusterviz.render(each, size=(20, 16), opacity=0.1) for each in (pair, list(pair)))
    assert found is not None
    assert found[..., 3].max() > 0
    np.testing.assert_array_equal(found, expected)


@pytest.mark.gl
def test_the_example_of_a_flow_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["flow.py", str(tmp_path / "a.png")])
    runpy.run_path(str(ROOT / "examples" / "flow.py"))
    with Pillow.open(tmp_path / "a.png") as picture:
        assert picture.size == (640, 480)
        assert np.asarray(picture).std(axis=(0, 1)).min() > 20


def test_what_is_generated_of_scene_keys_is_current() -> None:
    """Types for checkers, and the page for readers."""
    made = runpy.run_path(str(ROOT / "docs" / "make_scene_keys.py"))
    for path, text in ((made["MODULE"], made["settings_text"]()), (made["PAGE"], made["page_text"]())):
        assert path.read_text(encoding="utf-8") == text, "run python docs/make_scene_keys.py"


@pytest.mark.fresh
def test_a_type_checker_finds_a_wrong_setting(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(
        "import clusterviz\n"
        "image = clusterviz.render('a.npy', size=(8, 6), clim=[0, 1], camera=clusterviz.Camera(view_angle=20.0))\n"
        "if image is not None:\n    image.save('a.png')\n    print(image.shape, clusterviz.__version__)\n"
        "clusterviz.render('a.npy', sizee=(8, 6))\n"
        "clusterviz.render('a.npy', step='fine')\n"
        "clusterviz.render('a.npy', blending='maximun')\n"
    )
    command = [sys.executable, "-m", "mypy", "--strict", str(tmp_path / "a.py")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    found = [line.split(": ", 2)[0].rpartition(":")[2] for line in done.stdout.splitlines() if ": error: " in line]
    assert found == ["6", "7", "8"], done.stdout


SECTIONS_OF_KEYS = ("volumes", "camera", "clip", "image", "quality", "cluster")


def test_settings_lead_to_every_key_by_one_name() -> None:
    names = [name for section in SECTIONS_OF_KEYS for name in _fields(section)]
    assert sorted(names) == sorted(KEY_PATHS)


def _fields(section: str) -> list[str]:
    kind = {"volumes": "Volume", "image": "ImageSettings"}.get(section, section.capitalize())
    return list(getattr(sys.modules["clusterviz.scene.values"], kind).model_fields)


@pytest.mark.parametrize(
    ("scene", "settings", "error", "text"),
    [
        ("field:gaussian:8", {"stepp": 1}, SceneError, "stepp=1: unknown key, did you mean quality.step?"),
        ("field:gaussian:8", {"step": -1}, SceneError, "step=-1: quality.step: too small"),
        ("none.npy", {}, DataError, "none.npy: no such file"),
        (np.zeros((2, 2, 2, 2)), {}, DataError, "array"),
        (7, {}, InputError, "nothing to render; found int"),
        (None, {"size": (4, 3)}, InputError, "nothing to render; found NoneType"),
        ("field:gaussian:8", {"grid": object()}, InputError, "only an array takes a grid"),
    ],
)
def test_what_is_wrong_is_raised(scene: Any, settings: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=re.escape(text)):
        clusterviz.render(scene, **settings)


@pytest.mark.gl
@pytest.mark.mpi(ranks=[3], timeout=120)
def test_render_is_collective_under_mpirun(mpi_ranks: int) -> None:
    from mpi4py import MPI

    alone = render_frame(
        with_settings(clusterviz.Scene(volumes=(clusterviz.Volume(path="array"),), automatic=True), SMALL),
        LoopbackChannel(),
        ArraySource(VOXELS),
    ).image
    half = MPI.COMM_WORLD.Split(MPI.COMM_WORLD.rank // 2)
    for comm, rank in ((None, MPI.COMM_WORLD.rank), (MPI.COMM_WORLD, MPI.COMM_WORLD.rank), (half, half.rank)):
        picture = clusterviz.render(VOXELS, comm=comm, **SMALL)
        assert (picture is None) == (rank != 0)
        if picture is not None:
            assert clusterviz.compare(picture, alone, 1e-5).count == 0
    with pytest.raises(DataError):
        clusterviz.render("none.npy")
