"""animate: numbered pictures, movies, resuming, and refused input."""

from __future__ import annotations

import errno
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from failures.jobs import failing, finish
from PIL import Image

from clusterviz.cli.jobs import run_job
from clusterviz.errors import OutputError
from clusterviz.image import files as image_files
from clusterviz.image import read_image

FIELD = "field:marschner-lobb:16"
SMALL = ("--size", "16x12", "-D", "cluster.brick=8")
ORBIT = ("--orbit", "360", "--frames", "3")
Run = Callable[..., Any]


def animate(cli: Run, output: Path, *arguments: str) -> Any:
    return cli("animate", FIELD, "-o", str(output), *SMALL, *arguments)


def pictures(folder: Path) -> list[Any]:
    return [read_image(path) for path in sorted(folder.glob("*.png"))]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.gl
def test_an_orbit_becomes_numbered_pictures(cli: Run, tmp_path: Path) -> None:
    reports = ("--stats", str(tmp_path / "s.json"), "--trace", str(tmp_path / "t.json"))
    outcome = animate(cli, tmp_path / "frame_%04d.png", *ORBIT, *reports)
    assert (outcome.status, outcome.err) == (0, "")
    assert "3 of 3 frames rendered" in outcome.out
    shown = [*(f"frame_{number:04}.png" for number in range(3)), "frame.animation.json", "s.json", "t.json"]
    assert names(tmp_path) == sorted(shown)
    drawn = pictures(tmp_path)
    alone = ("render", FIELD, "-o", str(tmp_path / "alone.png"), *SMALL, "-D", "camera.fit=orbit")
    assert cli(*alone).status == 0
    assert np.array_equal(drawn[0], read_image(tmp_path / "alone.png"))
    assert not np.array_equal(drawn[0], drawn[1])
    stats = json.loads((tmp_path / "s.json").read_text())
    assert [frame["number"] for frame in stats["frames"]] == [0, 1, 2]
    assert all(frame["seconds"]["total"] > 0 for frame in stats["frames"])
    events = json.loads((tmp_path / "t.json").read_text())["traceEvents"]
    assert {f"frame {number}" for number in range(3)} <= {event["name"] for event in events}


def test_rays_that_start_by_the_last_frame_end_with_what_was_missed(cli: Run, tmp_path: Path) -> None:
    options = ("--orbit", "2", "--frames", "2", "--device", "cpu", "--stats", str(tmp_path / "s.json"))
    outcome = animate(cli, tmp_path / "frame_%04d.png", *options, "-D", "quality.frame_coherence=true")
    assert (outcome.status, outcome.err) == (0, "")
    first, second = (frame["frame_coherence"] for frame in json.loads((tmp_path / "s.json").read_text())["frames"])
    assert not any(first.values())
    assert second["estimated"] + second["left_out"] + second["checked"] > 0
    assert (
        f"frame coherence: {second['estimated']} rays started later, {second['left_out']} were left out" in outcome.out
    )


@pytest.mark.gl
def test_resume_renders_what_is_missing_or_damaged_and_nothing_else(cli: Run, tmp_path: Path) -> None:
    pattern, stats = tmp_path / "frame_%d.png", tmp_path / "s.json"
    assert animate(cli, pattern, *ORBIT).status == 0
    whole = pictures(tmp_path)
    (tmp_path / "frame_0.png").unlink()
    damaged = tmp_path / "frame_2.png"
    damaged.write_bytes(damaged.read_bytes()[:90])
    # How the ranks share the work does not change pictures.
    again = animate(cli, pattern, *ORBIT, "--resume", "--stats", str(stats), "-D", "cluster.compositing=serial")
    assert again.status == 0, again.err
    assert [frame["number"] for frame in json.loads(stats.read_text())["frames"]] == [0, 2]
    assert all(np.array_equal(a, b) for a, b in zip(pictures(tmp_path), whole, strict=True))
    assert "0 of 3 frames rendered" in animate(cli, pattern, *ORBIT, "--resume").out


@pytest.mark.gl
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("-D", "volumes.0.opacity=0.5"), "scene.volumes[0].opacity: was"),
        (("--size", "18x12"), "scene.image.size: was [16, 12], is [18, 12]"),
        (("--orbit", "180"), "path.orbit: was 360.0, is 180.0"),
        (("--frames", "4"), "frames: was 3, is 4"),
    ],
)
def test_resume_with_a_changed_scene_is_refused(change: tuple[str, ...], said: str, cli: Run, tmp_path: Path) -> None:
    pattern = tmp_path / "frame_%d.png"
    assert animate(cli, pattern, *ORBIT).status == 0
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    outcome = animate(cli, pattern, *ORBIT, "--resume", *change)
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert said in outcome.err
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


@pytest.mark.gl
def test_without_resume_older_frames_are_not_taken_for_new_ones(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pattern = tmp_path / "frame_%d.png"
    assert animate(cli, pattern, *ORBIT).status == 0
    fill_disk_at(1, monkeypatch)
    assert animate(cli, pattern, *ORBIT, "-D", "volumes.0.opacity=0.5").status == 2
    assert names(tmp_path) == ["frame.animation.json", "frame_0.png"]


def fill_disk_at(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Writing the n-th picture from now on, and all after it, finds the disk full."""
    right, calls = image_files._WRITERS[".png"], list[Path]()

    def write(path: Path, *given: Any) -> None:
        calls.append(path)
        right(path, *given)
        if len(calls) > number:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setitem(image_files._WRITERS, ".png", write)


@pytest.mark.gl
@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_full_disk_is_one_error_and_leaves_whole_frames(
    number: int, cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill_disk_at(number, monkeypatch)
    outcome = animate(cli, tmp_path / "frame_%d.png", *ORBIT)
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert f"frame_{number}.png: cannot be written; found No space left on device" in outcome.err
    assert names(tmp_path) == ["frame.animation.json", *(f"frame_{n}.png" for n in range(number))]
    assert all(picture.shape == (12, 16, 4) for picture in pictures(tmp_path))


@pytest.mark.gl
def test_a_movie_has_every_frame_and_leaves_no_pictures(cli: Run, tmp_path: Path) -> None:
    import imageio_ffmpeg

    outcome = animate(cli, tmp_path / "a.mp4", *ORBIT, "--size", "17x13", "--fps", "10")
    assert (outcome.status, outcome.err) == (0, "")
    assert names(tmp_path) == ["a.mp4"]
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))
    assert (count, seconds) == (3, pytest.approx(0.3, abs=0.05))
    movie = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    assert next(movie)["size"] == (18, 14)
    first = np.frombuffer(next(movie), np.uint8).reshape(14, 18, 3)[:13, :17] / 255.0
    assert cli("render", FIELD, "-o", str(tmp_path / "b.png"), *SMALL, "--size", "17x13").status == 0
    # Lossy, and colour at half the resolution: close, not equal.
    assert np.abs(first - read_image(tmp_path / "b.png")[..., :3]).mean() < 0.05


@pytest.mark.gl
def test_a_movie_that_failed_is_made_of_the_frames_that_were_kept(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path, *_: Any) -> None:
        raise OutputError("cannot be written", where=str(path))

    with monkeypatch.context() as patch:
        patch.setattr("clusterviz.cli.animate.write_movie", fail)
        assert animate(cli, tmp_path / "a.mp4", *ORBIT).status == 2
    assert names(tmp_path) == ["a.mp4.frames"]
    outcome = animate(cli, tmp_path / "a.mp4", *ORBIT, "--resume")
    assert "0 of 3 frames rendered" in outcome.out
    assert names(tmp_path) == ["a.mp4"]


def test_an_encoder_that_is_missing_is_told_before_the_data_is_read(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    outcome = cli("animate", "none.npy", "-o", str(tmp_path / "a.mp4"), *ORBIT)
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert "a.mp4: no encoder for movies" in outcome.err
    assert "pip install '.[movie]' in a checkout" in outcome.err
    assert names(tmp_path) == []


@pytest.mark.gl
def test_a_movie_cannot_be_transparent(cli: Run, tmp_path: Path) -> None:
    outcome = animate(cli, tmp_path / "a.mp4", *ORBIT, "-D", "image.background=transparent")
    assert (outcome.status, "a movie cannot be transparent" in outcome.err) == (2, True)
    assert names(tmp_path) == []


@pytest.mark.gl
def test_a_path_lasts_as_long_as_its_keys_and_a_camera_may_see_nothing(cli: Run, tmp_path: Path) -> None:
    (tmp_path / "path.yaml").write_text(
        "camera:\n"
        "  - {time: 0, position: [4, 0, 0], focal_point: [0, 0, 0]}\n"
        "  - {time: 0.5, position: [5, 0, 0], focal_point: [0, 0, 0]}\n"
        "  - {time: 1, position: [5, 0, 0], focal_point: [90, 0, 0]}\n"
        "transfer:\n"
        "  - {time: 0, opacity: 0.0}\n"
        "  - {time: 0.5, opacity: 0.5}\n"
    )
    arguments = ("--path", str(tmp_path / "path.yaml"), "--fps", "2", "-D", "image.background=[0, 0, 1]")
    outcome = animate(cli, tmp_path / "f%02d.png", *arguments)
    assert outcome.status == 0, outcome.err
    blue = np.broadcast_to(np.float32([0, 0, 1, 1]), (12, 16, 4))
    drawn = pictures(tmp_path)
    # Nothing is opaque; then it is, and seen from near; then the camera looks the other way.
    assert [np.array_equal(picture, blue) for picture in drawn] == [True, False, True]


@pytest.mark.fresh
@pytest.mark.gl
def test_several_ranks_give_the_same_frames_and_a_failing_one_names_its_frame(cli: Run, tmp_path: Path) -> None:
    one, three = tmp_path / "one", tmp_path / "three"
    one.mkdir()
    three.mkdir()
    assert animate(cli, one / "f%d.png", *ORBIT).status == 0
    # A mode that is given needs no pre-pass, which would fail first.
    options = (*SMALL, *ORBIT, "--resume", "-D", "cluster.mode=sort-last")
    command = ("animate", FIELD, "-o", str(three / "f%d.png"), *options)
    run_job(3, [*command, "--trace", str(tmp_path / "t.json")])
    for alone, together in zip(pictures(one), pictures(three), strict=True):
        assert np.abs(alone - together).max() <= 1.01 / 255
    events = json.loads((tmp_path / "t.json").read_text())["traceEvents"]
    assert {event["pid"] for event in events} == {0, 1, 2}
    (three / "f2.png").unlink()
    ended = finish(failing(1, "clusterviz.render.renderer_cache:RendererCache.draw", "raise", 3, *command))
    assert ended.status == 1
    assert "rank 1, frame 2, render: ValueError: odd" in ended.err
    assert names(three) == ["f.animation.json", "f0.png", "f1.png"]


@pytest.mark.fresh
def test_a_movie_may_be_a_gif(cli: Callable[..., Any], tmp_path: Path) -> None:
    movie = tmp_path / "a.gif"
    orbit = ("--orbit", "90", "--frames", "3", "--size", "24x18", "--device", "cpu")
    assert cli("animate", "field:marschner-lobb:16", "-o", str(movie), *orbit).status == 0
    with Image.open(movie) as file:
        assert (file.size, getattr(file, "n_frames", 1), file.info["duration"]) == ((24, 18), 3, 40)
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]


def test_time_steps_become_frames_with_colours_and_a_camera_for_all(cli: Run, tmp_path: Path) -> None:
    z, _, x = np.indices((12, 12, 12))
    for n in range(3):
        np.save(tmp_path / f"a_{n}.npy", ((200 + n) * (abs(x - 2 - 3 * n) < 2) * (z < 4)).astype(np.float32))
    store = str(tmp_path / "a.ome.zarr")
    cli("store", f"{tmp_path}/a_*.npy", store)
    common = ("--size", "32x24", "--device", "cpu")
    for name, arguments in {
        "s": (store, "--time"),
        "f": (store, "-D", "volumes.0.time=all", "--orbit", "90", "--frames", "5"),
    }.items():
        outcome = cli("animate", *arguments, *common, "-o", str(tmp_path / f"{name}_%d.png"))
        assert outcome.status == 0, outcome.err
    found = {path.stem: read_image(path) for path in tmp_path.glob("*.png")}
    assert sorted(found) == ["f_0", "f_1", "f_2", "f_3", "f_4", "s_0", "s_1", "s_2"]
    columns = [found[f"s_{n}"][..., :3].std(axis=(0, 2)).argmax() for n in range(3)]
    assert columns == sorted(set(columns), reverse=True)  # it moves to the left, and stays in the picture
    assert not any(np.array_equal(found[f"f_{n}"], found[f"f_{n + 1}"]) for n in range(4))
