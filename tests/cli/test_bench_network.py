"""bench network: writes a network file under mpirun that later runs read, and refuses one rank."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from clusterviz.cli.bench.probes import BURSTS, LARGE_BYTES, SIZES
from clusterviz.cli.jobs import run_job
from clusterviz.composite.model.network import Network, default_network, open_network


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the network file is kept in this test, in a folder that is not there yet."""
    monkeypatch.delenv("CLUSTERVIZ_NETWORK", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return tmp_path / "clusterviz" / "network.json"


def check(network: Network) -> None:
    """What no machine can fall short of."""
    assert network.seconds_per_byte > 0
    assert 0 < network.seconds_per_pixel < 1e-6
    assert 0 < network.seconds_per_float_pixel < 1e-6
    assert 0 < network.copy_seconds_per_byte < 1e-6
    assert network.barrier_seconds > 0
    assert network.frame_seconds > 0
    assert network.cores >= 1


@pytest.mark.fresh
def test_one_node_is_measured_and_found_again(kept: Path, tmp_path: Path) -> None:
    report = tmp_path / "r.json"
    run_job(2, ["bench", "network", "--frames", "2", "--json", str(report)])
    network = open_network(str(kept))
    check(network)
    assert network.nodes == 1
    assert network.latency_seconds == network.node_latency_seconds
    assert default_network(1) == network
    assert default_network(2).latency_seconds == open_network("ethernet-10g").latency_seconds
    found = json.loads(report.read_text())
    assert found["constants"]["seconds_per_byte"] == network.seconds_per_byte
    assert (found["frames"], found["ranks"], found["file"]) == (2, 2, str(kept))
    times = found["times"]["inside a node"]
    assert [int(size) for size in times["by_size"]] == list(SIZES)
    assert [int(size) for size in times["by_swap"]] == [size for size in SIZES if size >= LARGE_BYTES]
    assert [int(count) for count in times["by_count"]] == list(BURSTS)
    assert all(len(seconds) == 2 for seconds in times["by_size"].values())


@pytest.mark.fresh
def test_pretended_nodes_are_measured_as_several(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLUSTERVIZ_RANKS_PER_NODE", "2")
    output = tmp_path / "mine.json"
    run_job(3, ["bench", "network", "--frames", "1", "-o", str(output)])
    network = open_network(str(output))
    check(network)
    assert network.nodes == 2
    assert not kept.exists()


def test_one_rank_is_refused(cli: Callable[..., Any], kept: Path) -> None:
    outcome = cli("bench", "network")
    assert outcome.status == 2
    assert "a network has two ranks and more; found 1" in outcome.err
    assert not kept.exists()
