"""tradeoff: a self-contained page and its numbers, or nothing after a failure."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli.pages import check_page

from clusterviz.cli import reporting
from clusterviz.cli.tradeoff import MpirunJob
from clusterviz.errors import ClustervizError
from clusterviz.pages.tradeoff.measure import Cost, Measured, cost_from_json
from clusterviz.scene import Scene

FIELD = "field:gaussian:12"
LOOK = Path(__file__).parents[2] / "examples/looks/octants.glsl"
SMALL = ("--size", "16x12", "--frames", "1")
KEYS = {"clusterviz", "scene", "ranks", "size", "frames", "renderer", "verdict", "truth", "settings", "failed"}
KEYS |= {"left_out", "drift", "rounds", "judged_by"}
COST = Cost(0.1, 0.2, 0.2, 0.2, 10, 10, 10, 0, 0)


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize("ranks", [pytest.param(1, marks=pytest.mark.long), 2])
def test_page_and_numbers(
    ranks: int, cli: Callable[..., Any], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """On one rank, of a scene with a shader, which the reference does not know."""
    out = tmp_path / "out"
    options = ("--ranks", str(ranks), "--knobs", "filter", "--budget", "30", "-D", "cluster.brick=4")
    options += ("-D", "cluster.transport=messages")
    look = tmp_path_factory.mktemp("look") / "mine.glsl"
    look.write_text(LOOK.read_text())
    options += ("-D", f"volumes.0.shader={look}") * (ranks == 1)
    outcome = cli("tradeoff", FIELD, "-o", str(out), *SMALL, *options)
    assert (outcome.status, outcome.err) == (0, "")
    assert "As the scene is, a frame takes" in outcome.out
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["index.html", "out", "tradeoff.json"]
    numbers = json.loads((out / "tradeoff.json").read_text())
    assert set(numbers) == KEYS
    assert (numbers["ranks"], numbers["size"], numbers["frames"]) == (ranks, [16, 12], 1)
    assert numbers["truth"]["source"] == ("renderer" if ranks == 1 else "reference")
    scene, *others = numbers["settings"]
    assert (scene["kind"], scene["changes"]) == ("scene", {})
    assert [one["changes"] for one in others] == [{"filter": "hardware"}]
    assert 0 < scene["max"] < 0.1
    assert scene["samples"] == others[0]["samples"] > 0
    assert 0 < scene["ssim"] <= 1
    assert (scene["bytes_sent"] > 0) == (ranks > 1)
    assert any(one["front"] for one in numbers["settings"])
    assert numbers["failed"] == []
    page = (out / "index.html").read_text()
    sources = check_page(page)
    assert len(sources) == 1 + 2 * len(numbers["settings"])
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert page.count("<svg") == 2
    assert "Nothing was sent" not in page


@pytest.fixture
def jobs(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """The scenes that were drawn; each picture is as far from 0.5 as its step is long."""
    drawn: list[Scene] = []

    def draw(self: MpirunJob, scene: Scene, frames: int, warm_up: int = 1) -> Measured:
        drawn.append(scene)
        if scene.quality.filter == "hardware":
            raise ClustervizError("on 1 rank: no such unit")
        width, height = scene.image.size
        image = np.full((height, width, 4), 0.5 + 0.01 * scene.quality.step, np.float32)
        return Measured(COST, image, complete(scene), "a renderer")

    monkeypatch.setattr(MpirunJob, "__call__", draw)
    return drawn


def complete(scene: Scene) -> Scene:
    from clusterviz.content.complete import complete_scene
    from clusterviz.data import open_source
    from clusterviz.scene import VolumeInfo

    grid = open_source(scene.volumes[0].path, None).grid
    return complete_scene(scene, VolumeInfo(grid.shape_zyx, grid.spacing, grid.corners, 0.0, 1.0, 0.0, 1.0))


def test_a_setting_that_fails_is_told_and_takes_no_other_along(
    jobs: list[Scene], cli: Callable[..., Any], tmp_path: Path
) -> None:
    options = ("--knobs", "step,filter", "--budget", "0", "--rounds", "2")
    outcome = cli("tradeoff", FIELD, "-o", str(tmp_path / "out"), *SMALL, *options)
    assert (outcome.status, outcome.err) == (0, "")
    numbers = json.loads((tmp_path / "out" / "tradeoff.json").read_text())
    assert {one["changes"].get("filter") for one in numbers["failed"]} == {"hardware"}
    assert {"step 0.5", "step 4"} <= {one["name"] for one in numbers["settings"]}
    assert numbers["failed"][0]["reason"] == "on 1 rank: no such unit"
    assert "no such unit" in (tmp_path / "out" / "index.html").read_text()
    assert numbers["truth"]["source"] == "renderer"
    assert (numbers["rounds"], numbers["drift"]) == (2, 1)
    # All are drawn from the completed scene, with the camera of the first.
    assert len({scene.camera for scene in jobs[1:] if scene.image.size == (16, 12)}) == 1


def test_ranks_that_share_memory_are_told_to_have_sent_nothing(
    jobs: list[Scene], cli: Callable[..., Any], tmp_path: Path
) -> None:
    options = ("--knobs", "step", "--budget", "0", "--ranks", "2")
    assert cli("tradeoff", FIELD, "-o", str(tmp_path / "out"), *SMALL, *options).status == 0
    assert "Nothing was sent" in (tmp_path / "out" / "index.html").read_text()


def test_a_scene_that_cannot_be_drawn_leaves_nothing(
    cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise ClustervizError("on 1 rank: no context")

    monkeypatch.setattr(reporting, "run_job", fail)
    outcome = cli("tradeoff", FIELD, "-o", str(tmp_path / "out"), *SMALL)
    assert (outcome.status, outcome.err) == (1, "clusterviz: error: on 1 rank: no context\n")
    assert list(tmp_path.iterdir()) == []


def test_costs_come_back_from_json() -> None:
    assert cost_from_json(json.loads(json.dumps(COST.as_json()))) == COST
