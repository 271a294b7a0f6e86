"""scale: a self-contained page and its numbers, or nothing after a failure."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli.pages import check_page

from clusterviz.cli import scale
from clusterviz.cli.scale import threads_per_rank
from clusterviz.comm.placement import THREAD_VARIABLES
from clusterviz.errors import ClustervizError
from clusterviz.pages.scale.measure import Measured, RankResources
from clusterviz.report.statistics import STAGES, RankFrame
from clusterviz.scene import Scene

FIELD = "field:gaussian:12"
SMALL = ("--size", "32x24", "--frames", "1", "-D", "cluster.brick=4")
KEYS = {"clusterviz", "scene", "size", "frames", "threads_per_rank", "verdict", "strong", "weak", "failed"}
KEYS |= {"prediction", "environment", "balance"}


@pytest.mark.fresh
@pytest.mark.gl
def test_page_and_numbers(cli: Callable[..., Any], tmp_path: Path) -> None:
    out = tmp_path / "out"
    outcome = cli("scale", FIELD, "-o", str(out), "--ranks", "2,1", *SMALL)
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.startswith("The bottleneck is ")
    names = sorted(path.name for path in tmp_path.rglob("*"))
    assert names == ["balance.csv", "index.html", "out", "scale.csv", "scale.json"]
    numbers = json.loads((out / "scale.json").read_text())
    assert set(numbers) == KEYS
    assert [point["ranks"] for point in numbers["strong"]] == [point["ranks"] for point in numbers["weak"]] == [1, 2]
    assert numbers["failed"] == []
    assert [point["step"] for point in numbers["weak"]] == [1, pytest.approx(1 / 2)]
    one, two = numbers["strong"]
    assert set(STAGES) <= set(one["seconds"])
    assert one["rounds"] == []
    assert sum(one["samples"]) == sum(two["samples"]) > 0
    assert 1.7 < sum(numbers["weak"][1]["samples"]) / sum(one["samples"]) < 2.3
    assert all(each["agrees"] and each["messages"] > 0 for each in two["rounds"])
    assert 0 < sum(each["bytes"] for each in two["rounds"]) <= two["bytes_dense"]
    assert two["difference"]["count"] == 0
    assert len(two["peak_memory_bytes"]) == 2
    assert numbers["environment"]["size"] == 2
    assert [each["ranks"] for each in numbers["prediction"]["strong"]] == [2**k for k in range(17)]
    rows = list(csv.DictReader((out / "scale.csv").open()))
    assert [row["ranks"] for row in rows] == ["1", "2"] * 2
    page = (out / "index.html").read_text()
    assert check_page(page) == []
    assert page.count("<svg") == 5
    assert [(one["distribution"], one["ranks"]) for one in numbers["balance"]] == [("coherent", 2), ("dynamic", 2)]
    assert "After 12 frames of an orbit, the busiest of 2 ranks takes" in outcome.out
    lines = list(csv.DictReader((out / "balance.csv").open()))
    assert [line["frame"] for line in lines] == [str(number) for number in range(12)] * 2
    for one in numbers["balance"]:
        assert all(1 <= each <= 2 for each in one["imbalance_samples"])
        told = [line["imbalance_samples"] for line in lines if line["distribution"] == one["distribution"]]
        assert told == [str(each) for each in one["imbalance_samples"]]


def measured(ranks: int, step: float, seconds: float) -> Measured:
    """What a job says in which each rank draws a tenth of a strip that all cover."""
    stages = dict.fromkeys(STAGES, 0.0) | {"render": seconds / ranks, "total": seconds / ranks + 0.01, "cpu": seconds}
    frame = [RankFrame(dict(stages), bricks=1, samples=1200 // ranks, peak_memory_bytes=100) for _ in range(ranks)]
    once = [dict.fromkeys(("plan", "load", "context", "shaders"), 0.1)] * ranks
    resources = [RankResources("here", tuple(range(4)), None)] * ranks
    rects = [(0, 0, 32, 24)] * ranks
    return Measured(
        [frame], once, 0.1, resources, list(range(ranks)), rects, "serial", [[]] * ranks, (32, 24), step, 16
    )  # fmt: skip


@pytest.fixture
def jobs(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, int]]:
    """Steps and ranks of the jobs that were asked for; three ranks fail, and two make another picture."""
    asked: list[tuple[float, int]] = []

    def draw(self: scale.MpirunJob, scene: Scene, ranks: int, orbit: bool = False) -> tuple[Measured, Any]:
        if not orbit:
            asked.append((scene.quality.step, ranks))
        (self.folder / scale.RESULT).write_text(json.dumps({"scene": scene.model_dump(mode="json")}))
        if ranks == 3:
            raise ClustervizError("on 3 ranks: rank 2 was killed <here>")
        return measured(ranks, scene.quality.step, 0.4), np.full((24, 32, 4), 0.1 * (ranks == 2), np.float32)

    monkeypatch.setattr(scale.MpirunJob, "__call__", draw)
    monkeypatch.setattr(scale, "run_job", lambda *_: json.dumps({"problem": "no doctor"}))
    return asked


def test_a_count_that_fails_is_told_and_takes_no_other_along(
    jobs: list[tuple[float, int]], cli: Callable[..., Any], tmp_path: Path
) -> None:
    outcome = cli("scale", FIELD, "-o", str(tmp_path / "out"), *SMALL, "--ranks", "1,2,3,4", "--no-weak")
    assert (outcome.status, outcome.err) == (0, "")
    assert jobs == [(1, 1), (1, 2), (1, 3), (1, 4)]
    numbers = json.loads((tmp_path / "out" / "scale.json").read_text())
    reason = "on 3 ranks: rank 2 was killed <here>"
    assert numbers["failed"] == [{"scaling": "strong", "ranks": 3, "reason": reason}]
    assert [point["ranks"] for point in numbers["strong"]] == [1, 2, 4]
    assert numbers["weak"] == numbers["prediction"]["weak"] == []
    page = (tmp_path / "out" / "index.html").read_text()
    assert "rank 2 was killed &lt;here&gt;" in page
    assert reason in outcome.out
    assert "THE PICTURES DISAGREE: by up to 1.0e-01 (2 ranks)" in page
    assert page.count("<svg") == 5


def test_distributions_are_compared_where_the_screen_is_shared_too(
    jobs: list[tuple[float, int]], cli: Callable[..., Any], tmp_path: Path
) -> None:
    options = ("--ranks", "1,2", "--no-weak", "-D", "cluster.mode=hybrid", "-D", "cluster.tiling=temporal")
    outcome = cli("scale", FIELD, "-o", str(tmp_path / "out"), *SMALL, *options)
    assert outcome.status == 0
    numbers = json.loads((tmp_path / "out" / "scale.json").read_text())
    assert (numbers["failed"], len(numbers["balance"])) == ([], 2)


def test_where_every_count_fails_nothing_is_left(
    jobs: list[tuple[float, int]], cli: Callable[..., Any], tmp_path: Path
) -> None:
    outcome = cli("scale", FIELD, "-o", str(tmp_path / "out"), *SMALL, "--ranks", "3")
    assert (outcome.status, outcome.err) == (1, "clusterviz: error: on 3 ranks: rank 2 was killed <here>\n")
    assert list(tmp_path.iterdir()) == []


def test_a_named_network_is_predicted_for(
    jobs: list[tuple[float, int]], cli: Callable[..., Any], tmp_path: Path
) -> None:
    options = ("--network", "infiniband-200g", "--ranks-per-node", "8", "--ranks", "1")
    outcome = cli("scale", FIELD, "-o", str(tmp_path / "out"), *SMALL, *options)
    assert outcome.status == 0
    prediction = json.loads((tmp_path / "out" / "scale.json").read_text())["prediction"]
    assert prediction["networks"]["one_node"] == prediction["networks"]["several_nodes"]
    assert prediction["ranks_per_node"] == 8
    assert "200 Gb/s InfiniBand" not in prediction["other_networks"]
    assert len(prediction["other_networks"]) == 1


@pytest.mark.parametrize(
    ("counts", "threads"), [([1], "8"), ([1, 2, 4], "2"), ([1, 8, 32], "1"), ([3], "2"), ([16, 32], "1")]
)
def test_threads_stay_the_same_at_every_count(counts: list[int], threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(scale, "granted_cores", lambda: frozenset(range(8)))
    assert threads_per_rank(counts) == threads
    monkeypatch.setenv("LP_NUM_THREADS", "3")
    assert threads_per_rank(counts) == ""
