"""Asynchronous compositing: same pictures and counts, overlap in time, and failures that end all ranks."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from failures.jobs import FIELD, SMALL, failing, finish
from frame.views import pixels

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.errors import RankError
from clusterviz.frame import FrameLoop, Options, Rendered, Run
from clusterviz.frame.compositing import Compositing
from clusterviz.render.renderer_cache import RendererCache
from clusterviz.report.provenance import Provenance
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

FIRST = scene_of_data("field:gaussian:16", ["image.size=[24,18]", "cluster.brick=8"])
CAMERAS = ((60.0, 10.0, 5.0), (-40.0, 30.0, 9.0), (7.0, 7.0, -50.0), (8.0, 7.0, 6.0))
COUNTED = ("bricks", "bricks_drawn", "voxels", "samples", "bytes_raw", "bytes_sent", "messages_sent")


def scenes(**settings: Any) -> list[Scene]:
    """A camera each, and one that sees nothing; what is counted shall not depend on what was measured."""
    views = [{"position": camera, "focal_point": (7.5, 7.5, 7.5)} for camera in CAMERAS]
    views.insert(2, {"position": CAMERAS[0], "focal_point": (90.0, 10.0, 5.0)})
    return [with_settings(FIRST, {"mode": "sort-last"} | view | settings) for view in views]


def draw(channel: Channel, views: list[Scene], **options: Any) -> list[Rendered]:
    with FrameLoop(views[0], channel, options=Options(**options)) as loop:
        return list(loop.frames(enumerate(views)))


def waiting_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "compositing"]


def check_consistency(overlapped: list[Rendered], alone: list[Rendered]) -> None:
    """Pictures bit for bit, and everything that is counted."""
    assert len(overlapped) == len(alone) == len(CAMERAS) + 1
    for number, (one, other) in enumerate(zip(overlapped, alone, strict=True)):
        assert one.statistics.number == other.statistics.number == number
        assert np.array_equal(pixels(one), pixels(other))
        for mine, plain in zip(one.statistics.per_rank, other.statistics.per_rank, strict=True):
            assert [getattr(mine, name) for name in COUNTED] == [getattr(plain, name) for name in COUNTED]
            assert mine.seconds["total"] >= mine.seconds["render"]


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize(
    ("ranks", "settings"),
    [
        (1, {}),
        (3, {}),
        (3, {"blending": "average", "transport": "messages"}),
        (3, {"distribution": "dynamic", "migration_share": 1.0, "opacity": [[0.3, 0.0], [1.0, 0.5]]}),
    ],
    ids=str,
)
def test_pictures_and_counts_are_those_without_overlap(ranks: int, settings: dict[str, Any]) -> None:
    written: list[int] = []

    def run(channel: LoopbackChannel) -> tuple[list[Rendered], list[Rendered]]:
        views = scenes(**settings)
        write = lambda image, scene, made: written.append(made.number)  # noqa: E731
        return draw(channel, views, write=write), draw(channel, views, overlap=False)

    check_consistency(*run_loopback(ranks, run)[0])
    assert written == list(range(len(CAMERAS) + 1))
    assert waiting_threads() == []


@pytest.mark.gl
@pytest.mark.mpi(ranks=[3], timeout=60)
def test_over_mpi_with_rows_of_their_own_in_the_trace(mpi_ranks: int) -> None:
    channel = MpiChannel(several_threads=True)
    overlapped, alone = (draw(channel, scenes(), overlap=overlap, trace=True) for overlap in (True, False))
    if channel.rank == 0:
        check_consistency(overlapped, alone)
        assert len(overlapped[0].statistics.per_rank) == mpi_ranks
    for frames, rows in ((overlapped, {"", "compositing"}), (alone, {""})):
        assert {span.row for rendered in frames for span in rendered.spans} == rows
    composited = [span for rendered in overlapped for span in rendered.spans if span.name == "composite"]
    assert {span.row for span in composited} == {"compositing"}
    channel.close()


@pytest.mark.gl
def test_a_frame_is_composited_while_the_next_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    meeting = threading.Barrier(2, timeout=20)
    right_draw, right_picture, draws = RendererCache.draw, Compositing.picture, list[int]()

    def draw_and_meet(caster: RendererCache, *arguments: Any) -> Any:
        draws.append(1)
        if len(draws) == 2:
            meeting.wait()
        return right_draw(caster, *arguments)

    def composite_and_meet(compositing: Compositing, run: Run, *arguments: Any) -> Any:
        if run.frame == 0:
            meeting.wait()
        return right_picture(compositing, run, *arguments)

    monkeypatch.setattr(RendererCache, "draw", draw_and_meet)
    monkeypatch.setattr(Compositing, "picture", composite_and_meet)
    assert len(draw(LoopbackChannel(), scenes())) == len(CAMERAS) + 1


@pytest.mark.gl
@pytest.mark.parametrize(
    ("ranks", "failing_draw", "failing_write", "said", "kept"),
    [
        (2, 3, None, "rank 0, frame 2, render: ValueError: odd", [0, 1]),
        (3, None, 1, "rank 0, frame 1, write: OSError: full", [0]),
    ],
    ids=["drawing the next", "writing"],
)
def test_what_fails_is_raised_on_all_ranks_and_earlier_frames_are_kept(
    ranks: int,
    failing_draw: int | None,
    failing_write: int | None,
    said: str,
    kept: list[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right, written, own = RendererCache.draw, list[int](), threading.local()

    def fail_later(caster: RendererCache, *arguments: Any) -> Any:
        own.calls = getattr(own, "calls", 0) + 1
        if own.calls == failing_draw:
            raise ValueError("odd")
        return right(caster, *arguments)

    def write(image: Any, scene: Scene, made: Provenance) -> None:
        if made.number == failing_write:
            raise OSError("full")
        written.append(made.number)

    def run(channel: LoopbackChannel) -> str:
        with pytest.raises(RankError) as error:
            draw(channel, scenes(), write=write)
        return str(error.value)

    monkeypatch.setattr(RendererCache, "draw", fail_later)
    assert run_loopback(ranks, run) == [said] * ranks
    assert written == kept
    assert waiting_threads() == []


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize(
    ("rank", "place", "said"),
    [
        (1, "clusterviz.composite.compositor:Compositor.composite", "rank 1, frame 0, composite: ValueError: odd"),
        (2, "clusterviz.frame.compositing:Compositing.gather", "rank 2: ValueError: odd"),
        (0, "clusterviz.cli.animate:_Animation.write", "rank 0, frame 0, write: ValueError: odd"),
    ],
)
def test_what_fails_in_one_thread_of_one_rank_ends_the_job(rank: int, place: str, said: str, tmp_path: Path) -> None:
    command = ("animate", FIELD, "-o", str(tmp_path / "f%d.png"), *SMALL, "--orbit", "90", "--frames", "4")
    ended = finish(failing(rank, place, "raise", 3, *command), 40)
    assert ended.status == 1
    messages = [line for line in ended.err.splitlines() if line.startswith("clusterviz: ")]
    assert len(messages) == 1, ended.err
    assert said in messages[0]
