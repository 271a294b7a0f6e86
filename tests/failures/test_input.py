"""Bad input to a whole command: one line that says what, where, found and allowed; status 2; nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from failures.jobs import FIELD, SMALL, check_failure, render

from clusterviz.cli import run

SCENES = {
    "unknown-key": (f"volumes: [{{path: '{FIELD}', opacty: 1}}]", "unknown key, did you mean opacity?"),
    "wrong-type": (f"volumes: [{{path: '{FIELD}'}}]\nquality: {{step: big}}", "quality.step: not a number"),
    "impossible": (f"volumes: [{{path: '{FIELD}'}}]\nquality: {{step: 0}}", "quality.step: too small; found 0"),
    "two-volumes": (
        f"volumes: [{{path: '{FIELD}'}}, {{path: '{FIELD}', blending: average}}]",
        "volumes[1].blending: not for several volumes",
    ),
    "eye-at-focus": ("camera: {position: [1, 1, 1], focal_point: [1, 1, 1]}", "camera"),
    "up-along-view": ("camera: {position: [0, 0, 5], focal_point: [0, 0, 0], view_up: [0, 0, 1]}", "view_up"),
    "not-yaml": ("volumes: [", "not YAML"),
    "empty": ("", "the scene file is empty"),
    "no-data": ("volumes: [{path: none.npy}]", "no such file"),
}


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Run `render` in this process: its status, and what it said on stderr."""

    def call(*arguments: str) -> tuple[int, str]:
        status = run(["render", *arguments])
        return status, capsys.readouterr().err

    return call


@pytest.mark.parametrize("name", SCENES)
def test_a_bad_scene(name: str, command: Callable[..., tuple[int, str]], tmp_path: Path) -> None:
    text, said = SCENES[name]
    scene, folder = tmp_path / "scene.yaml", tmp_path / "out"
    scene.write_text(text)
    folder.mkdir()
    status, err = command(str(scene), "-o", str(folder / "a.png"), *SMALL)
    assert (status, err.count("\n")) == (2, 1), err
    assert err.startswith("clusterviz: error: ")
    assert said in err
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("-D", "quality.stepp=1"), "unknown key, did you mean step?"),
        (("-D", "quality.step"), "not a key with a value"),
        (("-D", "cluster.compositing=magic"), "not one of the choices"),
        (("--size", "800"), "--size: not a size; found 800; allowed WIDTHxHEIGHT"),
        (("--size", "0x5"), "--size: not a size"),
        (("--device", "99"), "no such EGL device; found 99"),
    ],
)
def test_a_bad_option(
    options: tuple[str, ...], said: str, command: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    status, err = command(FIELD, "-o", str(tmp_path / "a.png"), *options)
    assert (status, err.count("\n")) == (2, 1), err
    assert said in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("missing.nrrd", None, "no such file"),
        ("empty.npy", b"", "empty"),
        ("wrong.nii", b"not a header " * 40, "wrong.nii"),
        ("unknown.xyz", b"1 2 3", "unknown extension"),
    ],
)
def test_bad_data(
    name: str, content: bytes | None, said: str, command: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    status, err = command(str(tmp_path / name), "-o", str(tmp_path / "a.png"))
    assert (status, err.count("\n")) == (2, 1), err
    assert said in err
    assert not (tmp_path / "a.png").exists()


@pytest.mark.fresh
def test_data_that_ends_early_is_told_once_by_all_ranks(tmp_path: Path) -> None:
    data, out = tmp_path / "cut.npy", tmp_path / "out"
    out.mkdir()
    np.save(data, np.zeros((20, 20, 20), np.float32))
    data.write_bytes(data.read_bytes()[:-8000])
    check_failure(render(3, str(data), "-o", str(out / "a.png"), *SMALL), 2, "cut.npy", out)
