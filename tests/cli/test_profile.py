"""profile: a self-contained page, its numbers and its maps."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli.pages import check_page

FIELD = "field:gaussian:24"
SMALL = ("--size", "32x24", "-D", "cluster.brick=8")
FILES = {"index.html", "maps.npz", "profile.json"}


def profile(cli: Callable[..., Any], folder: Path, *options: str) -> Any:
    """The numbers of a profile, which `--json` prints too."""
    outcome = cli("profile", FIELD, "-o", str(folder), *SMALL, *options, "--json")
    assert (outcome.status, outcome.err) == (0, "")
    numbers = json.loads((folder / "profile.json").read_text())
    assert json.loads(outcome.out) == numbers
    assert {path.name for path in folder.iterdir()} == FILES
    return numbers


def test_page_and_numbers(cli: Callable[..., Any], tmp_path: Path) -> None:
    numbers = profile(cli, tmp_path / "two", "--ranks", "2", "--by", "cpu")
    stats = tmp_path / "stats.json"
    assert (
        cli("render", FIELD, "-o", str(tmp_path / "a.png"), *SMALL, "--device", "cpu", "--stats", str(stats)).status
        == 0
    )
    (frame,) = json.loads(stats.read_text())["frames"]
    totals, ranks, code = numbers["totals"], numbers["ranks"], numbers["code"]
    assert totals["samples"] == sum(rank["samples"] for rank in frame["per_rank"]) > 0
    assert [rank["rank"] for rank in ranks] == [0, 1]
    assert all(totals[name] == sum(rank[name] for rank in ranks) for name in ("slabs", "samples", "skipped", "runs"))
    assert totals["slabs"] == totals["covered"] + totals["skipped"] + totals["left_out"]
    assert 0 < totals["bytes_sampled"] <= totals["bytes_fetched"]
    assert sum(one["share"] for one in code["functions"]) == pytest.approx(1.0)
    page = (tmp_path / "two" / "index.html").read_text()
    sources = check_page(page)
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert len(sources) >= 4 + 2 * 2
    assert "would need <b>" in page
    assert f"{code['lines'][0]['name']}</td>" in page
    with np.load(tmp_path / "two" / "maps.npz") as maps:
        assert maps["samples"].shape == (24, 32)
        assert np.array_equal(maps["samples"], maps["samples_rank_0"] + maps["samples_rank_1"])


@pytest.mark.long
@pytest.mark.gl
def test_opengl_counts_pixels_only(cli: Callable[..., Any], tmp_path: Path) -> None:
    numbers = profile(cli, tmp_path / "gl", "--by", "gl")
    assert numbers["code"] is None
    assert numbers["totals"]["samples"] > 0
    assert numbers["totals"]["ticks"] > 0
    assert "--by cpu" in (tmp_path / "gl" / "index.html").read_text()


@pytest.mark.long
@pytest.mark.gl
def test_fragments_are_counted_without_a_volume(cli: Callable[..., Any], octahedron: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    outcome = cli("profile", str(octahedron), "-o", str(out), "--size", "24x20", "-D", "opacity=0.5", "--by", "gl")
    assert (outcome.status, outcome.err) == (0, "")
    totals = json.loads((out / "profile.json").read_text())["totals"]
    assert totals["samples"] == 0
    with np.load(out / "maps.npz") as maps:
        assert maps["fragments"].max() == 2
        assert maps["fragments"].sum() == totals["fragments"] > 100
    assert "fragments of meshes, lines and points" in (out / "index.html").read_text()
