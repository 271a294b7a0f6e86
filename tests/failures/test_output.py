"""Outputs that cannot be written: told before the work where that can be known, and never half a file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from failures.jobs import FIELD, SECONDS, SMALL, Ended, check_failure, render

from clusterviz.cli import run


@pytest.mark.fresh
def test_one_message_from_all_ranks(tmp_path: Path) -> None:
    ended = render(3, FIELD, "-o", str(tmp_path / "none/a.png"), *SMALL)
    check_failure(ended, 2, "rank 0, frame 0, output: ", tmp_path)


@pytest.mark.gl
@pytest.mark.fresh
@pytest.mark.parametrize("name", ["a.npy", "a.png", "a.exr"])
def test_a_full_disk_leaves_nothing(name: str, tmp_path: Path) -> None:
    # A limit on the size of files meets the same calls as a full disk, and needs no disk of its own.
    # Under the limit, Python would keep modules that it compiled cut off, and stumble over them ever after: -B.
    command = [sys.executable, "-B", "-m", "clusterviz", "render", FIELD, "-o", str(tmp_path / name), "--size", "90x70"]
    limited = ["sh", "-c", 'ulimit -f 2; exec "$0" "$@"', *command]
    done = subprocess.run(limited, capture_output=True, text=True, timeout=SECONDS, check=False)
    check_failure(Ended(done.returncode, done.stdout, done.stderr), 2, f"{name}: cannot be written", tmp_path)


@pytest.mark.gl
def test_an_older_picture_survives_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = tmp_path / "a.npy"
    picture.write_text("older")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("clusterviz.image.replace._flush_to_disk", full)
    assert run(["render", FIELD, "-o", str(picture), *SMALL]) == 2
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.npy", "older")]


@pytest.mark.fresh
def test_data_that_ends_early_is_told_once_by_all_ranks(tmp_path: Path) -> None:
    data, out = tmp_path / "cut.npy", tmp_path / "out"
    out.mkdir()
    np.save(data, np.zeros((20, 20, 20), np.float32))
    data.write_bytes(data.read_bytes()[:-8000])
    check_failure(render(3, str(data), "-o", str(out / "a.png"), *SMALL), 2, "cut.npy", out)
