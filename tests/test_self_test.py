"""The self-test of OpenGL: its pictures, what is kept of a driver, and scenes that a driver draws wrong."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import moderngl
import numpy as np
import pytest

from clusterviz import self_test
from clusterviz.cli import doctor
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.data.given import given_scene
from clusterviz.errors import ClustervizError, DataWarning, DeviceError
from clusterviz.frame import Options, render_frame
from clusterviz.gl import devices, driver_needs, driver_record
from clusterviz.gl.context import open_context
from clusterviz.gl.driver_needs import AMPLE, compile_checked
from clusterviz.gl.driver_record import driver_of, keep_record, record_folder
from clusterviz.scene.features import FEATURES, features_of
from clusterviz.self_test import STORED, outcomes_of
from clusterviz.self_test.contents import PICTURE
from clusterviz.self_test.pictures import _scene, _vectors, expected
from clusterviz.spmd.source import ShaderSource

BY_NAME = {each.name: each for each in FEATURES}
FEW = "samples of integers", "pyramid filters"
ALIKE = {
    ("samples of integers", "texture unit"),
    ("samples of floats", "adaptive step"),
    ("unstructured grids", "k-buffer"),
}
"""Features of which one shows the other by another way."""


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("CLUSTERVIZ_CACHE", str(tmp_path))
    return tmp_path / "drivers"


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (self_test, doctor):
        monkeypatch.setattr(module, "FEATURES", tuple(BY_NAME[name] for name in FEW))


def test_the_stored_pictures_are_those_of_the_reference() -> None:
    """Without refraction, whose rays the reference follows one by one."""
    stored = np.load(STORED)
    assert set(stored.files) == set(BY_NAME)
    assert STORED.stat().st_size < 300_000
    for name in BY_NAME.keys() - {"refraction"}:
        assert stored[name].dtype == np.float64
        np.testing.assert_allclose(expected(BY_NAME[name]), stored[name], rtol=0, atol=1e-11, err_msg=name)


def test_each_feature_changes_its_picture() -> None:
    stored = np.load(STORED)
    for pair in set(combinations(BY_NAME, 2)) - ALIKE:
        a, b = (stored[name] for name in pair)
        assert a.shape != b.shape or np.abs(a - b).max() > 1e-3, pair


@pytest.mark.parametrize("name", [each.name for each in FEATURES if each.content not in ("filter", "lic")])
def test_the_scene_of_a_picture_uses_its_feature(name: str) -> None:
    assert name in features_of(_scene(BY_NAME[name])[0], has_invalid=name == "invalid voxels")


def test_a_plain_scene_uses_little() -> None:
    scene = _scene(BY_NAME["samples of floats"])[0]
    assert features_of(scene, False) == ["samples of integers", "samples of floats"]
    assert "invalid voxels" in features_of(scene, True)


@pytest.mark.gl
def test_doctor_says_what_is_right_and_keeps_what_is_wrong(
    few: None, cache: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    doctor.command(json=True, gl=True)
    (found,) = json.loads(capsys.readouterr().out)["self_tests"]
    assert [each["name"] for each in found["features"]] == [*FEW]
    assert all(0 < each["error"] <= each["bound"] and not each["problem"] for each in found["features"])
    assert json.loads(next(cache.iterdir()).read_text())["wrong"] == {}
    stored = {name: np.load(STORED)[name] + 0.5 * (name == FEW[0]) for name in FEW}
    monkeypatch.setattr(self_test.np, "load", lambda path: stored)
    with pytest.raises(DeviceError, match=r"1 of 2 features wrong: samples of integers: off by 0.5, at most 1e-05"):
        doctor.command(gl=True)
    assert "wrong" in capsys.readouterr().out
    assert "off by" in json.loads(next(cache.iterdir()).read_text())["wrong"][FEW[0]]


@pytest.mark.gl
def test_ranks_of_one_device_test_it_once(few: None) -> None:
    def test(channel: Any) -> Any:
        return doctor.self_tests(channel, doctor.examine(channel))

    for found in run_loopback(3, test):
        assert [each.ranks for each in found] == [(0, 1, 2)]
        assert not found[0].wrong


@pytest.fixture
def draw(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """`draw(name, wrong, device)`: statistics of a feature's scene where a GPU's driver has some features wrong."""
    monkeypatch.delenv(devices.ENVIRONMENT, raising=False)
    monkeypatch.setattr(devices, "has_gpu", lambda: True)
    context = open_context()
    driver = driver_of(context.info)
    context.release()

    def drawn(name: str, wrong: dict[str, str], device: Any = None, channel: Any = None) -> Any:
        keep_record(driver, wrong)
        scene, sources = _scene(BY_NAME[name])
        return render_frame(scene, channel or LoopbackChannel(), sources, Options(device=device)).statistics

    return drawn


@pytest.mark.gl
def test_what_a_driver_draws_wrong_is_drawn_by_the_cpu_or_refused(draw: Callable[..., Any]) -> None:
    wrong = {"samples of floats": "off by 0.1", "light": "off by 0.2"}
    with pytest.warns(DataWarning, match=r"llvmpipe.* draws wrong.*: samples of floats \(off by 0.1\); the CPU draws"):
        assert "CPU" in draw("samples of floats", wrong).renderer
    with pytest.raises(DeviceError, match=r"llvmpipe.*Mesa.*samples of floats \(off by 0.1\); allowed --device cpu"):
        draw("samples of floats", wrong, device=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        assert "CPU" in draw("samples of floats", wrong, device="cpu").renderer
        assert "llvmpipe" in draw("samples of floats", {"light": "off by 0.2"}).renderer


@pytest.mark.gl
def test_all_ranks_leave_a_driver_that_is_wrong_on_one(
    draw: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    answers: list[tuple[str, dict[str, str]]] = []
    monkeypatch.setattr("clusterviz.frame.driver.known_wrong", lambda features, driver: answers.pop())

    def draw_on_three(device: Any) -> Any:
        answers[:] = [("", {}), ("a driver", {"light": "off"}), ("", {})]
        return run_loopback(3, lambda channel: draw("light", {}, device, channel))

    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", DataWarning)
        assert "CPU" in draw_on_three(None)[0].renderer
    assert [str(each.message)[:20] for each in warned if each.category is DataWarning] == ["a driver draws wrong"]
    with pytest.raises(ClustervizError, match="a driver draws wrong"):
        draw_on_three(0)


@pytest.mark.gl
def test_flows_are_convolved_by_the_device_that_draws(
    draw: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    draw("samples of floats", {"line integral convolution": "off"}, device="cpu")  # keeps the record
    used = list[int]()
    monkeypatch.setattr("clusterviz.jobs.device._launch_on_gl", lambda make, grid, arguments, egl: used.append(egl))
    scene, sources = given_scene(None, None, PICTURE | {"flows": [{"path": _vectors(), "show": "lic"}]}, "test")
    with pytest.warns(DataWarning, match=r"draws wrong.*line integral convolution \(off\); the CPU draws"):
        found = render_frame(scene, LoopbackChannel(), sources, Options())
    assert "CPU" in found.statistics.renderer
    assert found.image is not None
    assert found.image.any()
    assert not used


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '{"driver": 1}', '{"driver": "d", "shaders": "s", "wrong": {"light": 2}}']
)
def test_records_that_are_damaged_or_old_count_as_none(text: str, cache: Path) -> None:
    def ask() -> str:
        raise AssertionError("no driver has to be asked")

    assert driver_record.known_wrong(["light"], ask) == ("", {})
    cache.mkdir(parents=True)
    (cache / "a.json").write_text(text)
    (cache / "b.json").write_text(json.dumps({"driver": "d", "shaders": "older ones", "wrong": {"light": "off"}}))
    assert driver_record.known_wrong(["light"], ask) == ("", {})
    keep_record("d", {"light": "off"})
    assert record_folder() == cache
    assert driver_record.known_wrong(["clipping"], ask) == ("", {})
    assert driver_record.known_wrong(["light"], lambda: "d") == ("d", {"light": "off"})
    assert driver_record.known_wrong(["light"], lambda: "another") == ("another", {})


SHADER = ShaderSource(Path(__file__).with_name("wide.glsl").read_text(), ("wide.glsl",))
"""It uses nine of its ten blocks."""


@pytest.mark.parametrize(
    ("info", "extensions", "lacking"),
    [
        ({"GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 8}, {driver_needs.DOUBLES}, "9 storage blocks .*has 8"),
        ({"GL_MAX_COMPUTE_WORK_GROUP_INVOCATIONS": 32}, {driver_needs.DOUBLES}, "256 invocations .*has 32"),
        ({}, set(), "double precision"),
        (
            {"GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 8, "GL_MAX_COMPUTE_WORK_GROUP_INVOCATIONS": 128},
            set(),
            "9 storage blocks .*256 invocations .*double precision",
        ),
    ],
)
def test_all_that_a_driver_lacks_is_named_at_once(info: dict[str, int], extensions: set[str], lacking: str) -> None:
    ample = {"GL_RENDERER": "poor", "GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 16}
    poor = SimpleNamespace(info=ample | info, extensions=extensions)
    with pytest.raises(DeviceError, match=rf"^poor lacks what wide.glsl needs: {lacking}.*--device cpu"):
        compile_checked(poor, SHADER)


def test_a_shader_that_an_ample_driver_refuses_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(text: str) -> None:
        raise moderngl.Error("too many blocks")

    usual = SimpleNamespace(info={"GL_RENDERER": "usual"}, extensions={driver_needs.DOUBLES}, compute_shader=refuse)
    monkeypatch.setattr(driver_needs, "AMPLE", replace(AMPLE, storage_blocks=8))
    with pytest.raises(DeviceError, match=r"usual lacks what wide.glsl needs: 9 storage blocks"):
        compile_checked(usual, SHADER)
    usual.info["GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS"] = 16
    with pytest.raises(DeviceError, match="too many blocks"):
        compile_checked(usual, SHADER)


@pytest.mark.gl
def test_what_does_not_need_what_a_driver_lacks_is_drawn(few: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver with work groups of 128, eight storage blocks and no double precision, of which filters need nothing."""
    poor = replace(AMPLE, storage_blocks=8, invocations=128, doubles=False)
    monkeypatch.setattr(driver_needs, "limits_of", lambda context: poor)
    volume, pyramid = outcomes_of(0, lambda name: None)
    assert not pyramid.problem
    assert not volume.problem or "needs: double precision (GL_ARB_gpu_shader_fp64);" in volume.problem
    monkeypatch.setattr(driver_needs, "limits_of", lambda context: replace(poor, storage_blocks=2, doubles=True))
    volume, pyramid = outcomes_of(0, lambda name: None)
    assert "storage blocks in a compute shader (it has 2)" in volume.problem
