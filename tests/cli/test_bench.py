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
from clusterviz.cli.jobs import OVERSUBSCRIBE, job_command
from clusterviz.composite import ALGORITHMS
from clusterviz.reference import over as reference_over

SIZE = (23, 17)
MEASURED = [*ALGORITHMS, "auto"]
ONE_AFTER_ANOTHER = Path(__file__).parent / "one_after_another.py"


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


def test_raycast_of_nothing_is_refused(cli: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("volumes: []")
    outcome = cli("bench", "raycast", str(tmp_path / "scene.yaml"))
    assert (outcome.status, "nothing to draw" in outcome.err) == (2, True)


def test_over(cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(over, "CACHE_BYTES", 1)
    file = tmp_path / "o.json"
    assert cli("bench", "over", "--size", "64x48", "--frames", "3", "--json", str(file)).status == 0
    report = json.loads(file.read_text())
    assert set(report["results"]) == {"uint8", "float32"}
    for rows in report["results"].values():
        assert set(rows) == {"copy", "put_before", "put_behind", "numpy"}
        assert all(0 < row["min_ms"] <= row["median_ms"] for row in rows.values())


def make_images(parent: Path) -> tuple[Path, np.ndarray[Any, Any]]:
    """A folder with the images of three ranks, and their composition in float64."""
    rng = np.random.default_rng(0)
    alpha = rng.integers(0, 256, (3, SIZE[1], SIZE[0], 1))
    layers = np.concatenate([rng.integers(0, 1 + np.repeat(alpha, 3, axis=3)), alpha], axis=3).astype(np.uint8)
    folder = parent / "images"
    folder.mkdir()
    for rank, layer in enumerate(layers):
        layer.tofile(folder / f"img_{rank}.rgba")
    return folder, reference_over(list(layers / 255.0))


@pytest.fixture
def images(tmp_path: Path) -> tuple[Path, np.ndarray[Any, Any]]:
    """The same, for one test."""
    return make_images(tmp_path)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray[Any, Any]]:
    """A folder with the picture and the report of every algorithm on three ranks, and the picture in float64."""
    folder = tmp_path_factory.mktemp("measured")
    images, expected = make_images(folder)
    options = ["--images", str(images), "--size", "23x17", "--codec", "raw", "--transport", "messages", "--frames=2"]
    commands = []
    for name in MEASURED:
        outputs = ["--out", str(folder / f"{name}.rgba"), "--json", str(folder / f"{name}.json")]
        commands.append(["bench", "composite", *options, "--algorithm", name, *outputs])
    (folder / "commands").write_text(json.dumps(commands))
    job = [*job_command(3, [])[:-2], str(ONE_AFTER_ANOTHER), str(folder / "commands")]
    subprocess.run(job, check=True, timeout=120, env=OVERSUBSCRIBE | os.environ)
    return folder, expected


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


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--algorithm", "magic"), "unknown compositing algorithm; found magic"),
        (("--codec", "magic"), "found magic"),
        (("--transport", "magic"), "unknown transport; found magic; allowed messages, shared, hierarchical, auto"),
        (("--size", "5"), "--size: not a size"),
        (("--size", "24x17"), "img_0.rgba: not the size of the picture; found 1564 bytes; allowed 1632"),
        (("--images", "nowhere"), "nowhere/img_0.rgba: cannot be read"),
        (("--out", "nowhere/o.rgba"), "nowhere is missing"),
    ],
)
def test_composite_refuses(
    options: tuple[str, str], text: str, images: tuple[Path, np.ndarray[Any, Any]], cli: Callable[..., Any]
) -> None:
    arguments = {"--images": str(images[0]), "--size": "23x17", "--frames": "1"} | dict([options])
    outcome = cli("bench", "composite", *[word for pair in arguments.items() for word in pair])
    assert (outcome.status, outcome.out) == (2, "")
    assert text in outcome.err
