"""bench codec: every codec is measured, and the links on which it pays follow from the measurements."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.codec import CODECS


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


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("other.txt", b"", "no pictures"),
        ("img_0.rgba", b"1234", "not the size of the picture"),
        ("a.npy", b"1234", "cannot be read"),
    ],
)
def test_folders_without_pictures(
    cli: Callable[..., Any], tmp_path: Path, name: str, content: bytes, text: str
) -> None:
    (tmp_path / name).write_bytes(content)
    outcome = cli("bench", "codec", "--images", str(tmp_path), "--size", "30x20")
    assert (outcome.status, text in outcome.err) == (2, True), outcome.err


def test_arrays_that_are_no_pictures(cli: Callable[..., Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((4, 4)))
    outcome = cli("bench", "codec", "--images", str(tmp_path))
    assert (outcome.status, "not a picture" in outcome.err) == (2, True), outcome.err
