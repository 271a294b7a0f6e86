"""store: a volume becomes OME-Zarr, of which the same picture is made."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.data.memory import ArraySource
from clusterviz.data.store.shards import BrickCodec, ShardedArray
from clusterviz.data.store.writer import write_store
from clusterviz.frame import Options, render_frame
from clusterviz.frame.opening import open_content
from clusterviz.frame.run import Run
from clusterviz.scene import scene_of_data
from clusterviz.scene.overrides import with_settings

FIELD = "field:marschner-lobb:20"


def test_store_is_described_and_drawn_as_its_source(cli: Callable[..., Any], tmp_path: Path) -> None:
    path = str(tmp_path / "a.ome.zarr")
    found = json.loads(cli("store", FIELD, path, "--brick", "8", "--json").out)
    assert [level["shape_zyx"] for level in found["levels"]] == [[20] * 3, [10] * 3, [5] * 3]
    assert [level["bricks"] for level in found["levels"]] == [27, 8, 1]
    assert found["levels"][0]["error"] == 0
    assert found["levels"][0]["bytes"] == 20**3 * open_source(FIELD).dtype.itemsize
    assert 0 < found["levels"][1]["error"] <= found["levels"][2]["error"]
    again = cli("store", FIELD, path, "--brick", "8")
    assert (again.status, "level 2: 5 × 5 × 5, 1 bricks" in again.out) == (0, True)
    assert "level 0" not in cli("--quiet", "store", FIELD, path, "--brick", "8").out
    info = json.loads(cli("info", path, "--json").out)
    assert (info["format"], [level["bricks"] for level in info["levels"]]) == ("ome-zarr", [27, 8, 1])
    assert "10 × 10 × 10, 8 bricks, error at most " in cli("info", path).out
    known = json.loads(cli("info", FIELD, "--json").out)
    for key in ("minimum", "maximum", "percentiles", "histogram", "not_finite"):
        assert info[key] == known[key]


@pytest.mark.parametrize(
    ("cluster", "labels"), [({"brick": 8}, False), ({"brick": 7}, True), ({"brick": 8, "largest_brick": 16}, False)]
)
def test_store_is_opened_without_its_samples_and_drawn_as_its_source(
    cluster: dict[str, int], labels: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, path = open_source(FIELD), tmp_path / "a.ome.zarr"
    if labels:
        z, _, x = np.indices(source.grid.shape_zyx)
        source = ArraySource((x // 8 + 3 * (z // 9)).astype(np.uint8), source.grid)
    write_store(source, path, BrickCodec(), 8)
    scene = with_settings(scene_of_data(str(path)), {"size": (24, 24), **cluster})
    expected = render_frame(scene, LoopbackChannel(), source, Options(device="cpu"))
    given = open_source(path)
    drawn = render_frame(scene, LoopbackChannel(), given, Options(device="cpu"))
    assert drawn.scene == expected.scene
    np.testing.assert_array_equal(drawn.image, expected.image)
    assert drawn.image[..., 3].max() > 0.1
    monkeypatch.setattr(ShardedArray, "brick", None)
    completed, _, bricks = open_content(Run(LoopbackChannel(), Options()), scene, given)
    assert (completed, bricks) == (expected.scene, {})
    coarse = with_settings(scene, {"detail": {"level": 1}, "largest_brick": None})
    assert open_content(Run(LoopbackChannel(), Options()), coarse, given)[2] == {}
