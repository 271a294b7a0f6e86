"""render: a picture, a table and statistics, on one rank and on several."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clusterviz
from clusterviz.cli.instrumentation import print_cost_table, summary
from clusterviz.cli.jobs import job_command, run_job
from clusterviz.image import compare, read_image
from clusterviz.report.statistics import FrameStatistics, RankFrame

FIELD = "field:marschner-lobb:16"
SMALL = ("--size", "24x18", "-D", "cluster.brick=8")
STAGES = ("plan", "load", "render", "readback", "encode", "exchange", "blend", "collect", "finish", "total")


@pytest.mark.gl
@pytest.mark.parametrize("name", ["a.npy", "a.png", "a.exr"])
def test_a_bare_data_file_becomes_a_picture(name: str, cli: Callable[..., Any], tmp_path: Path) -> None:
    outcome = cli("render", FIELD, "-o", str(tmp_path / name), *SMALL)
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.endswith(f"the picture is {tmp_path / name}\n")
    assert "where the time went" in outcome.out
    assert "\x1b" not in outcome.out
    picture = read_image(tmp_path / name)
    assert picture.shape == (18, 24, 4)
    assert picture.max() > 0
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.gl
def test_layers_are_written_beside_the_colours_of_pictures_and_frames(cli: Callable[..., Any], tmp_path: Path) -> None:
    shown = (FIELD, *SMALL, "--layers", "object,depth", "-D", "volumes.0.opacity=0.5")
    assert cli("render", *shown, "-o", str(tmp_path / "a.npz")).status == 0
    with np.load(tmp_path / "a.npz") as arrays:
        assert list(arrays) == ["rgba", "depth", "object"]
        assert set(np.unique(arrays["object"])) == {-1, 0}
        depth, rgba = arrays["depth"], arrays["rgba"]
    outcome = cli("animate", *shown, "--orbit", "360", "--frames", "2", "-o", str(tmp_path / "frame_%d.npz"))
    assert (outcome.status, outcome.err) == (0, "")
    with np.load(tmp_path / "frame_1.npz") as arrays:
        assert arrays["depth"].shape == depth.shape
        assert np.isfinite(arrays["depth"]).any()
    image = clusterviz.render(FIELD, size=(24, 18), brick=8, opacity=0.5, layers=["depth"])
    assert image is not None
    assert list(image.layers) == ["depth"]
    assert np.array_equal(image.layers["depth"], depth)
    assert np.array_equal(image, rgba)


@pytest.mark.gl
def test_pictures_and_frames_are_annotated_on_demand(cli: Callable[..., Any], tmp_path: Path) -> None:
    shown = (FIELD, "--size", "160x130", "-D", "volumes.0.opacity=0")  # nothing else is visible

    def visible(*options: str) -> int:
        assert cli("render", *shown, *options, "-o", str(tmp_path / "a.npy")).status == 0
        return int(np.count_nonzero(read_image(tmp_path / "a.npy")[..., 3]))

    assert visible() == 0
    assert visible("--annotate") > visible("--annotate", "-D", "annotations={axes: false, outline: false}") > 500
    frames = ("--orbit", "90", "--frames", "2", "-o", str(tmp_path / "frame_%d.npz"))
    assert cli("animate", *shown, "--annotate", *frames).status == 0
    first, second = (read_image(tmp_path / f"frame_{number}.npz") for number in range(2))
    assert (first != second).any(axis=2).sum() > 500  # the axes turn
    assert np.array_equal(first[20:100, 135:], second[20:100, 135:])  # the bar stays
    assert first[20:100, 135:].any()


@pytest.mark.gl
def test_a_scene_file_with_overrides(cli: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(f"volumes: [{{path: '{FIELD}'}}]\nimage: {{background: [0, 0, 1]}}\n")
    arguments = ("-D", "volumes.0.opacity=0", "-D", "image.size=[9, 9]", "--size", "8x6", "--check")
    assert cli("render", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "a.png"), *arguments).status == 0
    assert np.array_equal(read_image(tmp_path / "a.png"), np.broadcast_to(np.float32([0, 0, 1, 1]), (6, 8, 4)))


@pytest.mark.fresh
@pytest.mark.gl
def test_several_ranks_give_the_same_picture_and_say_what_they_did(tmp_path: Path) -> None:
    picture, stats = tmp_path / "a.npy", tmp_path / "s.json"
    way = ("-D", "cluster.transport=messages", "-D", "cluster.compositing=tree")
    printed = {
        ranks: run_job(ranks, ["render", FIELD, "-o", str(picture), "--stats", str(stats), "--check", *SMALL, *way])
        and read_image(picture)
        for ranks in (1, 3)
    }
    assert compare(printed[1], printed[3], 1e-5).count == 0
    report = json.loads(stats.read_text())
    assert (report["ranks"], report["size"]) == (3, [24, 18])
    assert set(report["startup"]) == {"interpreter", "imports", "mpi"}
    assert all(seconds > 0 for seconds in report["startup"].values())
    (frame,) = report["frames"]
    assert set(frame["seconds"]) >= set(STAGES)
    assert len(frame["per_rank"]) == 3
    keys = ("bricks", "bricks_drawn", "voxels", "samples", "bytes_raw", "bytes_sent", "messages_sent")
    for rank in frame["per_rank"]:
        assert set(rank["seconds"]) >= set(STAGES)
        assert all(rank[key] > 0 for key in keys[:4])
        assert rank["peak_memory_bytes"] > 10 << 20
        compositing = rank["compositing"]
        assert (compositing["algorithm"], compositing["transport"]) == ("tree", "messages")
        assert compositing["seconds_predicted"] > 0
        assert compositing["seconds"] > 0
    assert sum(rank["messages_sent"] for rank in frame["per_rank"]) == 2
    assert frame["seconds"]["finish"] == frame["per_rank"][0]["seconds"]["finish"] > 0


@pytest.mark.fresh
@pytest.mark.gl
def test_a_launcher_of_another_mpi_is_refused(tmp_path: Path) -> None:
    environment = os.environ | {"OMPI_COMM_WORLD_SIZE": "4", "PMI_RANK": "0"}
    command = [sys.executable, "-m", "clusterviz", "render", FIELD, "-o", str(tmp_path / "a.png"), *SMALL]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment, check=False)
    assert (done.returncode, "mpirun started 4 processes, and mpi4py loads" in done.stderr) == (2, True), done.stderr


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_terminal_sees_a_progress_bar_and_gets_its_cursor_back(ranks: int, tmp_path: Path) -> None:
    try:
        ours, theirs = pty.openpty()
    except OSError as error:  # a root without /dev/pts
        pytest.skip(f"no terminal can be opened here: {error}")
    impatient = (
        "import sys; from clusterviz.cli import console, run; console.DELAY_SECONDS = 0.0; sys.exit(run(sys.argv[1:]))"
    )
    arguments = ["render", FIELD, "-o", str(tmp_path / "a.png"), *SMALL]
    command = [*job_command(ranks, [])[:-2], "-c", impatient, *arguments]
    environment = os.environ | {"TERM": "xterm-256color"}
    shown = ""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs, env=environment) as process:
        os.close(theirs)
        with suppress(OSError):  # Linux's way to say that nobody writes any more
            while text := os.read(ours, 1 << 16):
                shown += text.decode(errors="replace")
    os.close(ours)
    assert process.returncode == 0
    assert "render" in shown or "write" in shown
    assert shown.rfind("\x1b[?25h") > shown.rfind("\x1b[?25l")


@pytest.mark.fresh
def test_a_render_imports_only_what_it_needs(cli: Callable[..., Any], tmp_path: Path) -> None:
    """With kernels that are kept, neither what compiles them nor what draws otherwise."""
    arguments = ["render", FIELD, "-o", str(tmp_path / "a.png"), "--device", "cpu", *SMALL]
    assert cli(*arguments).status == 0
    script = f"""
import sys
from clusterviz.cli import run
status = run({arguments})
rooms = ("spmd.codegen", "render.opengl", "frame.moving", "frame.settling", "frame.mode", "data.tiff")
others = ("numba", "rich", "h5py", "nibabel", "matplotlib", "numpy.ma", "numpy.polynomial")
heavy = [name for name in (*others, *(f"clusterviz.{{room}}" for room in rooms)) if name in sys.modules]
sys.exit(f"imported {{heavy}}" if heavy else status)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def statistics(*render_seconds: float) -> FrameStatistics:
    return FrameStatistics(
        tuple(
            RankFrame({"load": 0.25, "render": seconds, "total": 5.0}, samples=1_000_000, bricks=4, bricks_drawn=3)
            for seconds in render_seconds
        )
    )


def test_the_table_adds_up(capsys: pytest.CaptureFixture[str]) -> None:
    print_cost_table(statistics(1.0, 4.0), {"imports": 0.5, "mpi": 0.0001})
    lines = capsys.readouterr().out.splitlines()
    table = {line[:26].strip(): [float(word) for word in line[26:].split() if word != "s"] for line in lines[1:-6]}
    assert table["start: imports"] == [0.5]
    assert "start: mpi" not in table
    assert table["load"] == [0.25, 0.25]
    assert table["render"] == [4.0, 2.5]
    assert table["waiting for other ranks"] == [3.75, 2.25]
    assert table["total, without the start"] == [5.0, 5.0]


def test_the_summary_counts_all_ranks() -> None:
    text = summary(statistics(1.0, 4.0))
    assert "imbalance 1.60" in text
    assert "2,000,000 (0.5 million a second), 6 of 8 bricks drawn" in text
    assert "none: no rank had anything to draw" in text
