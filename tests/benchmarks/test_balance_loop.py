"""What the program that compares ways to share says of its runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from balance_loop import DRAWN, ONE_COPY, WAYS, scenes_of, verdict

from clusterviz.scene import Scene
from clusterviz.scene.values import Camera

TABLE = {"coherent": 50.0, "interleaved": 40.0, "replicated, 2 copies": 30.0, "dynamic": 32.0}


def told(**changes: float) -> str:
    return verdict([{"way": way, "M samples": cost} for way, cost in (TABLE | changes).items()])


def test_bricks_that_move_stand_beside_the_best_that_hold_no_brick_twice() -> None:
    beside = "interleaved, the best static of one copy"
    assert told() == f"dynamic took 20.0% less than {beside}; the least took replicated, 2 copies: 6.2% less"
    assert told(dynamic=28.0) == f"dynamic took 30.0% less than {beside}"
    assert told(dynamic=44.0).startswith(f"dynamic took 10.0% more than {beside}")


@pytest.mark.parametrize(("name", "frames"), [("orbit", 90), ("to and fro", 90), ("near", 90)])
def test_paths_have_as_many_frames_as_were_asked_for(name: str, frames: int) -> None:
    base = Scene(camera=Camera(position=(3.0, 0.0, 0.0), focal_point=(0.0, 0.0, 0.0), view_up=(0.0, 0.0, 1.0)))
    assert len(scenes_of(base, name, frames)) == frames


def test_documented_tables_name_the_ways_that_the_program_has() -> None:
    page = (Path(__file__).parents[2] / "docs" / "measurements" / "load-balancing.md").read_text()
    measured = page[page.index("## Orbits") : page.index("## Bricks of several sizes")]
    named = set(re.findall(r"^\| (\S[^|]*?) \| \d+\.\d+ \| \d", measured, re.MULTILINE))
    assert {*DRAWN, *ONE_COPY} <= named <= set(WAYS)
