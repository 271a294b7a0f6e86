"""store: a volume becomes OME-Zarr, of which the same picture is made."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data import open_source

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
    pictures = []
    for volume in (FIELD, path):
        out = str(tmp_path / "a.npy")
        outcome = cli("render", volume, "-o", out, "--size", "24x24", "-D", "cluster.brick=8")
        assert outcome.status == 0, outcome.err
        pictures.append(np.load(out))
    np.testing.assert_array_equal(*pictures)
    assert pictures[0][..., 3].max() > 0.1
