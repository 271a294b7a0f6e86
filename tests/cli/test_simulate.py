"""`simulate` prints counts as JSON or text, and draws."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

START = ("simulate", "--ranks", "12", "--size", "64x48")


def test_json_has_the_promised_keys(cli: Callable[..., Any]) -> None:
    outcome = cli("simulate", "--ranks", "4096", "--size", "4096x4096", "--algorithm", "binary-swap", "--json")
    found = json.loads(outcome.out)
    assert outcome.status == 0
    assert (found["messages_sent"], found["pixels_sent"], found["rounds"]) == (4096 * 12, 4095 * 4096 * 4096, 12)
    assert found["seconds"] > 0
    assert found["network"] == "200 Gb/s InfiniBand"


def test_text_names_the_worst_rank(cli: Callable[..., Any]) -> None:
    outcome = cli(*START, "--algorithm", "serial", "--footprints", "cubes", "--network", "laptop")
    assert outcome.status == 0
    assert "worst rank 0: sends 0 messages" in outcome.out


def test_options_and_a_network_file_are_taken(cli: Callable[..., Any], tmp_path: Path) -> None:
    constants = {"latency_seconds": 2.0, "overhead_seconds": 0, "seconds_per_byte": 0, "seconds_per_pixel": 0}
    path = tmp_path / "net.json"
    path.write_text(json.dumps({"name": "mine", "source": "made up", **constants}))
    outcome = cli(*START, "--algorithm", "radix-k", "--factors", "2,2,3", "--network", str(path), "--json")
    found = json.loads(outcome.out)
    assert (found["network"], found["rounds"], found["seconds"]) == ("mine", 3, 6.0)


@pytest.mark.parametrize("footprints", ["dense", "cubes"])
@pytest.mark.parametrize("kind", ["svg", "png"])
def test_draws(cli: Callable[..., Any], tmp_path: Path, kind: str, footprints: str) -> None:
    path = tmp_path / f"s.{kind}"
    outcome = cli(*START, "--algorithm", "slic", "--footprints", footprints, "--draw", str(path))
    assert outcome.status == 0
    assert path.read_bytes()[:4] == (b"<svg" if kind == "svg" else b"\x89PNG")
