"""Scene files: exact round trip, paths relative to the file, overrides, and files that are not scenes."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.content.sections import LISTED_SECTIONS
from clusterviz.data import open_scene
from clusterviz.errors import SceneError
from clusterviz.scene import Scene, dump_scene, load_scene, scene_of_data, scene_schema
from clusterviz.scene.transfer import PRESETS
from clusterviz.scene.yaml_text import parse_yaml, write_yaml

finite = st.floats(allow_nan=False, allow_infinity=False)
unit = st.floats(0, 1)
positive = st.floats(0, exclude_min=True, allow_infinity=False)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1).filter(str.strip)
numberlike = st.sampled_from(
    ["1e-3", "1e5", "0x1f", "1:30", "null", "~", "yes", "2020-01-01", "1_0", ".5", "-", "=", "<<"]
)


def points(*columns: st.SearchStrategy[float]) -> st.SearchStrategy[list[tuple[float, ...]]]:
    return st.lists(st.tuples(*columns), min_size=1, max_size=5).map(lambda rows: sorted(rows, key=lambda row: row[0]))


volumes = st.fixed_dictionaries(
    {"path": texts | numberlike},
    optional={
        "array": st.none() | texts | numberlike,
        "cmap": st.none() | st.just("viridis") | points(finite, unit, unit, unit),
        "clim": st.none() | st.tuples(finite, finite).map(sorted),
        "opacity": st.none() | unit | st.sampled_from(PRESETS) | points(finite, unit),
        "opacity_unit_distance": st.none() | positive,
        "interpolation": st.sampled_from(["linear", "nearest"]),
        "ambient": unit,
    },
)
scenes = st.fixed_dictionaries(
    {},
    optional={
        "volumes": st.lists(volumes, max_size=1),
        "camera": st.fixed_dictionaries(
            {}, optional={"position": st.tuples(finite, finite, finite), "view_angle": st.floats(1e-9, 179)}
        ),
        "image": st.fixed_dictionaries(
            {},
            optional={
                "size": st.tuples(st.integers(1, 65536), st.integers(1, 65536)),
                "background": st.sampled_from(["white", "Teal", "#09f", "transparent"]) | st.tuples(unit, unit, unit),
            },
        ),
        "quality": st.fixed_dictionaries(
            {}, optional={"step": st.floats(1e-300, 1e9), "early_termination": st.floats(0, 0.999)}
        ),
        "cluster": st.fixed_dictionaries({}, optional={"brick": st.integers(2, 1024)}),
    },
).map(Scene.model_validate)


@given(scenes)
def test_a_scene_survives_yaml_exactly(scene: Scene) -> None:
    assert Scene.model_validate(parse_yaml(dump_scene(scene))) == scene


@given(st.floats())
def test_every_float_survives_yaml(value: float) -> None:
    back = parse_yaml(write_yaml([value]))[0]
    assert type(back) is float
    assert back == value or math.isnan(value)
    assert math.isnan(value) or math.copysign(1, back) == math.copysign(1, value)


def write(folder: Path, text: str, name: str = "scene.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_load_dump_load_gives_an_equal_scene(tmp_path: Path) -> None:
    first = load_scene(write(tmp_path, "volumes: [{path: sub/a.npy, cmap: bone, opacity: [[1e-3, 0], [2E5, 1]]}]"))
    assert first.volumes[0].opacity == ((0.001, 0.0), (200000.0, 1.0))
    assert load_scene(write(tmp_path, dump_scene(first), "again.yaml")) == first


def test_paths_are_relative_to_the_scene_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scenes").mkdir()
    write(tmp_path / "scenes", "volumes: [{path: ../data/f.h5:/t/rho}]")
    monkeypatch.chdir(tmp_path)
    assert load_scene("scenes/scene.yaml").volumes[0].path == f"{tmp_path}/data/f.h5:/t/rho"
    assert scene_of_data("data/f.h5:/t/rho").volumes[0].path == f"{tmp_path}/data/f.h5:/t/rho"
    absolute = load_scene("scenes/scene.yaml", ["volumes.0.path=/x/y.npy"])
    assert absolute.volumes[0].path == "/x/y.npy"
    assert scene_of_data("field:shells:32").volumes[0].path == "field:shells:32"


def test_json_scenes_are_read(tmp_path: Path) -> None:
    path = write(tmp_path, '{\t"quality": {"step": 0.5}}', "scene.json")
    assert open_scene(path).quality.step == 0.5


def test_a_section_left_empty_counts_as_left_out(tmp_path: Path) -> None:
    assert load_scene(write(tmp_path, "volumes:\nquality:\n")) == Scene()


def test_a_key_of_volumes_is_refused_where_there_are_none() -> None:
    with pytest.raises(SceneError, match="-D detail=full: no such item in the list; found 0"):
        scene_of_data("a.ply", ["detail=full"], ("meshes",))


def test_open_scene_takes_data_by_its_suffix(tmp_path: Path) -> None:
    scene = open_scene(tmp_path / "a.npy", ["volumes.0.clim=[1, 2]"])
    assert scene.volumes[0].clim == (1.0, 2.0)


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("", "a.yaml", "the scene file is empty"),
        ("# nothing", "a.yaml", "the scene file is empty"),
        ("just words", "a.yaml", 'not a scene; found "just words"'),
        ("[1, 2]", "a.yaml", "not a scene; found [1, 2]"),
        ("quality: {step: 1, step: 2}", "a.yaml", "the key 'step' occurs twice (line 1, column 20)"),
        ('{"quality": {"step": 1, "step": 2}}', "a.json", "the key 'step' occurs twice"),
        ("quality: {step: 1", "a.yaml", "not YAML"),
        ('{"quality": ', "a.json", "not JSON"),
        ("? [a, b]\n: 1", "a.yaml", "a key is not a word"),
        ("a: !!python/object:os.system {}", "a.yaml", "not YAML"),
        ("quality: {step: .nan}", "a.yaml", "quality.step: not finite"),
        ('{"quality": {"step": Infinity}}', "a.json", "quality.step: not finite"),
        (
            "volumes: [{path: a, cmap: virids}]",
            "a.yaml",
            "volumes[0].cmap: unknown colour map; found virids; allowed a name that",
        ),
        ("volumes: [{path: a, cmap: nope.json}]", "a.yaml", "cannot be read: No such file"),
        ("quality: {stp: 1}", "a.yaml", "quality.stp: unknown key, did you mean step?"),
        ("1: 2", "a.yaml", "a.yaml: "),
    ],
)
def test_what_is_not_a_scene_is_refused_by_name(tmp_path: Path, text: str, name: str, message: str) -> None:
    path = write(tmp_path, text, name)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


def test_unreadable_scene_files_are_errors(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"none\.yaml: cannot be read: No such file"):
        load_scene(tmp_path / "none.yaml")
    with pytest.raises(SceneError, match="Is a directory"):
        load_scene(tmp_path)
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"volumes: \xff\xfe")
    with pytest.raises(SceneError, match="not UTF-8 text, at byte 9"):
        load_scene(binary)


def test_the_error_of_an_overridden_key_names_the_option(tmp_path: Path) -> None:
    path = write(tmp_path, "quality: {step: 1}")
    with pytest.raises(SceneError, match=r"^-D quality.step=0: quality.step: too small; found 0; allowed more than 0$"):
        load_scene(path, ["quality.step=0"])


def test_the_schema_describes_every_key() -> None:
    schema = scene_schema()
    json.dumps(schema)

    def described(section: dict[str, Any]) -> None:
        assert section["additionalProperties"] is False
        for name, field in section["properties"].items():
            assert field.get("description"), name

    described(schema)
    for section in schema["$defs"].values():
        described(section)
    sections = {*LISTED_SECTIONS, "volumes", "lights", "clip", "camera", "image", "annotations", "quality", "cluster"}
    assert set(schema["properties"]) == {*sections, "automatic"}


def test_the_example_scenes_load() -> None:
    examples = sorted((Path(__file__).parents[2] / "examples").glob("*.yaml"))
    assert examples
    for example in examples:
        scene = load_scene(example)
        assert scene.volumes or scene.geometry or scene.grids or scene.flows
