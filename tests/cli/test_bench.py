"""bench: results and reports of each benchmark."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.cli.bench import over
from clusterviz.cli.bench.network import BURSTS, LARGE_BYTES, SIZES
from clusterviz.cli.jobs import OVERSUBSCRIBE, job_command, run_job
from clusterviz.codec import CODECS
from clusterviz.composite import ALGORITHMS
from clusterviz.composite.model.network import Network, default_network, open_network
from clusterviz.reference import over as reference_over

SIZE = (23, 17)
MEASURED = [*ALGORITHMS, "auto"]
# Commands in one job, one after another; the first status that is not 0.
ONE_AFTER_ANOTHER = "import json, sys; from clusterviz.cli import run; sys.exit(any(map(run, json.loads(sys.argv[1]))))"


@pytest.mark.gl
def test_raycast(cli: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "r.json"
    arguments = ("--frames", "3", "--size", "24x18", "-D", "quality.step=0.5", "--json", str(file))
    outcome = cli("bench", "raycast", "field:gaussian:16", *arguments)
    assert (outcome.status, outcome.err) == (0, "")
    report = json.loads(file.read_text())
    assert 0 < report["min_s"] <= report["median_s"]
    assert report["samples"] > 1000
    assert (report["step_voxels"], report["frames"], report["size"]) == (0.5, 3, [24, 18])
    assert report["renderer"] in outcome.out
    assert report["scene"]["quality"]["filter"] == "exact"


def test_over(cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(over, "CACHE_BYTES", 1)
    file = tmp_path / "o.json"
    assert cli("bench", "over", "--size", "64x48", "--frames", "3", "--json", str(file)).status == 0
    report = json.loads(file.read_text())
    assert set(report["results"]) == {"uint8", "float32"}
    for rows in report["results"].values():
        assert set(rows) == {"copy", "put_before", "put_behind", "numpy"}
        assert all(0 < row["min_ms"] <= row["median_ms"] for row in rows.values())


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray[Any, Any]]:
    """A folder with the picture and the report of every algorithm on three ranks, and the picture in float64."""
    folder = tmp_path_factory.mktemp("measured")
    images = folder / "images"
    images.mkdir()
    rng = np.random.default_rng(0)
    alpha = rng.integers(0, 256, (3, SIZE[1], SIZE[0], 1))
    layers = np.concatenate([rng.integers(0, 1 + np.repeat(alpha, 3, axis=3)), alpha], axis=3).astype(np.uint8)
    for rank, layer in enumerate(layers):
        layer.tofile(images / f"img_{rank}.rgba")
    options = ["--images", str(images), "--size", "23x17", "--codec", "raw", "--transport", "messages", "--frames=2"]
    commands = []
    for name in MEASURED:
        outputs = ["--out", str(folder / f"{name}.rgba"), "--json", str(folder / f"{name}.json")]
        commands.append(["bench", "composite", *options, "--algorithm", name, *outputs])
    job = [*job_command(3, [])[:-2], "-c", ONE_AFTER_ANOTHER, json.dumps(commands)]
    subprocess.run(job, check=True, timeout=120, env=OVERSUBSCRIBE | os.environ)
    return folder, reference_over(list(layers / 255.0))


@pytest.mark.fresh
@pytest.mark.parametrize("algorithm", MEASURED)
def test_composite(algorithm: str, measured: tuple[Path, np.ndarray[Any, Any]]) -> None:
    folder, expected = measured
    report = json.loads((folder / f"{algorithm}.json").read_text())
    assert report["algorithm"] in (ALGORITHMS if algorithm == "auto" else (algorithm,))
    assert (report["ranks"], report["size"], report["frames"]) == (3, [23, 17], 2)
    assert (report["codec"], report["transport"]) == ("raw", "messages")
    assert 0 < report["min_ms"] <= report["median_ms"]
    for key in ("messages_sent", "bytes_raw", "bytes_sent"):
        assert len(report[key]) == 3
        assert sum(report[key]) > 0
    picture = np.fromfile(folder / f"{algorithm}.rgba", np.uint8).reshape(SIZE[1], SIZE[0], 4)
    # Two merges round by half a level each, and the first one's error in alpha weighs what lies behind it.
    assert np.abs(picture / 255.0 - expected).max() <= 1.5 / 255


def test_made_up_pictures(cli: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    outcome = cli("bench", "codec", "--size", "96x64", "--frames", "2", "--json", str(file))
    assert (outcome.status, outcome.err) == (0, "")
    report = json.loads(file.read_text())
    assert (report["images"], report["size"], report["frames"]) == (None, [96, 64], 2)
    rows = {(row["picture"], row["codec"]): row for row in report["results"]}
    assert len(rows) == 9 * (len(CODECS) - 1)
    for row in rows.values():
        assert row["ratio"] == row["bytes"] / row["bytes_raw"]
        assert 0 < row["encode_s"] <= row["encode_median_s"]
        if row["ratio"] == 1:
            assert row["pays_below_gbit_s"] is None
        else:
            at_break_even = (row["bytes_raw"] - row["bytes"]) * 8 / (row["pays_below_gbit_s"] * 1e9)
            assert at_break_even == pytest.approx(row["encode_s"] + row["open_s"])
    assert rows["sparse uint8", "active"]["ratio"] < 0.2
    assert rows["dense float32", "active"]["ratio"] == 1
    assert rows["noise uint8", "shuffle+lz4"]["ratio"] == 1


def test_pictures_of_a_folder(cli: Callable[..., Any], tmp_path: Path) -> None:
    half = np.zeros((20, 30, 4), np.float32)
    half[10:] = 0.5
    np.save(tmp_path / "half.npy", half)
    np.rint(255 * half).astype(np.uint8).tofile(tmp_path / "img_0.rgba")
    file = tmp_path / "c.json"
    options = ("--size", "30x20", "--frames", "1", "--json", str(file))
    assert cli("bench", "codec", "--images", str(tmp_path), *options).status == 0
    rows = {(row["picture"], row["codec"]): row["bytes"] for row in json.loads(file.read_text())["results"]}
    assert rows["img_0", "active"] == rows["half uint8", "active"] == 12 + 8 + 4 * 300
    assert rows["half float32", "rectangle"] == 12 + 16 + 16 * 300


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
