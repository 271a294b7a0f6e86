"""One rank that fails in any stage, is killed, or is interrupted: the whole job ends, soon, with one message."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest
from failures.jobs import FIELD, SMALL, check_failure, failing, finish, messages_of, start

from clusterviz.data import open_source
from clusterviz.errors import DataError

pytestmark = [pytest.mark.fresh, pytest.mark.gl]
SECONDS = 10


@pytest.fixture(autouse=True)
def _by_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw by OpenGL, which is to fail, with or without a GPU."""
    monkeypatch.setenv("CLUSTERVIZ_EGL_DEVICE", "0")


AGREED = [
    ("scene", 1, "clusterviz.cli.render:open_scene"),
    ("open", 1, "clusterviz.content.volume.opening:open_first_parts"),
    ("read", 1, "clusterviz.content.volume.opening:read_bricks"),
    ("plan", 1, "clusterviz.frame.opening:make_plan"),
    ("context", 1, "clusterviz.gl.context:open_context"),
    ("shaders", 1, "clusterviz.render.caster:Caster.__init__"),
    ("upload", 1, "clusterviz.render.caster:Caster.load"),
    ("render", 1, "clusterviz.render.caster:Caster.draw"),
    ("output", 0, "clusterviz.cli.render:check_writable"),
    ("check", 0, "clusterviz.frame.compositing:compare"),
    ("write", 0, "clusterviz.cli.render:write_picture"),
    ("kernels", 1, "clusterviz.frame.compositing:compile_kernels"),
]
"""Stages at whose end all ranks agree on the outcome, so that they live on; and one that ends the job."""
COLLECTIVE = [
    ("summarise", 1, "clusterviz.content.volume.opening:summarise"),
    pytest.param("composite", 1, "clusterviz.composite.compositor:share_images", marks=pytest.mark.long),
    ("composite", 2, "clusterviz.composite.compositor:blend_strip"),
    pytest.param("composite", 1, "clusterviz.composite.compositor:collect", marks=pytest.mark.long),
    ("check", 1, "clusterviz.frame.compositing:collect"),
]


def test_all_ranks_agree_on_what_one_raises(tmp_path: Path) -> None:
    """One job does it in all stages."""
    ranks, places = (",".join(str(row[n]) for row in AGREED) for n in (1, 2))
    ended = finish(failing(ranks, places, "raise", 2, "render", FIELD, "-o", f"{tmp_path}/a.png", "--check", *SMALL))
    told = [re.sub("clusterviz: (?:error: )?(.*): ValueError: odd.*", r"\1", each) for each in messages_of(ended)]
    assert (ended.status, told) == (1, [f"rank {rank}, frame 0, {stage}" for stage, rank, _ in AGREED])
    assert "the picture is" not in ended.out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("stage", "rank", "place"), COLLECTIVE)
def test_a_rank_that_raises_ends_the_job(stage: str, rank: int, place: str, tmp_path: Path) -> None:
    job = failing(rank, place, "raise", rank + 1, "render", FIELD, "-o", str(tmp_path / "a.png"), "--check", *SMALL)
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
    ended = finish(failing(1, f"clusterviz.migration.wire_format:WireFormat.{place}", how, 2, *arguments), SECONDS)
    assert ended.status != 0
    messages = messages_of(ended)
    if how == "raise":
        assert len(messages) == 1
        assert re.search(r"rank 1, frame [123], migrate: ValueError: odd", messages[0])


def test_a_rank_that_decides_otherwise_ends_the_job_before_a_wrong_picture(tmp_path: Path) -> None:
    arguments = ("animate", FIELD, "-o", str(tmp_path / "f_%d.png"), *MOVING)
    ended = finish(failing(1, "clusterviz.distribution.dynamic:expected_samples", "turn", 2, *arguments))
    (message,) = messages_of(ended)
    assert ended.status == 1
    assert "rank 1, frame 0, compare: decides otherwise than the other ranks who draws what; all ranks" in message
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
    ended = finish(start(1, "-m", "clusterviz", *arguments))
    assert (ended.status, ended.err) == (0, "")
    whole = [open_source(name).read((0, 0, 0), (16, 16, 16)) for name in (path, FIELD)]
    assert (whole[0] == whole[1]).all()


DRAW, COLLECT = "clusterviz.render.caster:Caster.draw", "clusterviz.composite.compositor:collect"


@pytest.mark.parametrize(
    ("number", "ranks", "how", "place"),
    [
        pytest.param(None, 2, "kill", DRAW, marks=pytest.mark.long),
        (None, 2, "kill", COLLECT),
        # Ctrl-C in a terminal reaches all processes of the foreground.
        pytest.param("all", 1, "native", DRAW, marks=pytest.mark.long),
        ("all", 1, "delete", DRAW),
        ("all", 2, "wait", DRAW),
        pytest.param("all", 2, "wait", COLLECT, marks=pytest.mark.long),
        (signal.SIGINT, 2, "wait", "clusterviz.cli.instrumentation:_process_age"),  # before MPI is started
        (signal.SIGINT, 2, "native", "clusterviz.image.replace:_flush_to_disk"),
        # Of rank 1 alone, which must say it itself.
        pytest.param(-signal.SIGINT, 2, "wait", DRAW, marks=pytest.mark.long),
        (-signal.SIGINT, 2, "native", DRAW),
        pytest.param(-signal.SIGINT, 2, "wait", "clusterviz.cli.instrumentation:_process_age", marks=pytest.mark.long),
        (signal.SIGTERM, 2, "wait", DRAW),
        (signal.SIGHUP, 2, "native", DRAW),
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
    messages_of(ended)
    assert ("interrupted once more" in ended.out) == (how == "delete")
    assert list(tmp_path.iterdir()) == []
