"""Overrides: keys, precedence, and errors that name the option."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from clusterviz.errors import SceneError
from clusterviz.scene import Camera, Scene, load_scene, parse_overrides, scene_of_data
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Light


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "scene.yaml"
    file.write_text("volumes: [{path: a.npy, clim: [1, 2]}]\ncamera:\n")
    return file


def loaded(path: Path, *options: str) -> Scene:
    return load_scene(path, options)


def test_values_are_yaml(path: Path) -> None:
    assert loaded(path, "quality.step=1e-1").quality.step == 0.1
    assert loaded(path, "volumes.0.clim=[20, 200]").volumes[0].clim == (20, 200)
    assert loaded(path, "volumes[0].clim=[20, 200]").volumes[0].clim == (20, 200)
    assert loaded(path, "volumes.0.clim=null").volumes[0].clim is None
    assert loaded(path, "volumes.0.clim=").volumes[0].clim is None
    assert loaded(path, "volumes.0.clim.1=7").volumes[0].clim == (1, 7)
    assert loaded(path, "quality={step: 3}").quality.step == 3
    assert loaded(path, "volumes=[]").volumes == ()
    assert loaded(path, "image.background=#ff0000").image.background == "#ff0000"  # no comment
    assert loaded(path, "camera.view_angle=40").camera.view_angle == 40  # the file lacks the section
    assert loaded(path, "quality.step=1", "quality.step=2").quality.step == 2
    assert loaded(path, "quality.step=3", "quality={step: 4}").quality.step == 4
    assert scene_of_data(path.with_name("a.npy"), ["quality.step=2"]).quality.step == 2


LIGHT = "lights=[{position: [1, 2, 3]}]"


@pytest.mark.parametrize(
    ("options", "whole"),
    [
        (["cmap=bone"], "volumes.0.cmap=bone"),
        (["clim=[3, 4]", "clim.1=5"], "volumes.0.clim=[3, 5]"),
        (["clim[0]=0"], "volumes.0.clim=[0, 2]"),
        (["position=[0, 0, 5]"], "camera.position=[0, 0, 5]"),
        (["size=[4, 3]"], "image.size=[4, 3]"),
        ([LIGHT, "intensity=2"], "lights=[{position: [1, 2, 3], intensity: 2}]"),
    ],
)
def test_a_last_name_is_its_key_and_the_same_in_python(path: Path, options: list[str], whole: str) -> None:
    assert loaded(path, *options) == loaded(path, whole)
    settings = {override.option.partition("=")[0][3:]: override.value for override in parse_overrides(options)}
    assert with_settings(loaded(path), settings) == loaded(path, whole)


def test_a_name_of_several_keys_is_an_error_that_lists_them(path: Path) -> None:
    message = (
        "position=[1, 0, 0]: several keys have this name; found position; allowed camera.position, lights[0].position"
    )
    with pytest.raises(SceneError, match=re.escape(f"-D {message}")):
        loaded(path, LIGHT, "position=[1, 0, 0]")
    with pytest.raises(SceneError, match=re.escape(message)):
        with_settings(loaded(path, LIGHT), {"position": (1, 0, 0)})


def test_whole_sections_can_be_set(path: Path) -> None:
    for camera in ({"position": (1, 2, 3)}, Camera(position=(1, 2, 3))):
        assert with_settings(loaded(path), {"camera": camera}) == loaded(path, "camera.position=[1, 2, 3]")
    with pytest.raises(SceneError, match=r"camera\.positon: unknown key, did you mean position"):
        with_settings(loaded(path), {"camera": {"positon": (1, 2, 3)}})
    assert with_settings(loaded(path), {"lights": [Light(position=(1, 2, 3))]}) == loaded(path, LIGHT)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("quality.stpe=1", "-D quality.stpe=1: unknown key, did you mean step?; found stpe; allowed step"),
        ("qualty.step=1", "did you mean quality?"),
        ("quality.step.more=1", "unknown key; found more"),
        ("quality", "not a key with a value"),
        ("=3", "not a key with a value"),
        ("", "not a key with a value"),
        (".=1", "unknown key"),
        ("quality.step=[1", "not YAML"),
        ("quality.step={a: 1, a: 2}", "occurs twice"),
        ("volumes.1.path=b", "no such item in the list; found 1; allowed 0 to 0"),
        ("volumes.path=b", "a list item has no number before path; allowed volumes.0.path"),
        ("volumes.0.clim.5=1", "no such item in the list; found 5; allowed 0 to 1"),
        ("stepp=1", "unknown key, did you mean quality.step?"),
        ("camera.step=1", "unknown key, did you mean quality.step?"),
        ("nonsense=1", "unknown key; found nonsense"),
        ("3=1", "unknown key; found 3"),
        ("intensity=1", "no such item in the list"),
        ("step=big", "quality.step: not a number"),
    ],
)
def test_a_bad_option_is_an_error_that_names_it(path: Path, option: str, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        loaded(path, option)
    assert str(caught.value).startswith(f"-D {option}")
    assert message in str(caught.value)


def test_an_item_of_an_empty_list_is_an_error(path: Path) -> None:
    with pytest.raises(SceneError, match="the list is empty"):
        loaded(path, "volumes=[]", "volumes.0.path=b")


def test_parsed_overrides_hold_key_value_and_text() -> None:
    (override,) = parse_overrides(["volumes[0].clim=[1, 2]"])
    assert override.key == ("volumes", 0, "clim")
    assert override.value == [1, 2]
    assert override.option == "-D volumes[0].clim=[1, 2]"


def test_a_former_name_of_a_key_is_read_with_a_note() -> None:
    makers = (
        lambda: Scene.model_validate({"quality": {"leaping": True}}),
        lambda: with_settings(Scene(), {"leaping": True}),
        lambda: scene_of_data("field:gaussian:9", ["quality.leaping=true"]),
    )
    for make in makers:
        with pytest.warns(FutureWarning, match="leaping is called frame_coherence now"):
            assert make().quality.frame_coherence


@pytest.mark.parametrize(
    ("options", "key", "value"),
    [
        (["opacity=0.3"], "meshes.0.opacity", 0.3),  # there is no volume
        (["meshes.0.opacity=0.3"], "meshes.0.opacity", 0.3),
        (["radius=2"], "points.0.radius", 2.0),
        (["shading=flat"], "meshes.0.shading", "flat"),
        (["array=Temp"], "grids.0.array", "Temp"),
        (["clim=[0, 1]"], "grids.0.clim", (0.0, 1.0)),
        (["volumes=[{path: a}]", "opacity=0.3"], "volumes.0.opacity", 0.3),
        (["volumes=[{path: a}]", "culling=back"], "meshes.0.culling", "back"),
    ],
)
def test_a_last_name_is_that_of_a_surface_if_no_volume_has_it(
    tmp_path: Path, options: list[str], key: str, value: object
) -> None:
    scene = tmp_path / "scene.yaml"
    files = {"points": "p.csv", "grids": "g.vtu"}
    name = next((name for name in files if key.startswith(name)), "meshes")
    scene.write_text(f"{name}: [{{path: {files.get(name, 'm.ply')}}}]")
    found: Any = load_scene(scene, options)
    assert getattr(found, key.split(".")[0])[0].path.startswith(str(tmp_path)) or key.startswith("volumes")
    section, _, last = key.split(".")
    assert getattr(getattr(found, section)[0], last) == value
