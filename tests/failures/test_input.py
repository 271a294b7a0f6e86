"""Bad input to a whole command: one line that says what, where, found and allowed; status 2; nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from failures.jobs import FIELD, SMALL, check_failure, render

from clusterviz.cli import run

PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(44)
SCENES = {
    "unknown-key": (f"volumes: [{{path: '{FIELD}', opacty: 1}}]", "unknown key, did you mean opacity?"),
    "other-section": (f"volumes: [{{path: '{FIELD}'}}]\nstep: 2", "unknown key, did you mean quality.step?"),
    "no-path": ("volumes: [{}]", 'volumes[0].path: missing; allowed a value, such as "head.nii.gz"'),
    "no-list": (
        "volumes: head.npy",
        'volumes: not a list; found "head.npy"; allowed a list, such as [{"path": "head.nii.gz"}]',
    ),
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
        (("--size", "0x5"), "--size: too small; found 0x5; allowed 1 to 65536 pixels a side"),
        (("--size", "100000x100000"), "--size: too large; found 100000x100000; allowed 1 to 65536 pixels a side"),
        (("-D", "clim=5"), "volumes[0].clim: not a list; found 5; allowed a list, such as [20, 200]"),
        (("-D", "clim=[5]"), "volumes[0].clim: too few values; found [5]; allowed a list, such as [20, 200]"),
        (("-D", "clim=[1,2,3]"), "clim: too many values; found [1, 2, 3]; allowed at most 2 values, such as [20, 200]"),
        (("-D", "opacity=[1]"), "volumes[0].opacity[0]: not a list; found 1; allowed a list, such as [20, 0]"),
        (("-D", "opacity=[[1]]"), "opacity[0]: too few values; found [1]; allowed a list, such as [20, 0]"),
        (("-D", "cmap=[[1]]"), "cmap[0]: too few values; found [1]; allowed a list, such as [20, 0, 0, 0]"),
        (("-D", "gradient_opacity=3"), "not a list; found 3; allowed a list, such as [[0, 0], [10, 1]]"),
        (("-D", "isosurfaces=3"), "not a list; found 3; allowed a list, such as [[90, 0.5], 120]"),
        (("-D", "size=4"), "image.size: not a list; found 4; allowed a list, such as [800, 600]"),
        (("-D", "background=[1]"), "too few values; found [1]; allowed a list, such as [0.1, 0.2, 0.4]"),
        (("-D", "position=4"), "camera.position: not a list; found 4; allowed a list, such as [0, 0, 1]"),
        (
            ("-D", "view_up=[0,0,0]"),
            "the zero vector has no direction; found [0.0, 0.0, 0.0]; allowed a direction, such as",
        ),
        (("-D", "box=[1]"), "clip.box: too few values; found [1]; allowed a list, such as [0, 10, 0, 10, 0, 5]"),
        (("-D", "planes=[1]"), "clip.planes[0]: not a list; found 1; allowed a list, such as [[0, 0, 0], [1, 0, 0]]"),
        (("-D", "lights=3"), 'lights: not a list; found 3; allowed a list, such as [{"position": [1, 1, 1]}]'),
        (("--device", "99"), "no such EGL device; found 99; allowed 0"),
        (("--device", "gpu"), "--device: not a device; found gpu; allowed cpu"),
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
        ("wrong.nii", b"not a header " * 40, "found text that begins 'not a header not"),
        ("unknown.xyz", b"1 2 3", "unknown extension; found .xyz, text that begins '1 2 3'; allowed .npy, "),
        ("picture.xyz", PNG, "unknown extension; found .xyz, a PNG picture; allowed .npy, "),
        ("a.npy", PNG, "a.npy: wrong magic: not what its name says; found a PNG picture; allowed a NumPy array (.npy)"),
        ("a.nrrd", PNG, "found a PNG picture; allowed NRRD"),
        ("a.nii", PNG, "found a PNG picture; allowed NIfTI-1 or NIfTI-2"),
        ("a.nii.gz", PNG, "found a PNG picture; allowed packed by gzip"),
        ("a.tif", PNG, "found a PNG picture; allowed TIFF"),
        ("a.vti", PNG, "found a PNG picture; allowed VTK's XML"),
        ("a.mrc", PNG, "found 60 bytes, a PNG picture; allowed 1024 and more"),
        ("a.h5", b"PK\x03\x04" + bytes(2000), "found a ZIP archive (.zip, .npz, .docx); allowed HDF5"),
        ("b.mrc", bytes(2000), "found zeros; at byte 208 b"),
        ("a.tiff", bytes(344) + b"n+1\0" + bytes(8), "found NIfTI; allowed TIFF"),
        ("b.nrrd", bytes(128) + b"DICM" + bytes(300), "found DICOM; allowed NRRD"),
        ("c.nrrd", bytes(range(128, 192)) * 9, "found bytes 80 81 82 83 84 85 86 87; allowed NRRD"),
        ("a.raw", b"1234", "a.raw.yaml with the keys shape, dtype, byte_order, "),
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
