"""Temporary files: hidden, removed at the end, or by the next process."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from clusterviz.image import replace
from clusterviz.image.replace import remove_leftovers, remove_temporaries, replacing

KILLED = """
import os, signal, sys
from clusterviz.image.replace import replacing
from clusterviz.report.output import replacing_folder
with replacing(sys.argv[1] + "/a.png"), replacing_folder(sys.argv[1] + "/b", "index.html") as folder:
    (folder / "page").touch()
    os.kill(os.getpid(), signal.SIGKILL)
"""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def leftovers(tmp_path: Path) -> Path:
    """Make a folder with a file and a folder that a killed process left, and others."""
    ended = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    assert ended.returncode == -signal.SIGKILL
    (tmp_path / ".a.clusterviz-another-machine-12345678.png").touch()
    (tmp_path / ".mine.png").touch()
    assert len(names(tmp_path)) == 4
    return tmp_path


KEPT = [".a.clusterviz-another-machine-12345678.png", ".mine.png"]


def test_the_next_process_removes_what_a_killed_one_left(leftovers: Path) -> None:
    with replacing(leftovers / "c.npy") as temporary:
        assert names(leftovers) == sorted([*KEPT, temporary.name])
        temporary.write_text("whole")
    assert names(leftovers) == [*KEPT, "c.npy"]


def test_what_a_living_process_writes_is_left(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.png") as temporary:
        assert remove_leftovers(tmp_path) == []
        assert temporary.exists()


def test_a_process_that_ends_early_removes_its_own(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.png"):
        pass
    temporary = replace._create(tmp_path / "b.png")
    remove_temporaries()
    assert not temporary.exists()
    assert names(tmp_path) == ["a.png"]
    assert replace._locks == {}
