"""Traces: rows, nested spans, and synchronised clocks."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import pytest

from clusterviz.comm import run_loopback
from clusterviz.frame import FrameLoop, Options
from clusterviz.report import trace
from clusterviz.report.trace import ClockOffset, RankTrace, Span, composition_spans, measure_offset, write_trace
from clusterviz.scene import scene_of_data

AT_ONCE = ClockOffset(0.0, 0.0, 0.0)
SCENE = scene_of_data("field:gaussian:16", ["image.size=[24,18]", "cluster.brick=8", "cluster.transport=messages"])


def check_nested(spans: list[dict[str, Any]]) -> None:
    """Of two spans of a row, one holds the other, or they do not meet; microseconds, rounded by float64 alone."""
    open_ends: list[float] = []
    for span in sorted(spans, key=lambda span: (span["ts"], -span["dur"])):
        while open_ends and open_ends[-1] <= span["ts"] + 1e-3:
            open_ends.pop()
        assert all(span["ts"] + span["dur"] <= end + 1e-3 for end in open_ends), span
        open_ends.append(span["ts"] + span["dur"])


@pytest.mark.gl
def test_a_trace_has_one_row_a_rank_and_nested_spans(tmp_path: Path) -> None:
    def draw(channel: Any) -> RankTrace:
        before = measure_offset(channel)
        with FrameLoop(SCENE, channel, options=Options(trace=True)) as loop:
            spans = [span for number in range(2) for span in loop.frame(number=number).spans]
        return RankTrace(tuple(spans), before, measure_offset(channel))

    write_trace(tmp_path / "t.json", run_loopback(3, draw))
    told = json.loads((tmp_path / "t.json").read_text())
    events = told["traceEvents"]
    names = {event["pid"]: event["args"]["name"] for event in events if event["name"] == "process_name"}
    assert names == {0: "rank 0", 1: "rank 1", 2: "rank 2"}
    assert {event["tid"] for event in events} == {0}
    for rank in range(3):
        spans = [event for event in events if event["pid"] == rank and event["ph"] == "X"]
        check_nested(spans)
        assert min(span["ts"] for span in spans) >= 0
        assert min(span["dur"] for span in spans) >= 0
        assert {"open", "read", "summarise", "plan", "frame 0", "frame 1", "composite", "collect"} <= {
            span["name"] for span in spans
        }
        frames = [span for span in spans if span["name"].startswith("frame")]
        assert frames[0]["ts"] + frames[0]["dur"] <= frames[1]["ts"]
    stages = [event for event in events if event["name"].startswith("stage")]
    sent = sum(peer["bytes_sent"] for stage in stages for peer in stage["args"]["peers"])
    assert sent == sum(stage["args"]["bytes_sent"] for stage in stages) > 0
    # Threads of one process have one clock.
    for offset in told["otherData"]["clock_offsets"]:
        assert abs(offset["seconds"]) <= offset["round_trip"] / 2 + 1e-6


def test_clocks_that_differ_are_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    ahead = threading.local()
    right = trace.perf_counter
    monkeypatch.setattr(trace, "perf_counter", lambda: right() + getattr(ahead, "seconds", 0.0))

    def measure(channel: Any) -> ClockOffset:
        ahead.seconds = 100.0 * channel.rank
        return measure_offset(channel)

    for rank, offset in enumerate(run_loopback(4, measure)):
        assert abs(offset.seconds - 100.0 * rank) <= offset.round_trip / 2 + 1e-6
        assert offset.round_trip < 10


def test_drift_is_spread_over_the_time_between() -> None:
    rank = RankTrace((), ClockOffset(100.0, 10.0, 0.0), ClockOffset(200.0, 12.0, 0.0))
    assert rank.on_clock_of_rank_0(100.0) == 90.0
    assert rank.on_clock_of_rank_0(150.0) == 139.0
    assert rank.on_clock_of_rank_0(200.0) == 188.0


def test_stages_that_are_said_to_last_too_long_stay_in_their_composition() -> None:
    stage = {"seconds_encode": 3.0, "seconds_wait": 4.0, "seconds_blend": 5.0, "peers": ()}
    stage |= dict.fromkeys(("messages_sent", "pixels_sent", "bytes_raw", "bytes_sent"), 0)
    counted = {"seconds_agree": 1.0, "stages": (stage,), "seconds_collect": 1.0, "bytes_collected": 0}
    spans = list(composition_spans(10.0, 15.0, counted))
    assert [span.name for span in spans] == ["composite", "agree", "stage 0", "encode", "wait", "collect"]
    assert max(span.end for span in spans) == 15.0


def test_rows_begin_at_the_first_span_of_all_ranks(tmp_path: Path) -> None:
    late = RankTrace(
        (Span("b", "x", 1007.0, 1008.0),), ClockOffset(1000.0, 1000.0, 0.0), ClockOffset(1001.0, 1000.0, 0)
    )
    write_trace(tmp_path / "t.json", [RankTrace((Span("a", "x", 5.0, 6.0),), AT_ONCE, AT_ONCE), late])
    events = json.loads((tmp_path / "t.json").read_text())["traceEvents"]
    assert {event["name"]: event["ts"] for event in events if event["ph"] == "X"} == {"a": 0.0, "b": 2e6}
