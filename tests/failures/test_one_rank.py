"""One rank that fails in any stage, is killed, or is interrupted: the whole job ends, soon, with one message."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest
from failures.jobs import FIELD, SMALL, check_failure, failing, finish, start

from clusterviz.data import open_source
from clusterviz.errors import DataError

pytestmark = [pytest.mark.fresh, pytest.mark.gl]
SECONDS = 10


@pytest.fixture(autouse=True)
def _by_opengl(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw by OpenGL where it is to fail, with or without a GPU; other tests draw by whatever is chosen."""
    callspec = getattr(request.node, "callspec", None)
    if callspec and any(name in str(callspec.params.get("place")) for name in ("gl.context", "raycast")):
        monkeypatch.setenv("CLUSTERVIZ_EGL_DEVICE", "0")


STAGES = [
    ("scene", 1, "clusterviz.cli.render:open_scene"),
    ("output", 0, "clusterviz.cli.render:check_writable"),
    ("open", 1, "clusterviz.content.volume.opening:open_first_parts"),
    ("read", 1, "clusterviz.content.volume.opening:read_bricks"),
    ("summarise", 1, "clusterviz.content.volume.opening:summarise"),
    ("plan", 1, "clusterviz.content.volume.opening:make_plan"),
    ("context", 1, "clusterviz.gl.context:open_context"),
    ("shaders", 1, "clusterviz.render.raycast:Raycaster.__init__"),
    ("upload", 1, "clusterviz.render.raycast:Raycaster.load"),
    ("render", 1, "clusterviz.render.raycast:Raycaster.draw"),
    ("kernels", 1, "clusterviz.frame.compositing:compile_kernels"),
    ("composite", 1, "clusterviz.composite.compositor:share_images"),
    ("composite", 2, "clusterviz.composite.compositor:blend_strip"),
    ("composite", 1, "clusterviz.composite.compositor:collect"),
    ("check", 1, "clusterviz.frame.compositing:collect"),
    ("check", 0, "clusterviz.frame.compositing:compare"),
    ("write", 0, "clusterviz.cli.render:write_picture"),
]


@pytest.mark.cover(
    "output-0-clusterviz.cli.render:check_writable",
    "open-1-clusterviz.content.volume.opening:open_first_parts",
    "summarise-1-clusterviz.content.volume.opening:summarise",
    "shaders-1-clusterviz.render.raycast:Raycaster.__init__",
    "upload-1-clusterviz.render.raycast:Raycaster.load",
    "composite-1-clusterviz.composite.compositor:share_images",
    "composite-1-clusterviz.composite.compositor:collect",
    "check-0-clusterviz.frame.compositing:compare",
)
@pytest.mark.parametrize(("stage", "rank", "place"), STAGES)
def test_a_rank_that_raises_ends_the_job(stage: str, rank: int, place: str, tmp_path: Path) -> None:
    job = failing(rank, place, "raise", 3, "render", FIELD, "-o", str(tmp_path / "a.png"), "--check", *SMALL)
    check_failure(finish(job), 1, f"rank {rank}, frame 0, {stage}: ValueError: odd", tmp_path)


MOVING = (
    *("--orbit", "60", "--frames", "4", "--size", "24x18"),
    *("-D", "cluster.distribution=dynamic", "-D", "cluster.migration_share=1", "-D", "cluster.brick=2"),
    *("-D", "camera.position=[-1.8,-1.5,-1.7]", "-D", "camera.focal_point=[-0.5,-0.4,-0.5]"),
)


@pytest.mark.cover
@pytest.mark.parametrize("place", ["wrap", "unwrap"])
@pytest.mark.parametrize("how", ["raise", "kill"])
def test_a_rank_that_fails_while_bricks_are_under_way_ends_the_job(place: str, how: str, tmp_path: Path) -> None:
    arguments = ("animate", FIELD, "-o", str(tmp_path / "f_%d.png"), *MOVING)
    ended = finish(failing(1, f"clusterviz.migration.wire_format:WireFormat.{place}", how, 3, *arguments), SECONDS)
    assert ended.status != 0
    assert "Traceback" not in ended.err + ended.out
    if how == "raise":
        messages = [line for line in ended.err.splitlines() if line.startswith("clusterviz: ")]
        assert len(messages) == 1
        assert re.search(r"rank 1, frame [123], migrate: ValueError: odd", messages[0])


def test_a_rank_that_decides_otherwise_ends_the_job_before_a_wrong_picture(tmp_path: Path) -> None:
    arguments = ("animate", FIELD, "-o", str(tmp_path / "f_%d.png"), *MOVING)
    ended = finish(failing(1, "clusterviz.distribution.dynamic:expected_samples", "turn", 3, *arguments))
    messages = [line for line in ended.err.splitlines() if line.startswith("clusterviz: ")]
    assert (ended.status, len(messages)) == (1, 1)
    assert "rank 1, frame 0, compare: decides otherwise than the other ranks who draws what; all ranks" in messages[0]
    assert "Traceback" not in ended.err + ended.out
    assert list(tmp_path.glob("*.png")) == []


def test_statistics_that_cannot_be_made_leave_no_file(tmp_path: Path) -> None:
    arguments = ("render", FIELD, "-o", str(tmp_path / "a.npy"), "--stats", str(tmp_path / "s.json"), *SMALL)
    ended = finish(failing(0, "clusterviz.cli.instrumentation:statistics_file", "raise", 2, *arguments))
    assert (ended.status, "rank 0, frame 0, statistics: ValueError: odd" in ended.err) == (1, True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npy"]


def test_a_rank_that_fails_leaves_a_store_that_other_ranks_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    arguments = ("store", FIELD, str(path), "--brick", "8")
    ended = finish(failing(1, "clusterviz.data.store.writer:StoreWriter.write", "raise", 2, *arguments))
    assert (ended.status, "rank 1, frame 0, level 0: ValueError: odd" in ended.err) == (1, True)
    with pytest.raises(DataError, match="half written"):
        open_source(path)
    ended = finish(start(3, "-m", "clusterviz", *arguments))
    assert (ended.status, ended.err) == (0, "")
    whole = [open_source(name).read((0, 0, 0), (16, 16, 16)) for name in (path, FIELD)]
    assert (whole[0] == whole[1]).all()


DRAW, COLLECT = "clusterviz.render.raycast:Raycaster.draw", "clusterviz.composite.compositor:collect"


@pytest.mark.cover
@pytest.mark.parametrize(
    ("number", "ranks", "how", "place"),
    [
        (None, 3, "kill", DRAW),
        (None, 3, "kill", COLLECT),
        # Ctrl-C in a terminal reaches all processes of the foreground.
        ("all", 1, "native", DRAW),
        ("all", 1, "delete", DRAW),
        ("all", 3, "wait", DRAW),
        ("all", 3, "wait", COLLECT),
        (signal.SIGINT, 3, "wait", "clusterviz.cli.instrumentation:_process_age"),  # before MPI is started
        (signal.SIGINT, 3, "native", "clusterviz.image.replace:_flush_to_disk"),
        # Of rank 1 alone, which must say it itself.
        (-signal.SIGINT, 3, "wait", DRAW),
        (-signal.SIGINT, 3, "native", DRAW),
        (-signal.SIGINT, 3, "wait", "clusterviz.cli.instrumentation:_process_age"),
        (signal.SIGTERM, 3, "wait", DRAW),
        (signal.SIGHUP, 3, "native", DRAW),
    ],
)
def test_a_rank_that_is_killed_or_signalled_ends_the_job(
    number: int | str | None, ranks: int, how: str, place: str, tmp_path: Path
) -> None:
    alone = isinstance(number, int) and number < 0
    rank = ranks - 1 if number == "all" else 1 if how == "kill" or alone else 0
    job = failing(rank, place, how, ranks, "render", FIELD, "-o", str(tmp_path / "a.png"), *SMALL)
    if number is not None:
        assert job.stdout is not None
        pid = int(job.stdout.readline().removeprefix("waiting "))
        if isinstance(number, int):
            os.kill(pid, abs(number))
        else:
            os.killpg(job.pid, signal.SIGINT)
    ended = finish(job, SECONDS)
    assert ended.status != 0
    assert ended.err.count("clusterviz: interrupted") == (number is not None)
    assert "Traceback" not in ended.err + ended.out
    assert ("interrupted once more" in ended.out) == (how == "delete")
    assert list(tmp_path.iterdir()) == []
