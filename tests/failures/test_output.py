"""Outputs that cannot be written: told before the work where that can be known, and never half a file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from failures.jobs import FIELD, SECONDS, SMALL, Ended, check_failure, render

from clusterviz.cli import run


@pytest.mark.parametrize(
    ("option", "name", "said"),
    [
        ("-o", "none/a.png", "none is missing; allowed a folder that is there"),
        ("-o", "file/a.png", "file is not a folder; allowed a file in a folder"),
        ("-o", "file/none/a.png", "none is not a folder; allowed a file in a folder"),
        ("-o", "folder.png", "found a folder"),
        ("-o", "a.bmp", "unknown extension; found .bmp; allowed .png, .npy, .exr"),
        ("-o", "a", "unknown extension; found none"),
        ("--stats", "none/s.json", "none is missing; allowed a folder that is there"),
        ("--stats", "folder.png", "found a folder"),
    ],
)
def test_an_impossible_output_is_told_before_the_data_is_read(
    option: str, name: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.png").mkdir()
    before = sorted(path.name for path in tmp_path.rglob("*"))
    outputs = {"-o": str(tmp_path / "picture.png")} | {option: str(tmp_path / name)}
    arguments = [word for pair in outputs.items() for word in pair]
    assert run(["render", str(tmp_path / "no-data.npy"), *arguments]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert said in err
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


@pytest.mark.fresh
def test_one_message_from_all_ranks(tmp_path: Path) -> None:
    ended = render(3, FIELD, "-o", str(tmp_path / "none/a.png"), *SMALL)
    check_failure(ended, 2, "rank 0, frame 0, output: ", tmp_path)


@pytest.mark.gl
@pytest.mark.fresh
@pytest.mark.parametrize("name", ["a.npy", "a.png", "a.exr"])
def test_a_full_disk_leaves_nothing(name: str, tmp_path: Path) -> None:
    # A limit on the size of files meets the same calls as a full disk, and needs no disk of its own.
    command = [sys.executable, "-m", "clusterviz", "render", FIELD, "-o", str(tmp_path / name), "--size", "90x70"]
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
