"""The frame loop: what it reports, in which order, and how it fails."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz import frame
from clusterviz.comm import run_loopback
from clusterviz.data.memory import ArraySource
from clusterviz.errors import ClustervizError, DataError, RankError
from clusterviz.frame import STEPS, Options, Rendered, render_frame
from clusterviz.report.statistics import STAGES, statistics_file
from clusterviz.scene import Scene, Volume, scene_of_data
from clusterviz.scene.settings import with_settings

SCENE = scene_of_data("field:gaussian:16", ["image.size=[24,18]", "cluster.brick=8"])


def draw(ranks: int, **options: Any) -> list[Rendered]:
    return run_loopback(ranks, lambda channel: render_frame(SCENE, channel, options=Options(**options)))


@pytest.mark.gl
def test_every_rank_hears_of_every_step_in_order() -> None:
    heard: dict[int, list[str]] = {}

    def render(channel: Any) -> None:
        steps = heard.setdefault(channel.rank, [])
        render_frame(SCENE, channel, options=Options(check=True, progress=steps.append))

    run_loopback(3, render)
    for steps in heard.values():
        assert list(dict.fromkeys(steps)) == list(STEPS)
        assert [STEPS.index(step) for step in steps] == sorted(STEPS.index(step) for step in steps)


@pytest.mark.gl
def test_statistics_name_every_stage_and_count_what_was_done() -> None:
    rendered = draw(3)[0]
    report = statistics_file(rendered.scene.image.size, [rendered.statistics], {"imports": 1.0})
    (told,) = report["frames"]
    assert (report["ranks"], report["size"]) == (3, [24, 18])
    assert report["renderer"]
    assert set(told["seconds"]) >= {*STAGES, "total"}
    assert sum(rank["voxels"] for rank in told["per_rank"]) >= 16**3
    assert sum(rank["bricks"] for rank in told["per_rank"]) == 8
    assert sum(rank["samples"] for rank in told["per_rank"]) > 0
    assert sum(rank["messages_sent"] for rank in told["per_rank"]) > 0
    assert told["imbalance"] >= 1
    for rank in told["per_rank"]:
        assert all(seconds >= 0 for seconds in rank["seconds"].values())
        spent = sum(seconds for name, seconds in rank["seconds"].items() if name != "total")
        assert spent <= rank["seconds"]["total"]


@pytest.mark.gl
def test_the_picture_is_given_to_write_on_rank_0_only() -> None:
    written: list[tuple[int, ...]] = []
    draw(3, write=lambda image, scene: written.append(image.shape))
    assert written == [(18, 24, 4)]


@pytest.mark.gl
def test_the_source_is_read_brick_by_brick_and_no_more_than_needed() -> None:
    """A rank that owns an eighth of the volume never asks for the whole."""
    boxes: dict[int, int] = {}

    class Counting(ArraySource):
        rank = 0

        def read(self, begin_zyx: Any, end_zyx: Any) -> Any:
            boxes[self.rank] = boxes.get(self.rank, 0) + int(np.prod(np.subtract(end_zyx, begin_zyx)))
            return super().read(begin_zyx, end_zyx)

    voxels = np.random.default_rng(0).random((33, 33, 33))
    scene = with_settings(Scene(volumes=(Volume(path="array"),)), {"size": (24, 18), "brick": 8, "opacity": 0.1})

    def render(channel: Any) -> None:
        source = Counting(voxels)
        source.rank = channel.rank
        render_frame(scene, channel, source)

    run_loopback(8, render)
    assert sorted(boxes) == list(range(8))
    # Two layers of bricks, 9 planes of samples each.
    assert max(boxes.values()) <= 2 * 9 * 17 * 17


@pytest.mark.gl
def test_check_tells_a_wrong_compositing_from_a_right_one(monkeypatch: pytest.MonkeyPatch) -> None:
    right = frame.collect
    calls: list[int] = []

    def wrong(piece: Any, size: Any, channel: Any) -> Any:
        image = right(piece, size, channel)
        calls.append(1)
        if image is not None and len(calls) == 1:
            image[3, 4] += 0.5
        return image

    monkeypatch.setattr(frame, "collect", wrong)
    with pytest.raises(ClustervizError, match=r"serial compositing disagree: .* row 3, column 4"):
        draw(1, check=True)


def test_what_all_ranks_find_wrong_comes_out_as_it_is() -> None:
    missing = scene_of_data("none.npy")
    with pytest.raises(DataError, match="no such file"):
        run_loopback(3, lambda channel: render_frame(missing, channel))


@pytest.mark.gl
def test_what_one_rank_finds_wrong_is_raised_on_all() -> None:
    raised: dict[int, str] = {}

    class Broken(ArraySource):
        def read(self, begin_zyx: Any, end_zyx: Any) -> Any:
            raise DataError("ends early", where="a.npy")

    def render(channel: Any) -> None:
        source = (Broken if channel.rank == 1 else ArraySource)(np.zeros((16, 16, 16)))
        try:
            render_frame(SCENE, channel, source)
        except RankError as error:
            raised[channel.rank] = str(error)

    run_loopback(3, render)
    assert raised == dict.fromkeys(range(3), "rank 1, frame 0, read: a.npy: ends early")


@pytest.mark.gl
def test_a_share_larger_than_the_memory_is_read_again_and_gives_the_same_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = draw(2)[0]
    monkeypatch.setattr(frame, "HELD_SHARE_OF_MEMORY", 0.0)
    again = draw(2)[0]
    assert plain.image is not None
    assert again.image is not None
    np.testing.assert_array_equal(again.image, plain.image)
