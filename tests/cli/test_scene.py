"""scene: the completed scene renders to the same picture, and pictures and statistics contain it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.image.files import read_text, write_image
from clusterviz.scene import load_scene

LOOKS = {
    "labels": np.arange(12 * 12 * 12).reshape(12, 12, 12) // 300,
    "field": np.random.default_rng(0).normal(0, 1, (12, 12, 12)).cumsum(axis=0),
}


@pytest.mark.gl
@pytest.mark.parametrize("name", LOOKS)
def test_the_completed_scene_is_kept(name: str, cli: Callable[..., Any], tmp_path: Path) -> None:
    data, stats = tmp_path / "a.npy", tmp_path / "a.json"
    np.save(data, LOOKS[name])
    first, again, third = (tmp_path / f"{number}.png" for number in range(3))
    rendered = cli("render", str(data), "-o", str(first), "--size", "24x18", "--stats", str(stats))
    assert rendered.status == 0
    assert "shown      clim " in rendered.out
    printed = cli("scene", str(data), "--size", "24x18")
    assert "background: [0.09, 0.1, 0.12]  # A CSS colour name" in printed.out
    (tmp_path / "scene.yaml").write_text(printed.out)
    (tmp_path / "carried.yaml").write_text(cli("scene", str(first)).out)
    for scene, picture in (("scene.yaml", again), ("carried.yaml", third)):
        assert cli("render", str(tmp_path / scene), "-o", str(picture), "-D", "cluster.brick=5").status == 0
        assert picture.read_bytes() == first.read_bytes()
    assert load_scene(tmp_path / "scene.yaml").model_dump(mode="json") == json.loads(stats.read_text())["scene"]


def test_a_picture_without_a_scene_is_refused(cli: Callable[..., Any], tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.zeros((2, 2, 4), np.float32), None)
    outcome = cli("scene", str(tmp_path / "a.png"))
    assert outcome.status == 2
    assert "no scene in the picture" in outcome.err
    write_image(tmp_path / "a.png", np.zeros((2, 2, 4), np.float32), None, "é: 1\n")
    assert read_text(tmp_path / "a.png") == "é: 1\n"
