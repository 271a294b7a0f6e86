"""replay: pictures hold their scene and what drew them, and are rendered again."""

from __future__ import annotations

import json
import struct
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Pillow
from PIL.PngImagePlugin import PngInfo
from rich.console import Console

from clusterviz.cli.console import escaped_output
from clusterviz.cli.jobs import run_job
from clusterviz.data.identity import PART_BYTES, PARTS, data_identity
from clusterviz.frame.picture_file import read_record, write_picture
from clusterviz.image.files import RECORD_KEY, TEXT_KEY, read_text
from clusterviz.report.decisions import Accuracy, Detail
from clusterviz.report.provenance import Provenance, stated_error
from clusterviz.scene import Scene, Volume
from clusterviz.scene.text import portable_path
from clusterviz.scene.values import Quality

CONTROLS = {chr(code) for code in (*range(9), *range(11, 32), *range(127, 160), 0x202E)}
SMALL = ("--size", "24x18", "-D", "cluster.brick=8")
VOXELS = np.random.default_rng(0).random((12, 12, 12), np.float32).cumsum(axis=0)


@pytest.fixture
def picture(cli: Callable[..., Any], tmp_path: Path) -> Path:
    """A picture in a folder beside that of its data."""
    for name in ("data", "pictures"):
        (tmp_path / name).mkdir()
    np.save(tmp_path / "data/a.npy", VOXELS)
    found = tmp_path / "pictures/a.png"
    assert cli("render", str(tmp_path / "data/a.npy"), "-o", str(found), *SMALL).status == 0
    return found


@pytest.mark.gl
def test_a_picture_is_rendered_again_wherever_it_lies_with_its_data(
    cli: Callable[..., Any], picture: Path, tmp_path: Path
) -> None:
    assert "path: ../data/a.npy\n" in read_text(picture)
    (tmp_path / "moved").mkdir()
    for folder in (picture.parent, tmp_path / "data"):
        folder.rename(tmp_path / "moved" / folder.name)
    moved, new = tmp_path / "moved/pictures/a.png", tmp_path / "moved/pictures/b.png"
    outcome = cli("replay", str(moved), "-o", str(new))
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.splitlines() == [
        "software, ranks, driver and data are the same",
        "pixels     max 0, rms 0, no pixel above 0.00393",
    ]
    assert new.read_bytes() == moved.read_bytes()


@pytest.mark.gl
def test_a_picture_of_a_pattern_is_rendered_again(cli: Callable[..., Any], picture: Path) -> None:
    data = picture.parents[1] / "data"
    np.save(data / "a_1.npy", VOXELS[::-1])
    (data / "a.npy").rename(data / "a_0.npy")
    with pytest.warns(UserWarning, match="time step 0 of 2 is drawn; for others give -D time=1"):
        assert cli("render", str(data / "a_*.npy"), "-o", str(picture), *SMALL).status == 0
    assert "  time: 0\n" in read_text(picture)
    again = cli("replay", str(picture))
    assert (again.status, again.err) == (0, "")


@pytest.mark.gl
def test_what_differs_is_told(cli: Callable[..., Any], picture: Path) -> None:
    """Ranks and software, which change no pixel; then the data, which do."""
    record = read_record(picture)
    report = json.loads(run_job(3, ["replay", str(picture), "--json"]))
    assert report["equal"]
    assert report["changes"].pop("ranks") == ["1", "3"]
    assert set(report["changes"]) <= {"mpi library", "renderer"}
    data = picture.parents[1] / "data/a.npy"
    np.save(data, VOXELS[:, ::-1])
    outcome = cli("replay", str(picture))
    assert outcome.status == 1
    assert (
        f"volumes.0.path  bytes {data.stat().st_size}, crc32 {record['data']['volumes.0.path']['crc32']}" in outcome.out
    )
    assert "the pictures differ: max 0." in outcome.err
    assert ", the first at row " in outcome.err


@pytest.mark.gl
def test_frames_and_transparent_pictures_hold_their_scenes(cli: Callable[..., Any], tmp_path: Path) -> None:
    shown = ("field:marschner-lobb:16", *SMALL, "-D", "image.background=transparent", "--orbit", "90", "--frames", "2")
    assert cli("animate", *shown, "-o", str(tmp_path / "frame_%d.png")).status == 0
    first, second = (read_text(tmp_path / f"frame_{number}.png") for number in range(2))
    assert first != second
    assert cli("replay", str(tmp_path / "frame_1.png")).status == 0


@pytest.mark.gl
def test_a_single_wrong_pixel_is_found(cli: Callable[..., Any], picture: Path) -> None:
    """A picture that was edited by a program that keeps its texts; by one level is rounding, by two is not."""
    from PIL import PngImagePlugin

    for levels, status in ((1, 0), (2, 1)):
        with Pillow.open(picture) as file:
            kept = PngImagePlugin.PngInfo()
            for key, text in file.text.items():  # type: ignore[attr-defined]
                kept.add_itxt(key, text)
            pixels = np.array(file)
        pixels[5, 7, 1] += levels
        edited = picture.with_name("edited.png")
        Pillow.fromarray(pixels).save(edited, pnginfo=kept)
        outcome = cli("replay", str(edited))
        assert (outcome.status, "row 5, column 7" in outcome.err) == (status, status == 1)


@pytest.mark.gl
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_strings_of_a_record_do_not_reach_the_terminal_as_they_are(
    cli: Callable[..., Any], picture: Path, options: tuple[str, ...]
) -> None:
    """A record says what its author likes: here it sets the terminal's title, goes up a line and turns text around."""
    strange = "\x1b]0;title\x07 \x1b[A \x9b2J \r \x7f \u202e"
    record = read_record(picture)
    record |= {"renderer": strange, "driver": [strange], "versions": {strange: strange}}
    text = PngInfo()
    for key, value in ((TEXT_KEY, read_text(picture)), (RECORD_KEY, json.dumps(record))):
        text.add_itxt(key, value)
    with Pillow.open(picture) as file:
        file.save(picture, pnginfo=text)
    outcome = cli("replay", str(picture), *options)
    assert outcome.status == 0
    assert set(strange) & CONTROLS & set(outcome.out + outcome.err) == set()
    assert r"\u001b]0;title\u0007" in outcome.out
    if options:
        assert json.loads(outcome.out)["then"]["renderer"] == strange


@pytest.mark.parametrize("stream", ["out", "err"])
def test_control_characters_are_escaped_on_both_streams(stream: str, capsys: pytest.CaptureFixture[str]) -> None:
    with escaped_output():
        file = getattr(sys, f"std{stream}")
        print("é\ta\x1b[31m", file=file)
        file.writelines(["\x00", "b\n"])
        Console(file=file, force_terminal=True, color_system="standard").print("[red]c[/]", end="")
    assert getattr(capsys.readouterr(), stream) == "é\ta\\u001b[31m\n\\u0000b\n\x1b[31mc\x1b[0m"


def test_pictures_that_cannot_be_rendered_again(cli: Callable[..., Any], tmp_path: Path) -> None:
    path, pixels = tmp_path / "a.png", np.zeros((2, 2, 4), np.float32)
    cases: dict[str, tuple[Scene | None, str]] = {
        "no record": (None, "no record in the picture"),
        "moved data": (Scene(volumes=(Volume(path=str(tmp_path / "b.npy")),)), "the data are not there; found"),
        "an array": (Scene(volumes=(Volume(path="array"),)), "shows data in memory"),
    }
    np.save(tmp_path / "b.npy", VOXELS)
    for name, (scene, message) in cases.items():
        if scene is None:
            Pillow.new("RGB", (2, 2)).save(path)
        else:
            write_picture(path, pixels, scene, Provenance())
            (tmp_path / "b.npy").unlink(missing_ok=True)
        outcome = cli("replay", str(path))
        assert (outcome.status, message in outcome.err) == (2, True), (name, outcome.err)
        assert scene is None or "-D volumes.0.path=FILE" in outcome.err


@pytest.mark.parametrize(
    "wrong",
    [
        {"data": [1]},
        {"versions": 3},
        {"error": "x"},
        {"error": {"estimated": "x", "asked_for": "y"}},
        {"error": {"estimated": 1.0}},
        None,
    ],
)
def test_strange_records_are_refused(wrong: Any, cli: Callable[..., Any], tmp_path: Path) -> None:
    path, info = tmp_path / "a.png", PngInfo()
    info.add_itxt("clusterviz scene", "volumes: [{path: 'field:ramp:4'}]")
    info.add_itxt("clusterviz record", json.dumps(wrong) if wrong else '{"data":' + "[" * 10**5 + "]" * 10**5 + "}")
    Pillow.new("RGB", (1024, 768)).save(path, pnginfo=info)
    outcome = cli("replay", str(path))
    assert (outcome.status, "a.png: damaged record of the picture" in outcome.err) == (2, True), outcome.err


@pytest.mark.parametrize(
    ("size", "text"), [((60000, 60000), "too large a picture"), ((12000, 9000), "not of its scene's size")]
)
def test_pictures_of_another_size_are_not_decoded(
    size: tuple[int, int], text: str, cli: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "a.png"
    write_picture(path, np.zeros((2, 2, 4), np.float32), Scene(volumes=(Volume(path="field:ramp:4"),)), Provenance())
    content = bytearray(path.read_bytes())
    content[16:24] = struct.pack(">II", *size)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    path.write_bytes(content)
    outcome = cli("replay", str(path))
    assert (outcome.status, text in outcome.err, len(outcome.err.splitlines())) == (2, True, 1), outcome.err


@pytest.mark.parametrize(
    ("path", "folder", "expected"),
    [
        ("/a/data/b.h5:/x", "/a/pictures", "../data/b.h5:/x"),
        ("/a/b.npy", "/a", "b.npy"),
        ("/users/me/b.npy", "/tmp", "~/b.npy"),
        ("/scratch/b.npy", "/tmp", "/scratch/b.npy"),
        ("array", "/tmp", "array"),
    ],
)
def test_paths_in_pictures(path: str, folder: str, expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/users/me")
    assert portable_path(path, Path(folder)) == expected


def test_the_identity_of_data(tmp_path: Path) -> None:
    """Copies are equal; sizes, both ends, and files of folders and patterns count."""
    (tmp_path / "a").mkdir()
    size = 3 * PARTS * PART_BYTES
    found = []
    for name, position in (("a/0.raw", None), ("1.raw", None), ("2.raw", 0), ("3.raw", size - 1), ("4.raw", size)):
        content = bytearray(size)
        if position is not None:
            content[position : position + 1] = b"x"
        (tmp_path / name).write_bytes(content)
        found.append(data_identity(str(tmp_path / name)))
    assert found[0] == found[1]
    assert len(set(found)) == 4
    folder = data_identity(str(tmp_path / "a"))
    assert folder == data_identity(str(tmp_path / "a/*.raw"))
    (tmp_path / "a/1.raw").write_bytes(b"")
    assert data_identity(str(tmp_path / "a")) != folder
    for name in ("field:gaussian:8", "https://a.org/b.zarr", str(tmp_path / "none.raw"), str(tmp_path / "*.none")):
        assert data_identity(name) is None


def test_the_error_is_stated_as_far_as_it_is_known() -> None:
    quality = Quality(step=0.5, filter="hardware").model_dump(mode="json")
    known = stated_error(Provenance(rounding=1e-7), quality)
    assert known["inexact_settings"] == {"step": 0.5, "filter": "hardware"}
    assert "estimated" not in known
    accuracy = Accuracy(0.01, 0.008, True, 0.5, "post", "exact", 0.0, "float32", 9, 9, 0.1)
    detail = (Detail(0, (1, 2), 8, bound=0.02),)
    known = stated_error(replace(Provenance(), accuracy=accuracy, detail=detail), quality)
    assert (known["estimated"], known["asked_for"], known["of_detail"]) == (0.008, 0.01, {"volumes[0]": 0.02})
