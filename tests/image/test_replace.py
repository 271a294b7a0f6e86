"""Temporary files: hidden, removed at the end, or by the next process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from clusterviz.errors import OutputError
from clusterviz.image import replace
from clusterviz.image.replace import check_replaceable, remove_leftovers, remove_temporaries, replacing
from clusterviz.pages.output import replacing_folder

KILLED = """
import os, signal, sys
from clusterviz.image.replace import replacing
from clusterviz.pages.output import replacing_folder
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


@pytest.mark.parametrize("exists", [True, False])
def test_a_link_stays_and_the_file_behind_it_is_written(exists: bool, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link, target = tmp_path / "a.png", tmp_path / "there" / "b.png"
    link.symlink_to("there/b.png")
    if exists:
        target.write_text("older")
    check_replaceable(link)
    with replacing(link) as temporary:
        temporary.write_text("whole")
    assert link.is_symlink()
    assert (target.read_text(), names(tmp_path / "there")) == ("whole", ["b.png"])


def test_a_link_to_a_report_stays(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "report").symlink_to("there")
    with replacing_folder(tmp_path / "report", "index.html") as folder:
        (folder / "index.html").write_text("whole")
    assert (tmp_path / "report").is_symlink()
    assert names(tmp_path / "there") == ["index.html"]


def test_a_fifo_is_written_to_if_a_process_reads_it(tmp_path: Path) -> None:
    fifo = tmp_path / "a.png"
    os.mkfifo(fifo)
    check_replaceable(fifo)
    with pytest.raises(OutputError, match="a FIFO that no process reads"), replacing(fifo) as temporary:
        temporary.write_text("lost")
    handle = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    with replacing(fifo) as temporary:
        temporary.write_text("whole")
    read = os.read(handle, 9)
    os.close(handle)
    assert (read, fifo.is_fifo()) == (b"whole", True)


def test_devices_stay(tmp_path: Path) -> None:
    device = tmp_path / "null.json"
    device.symlink_to(os.devnull)
    with replacing(device) as temporary:
        temporary.write_text("{}")
    assert device.is_char_device()
    assert device.is_symlink()


@pytest.mark.parametrize("name", ["n" * 300 + ".png", "n" * 300 + "/a.png", "é" * 126 + ".png"])
def test_names_that_are_too_long_are_refused_early(name: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        check_replaceable(tmp_path / name)


def test_names_of_many_bytes_are_written(tmp_path: Path) -> None:
    path = tmp_path / f"{'é' * 125}.png"
    with replacing(path) as temporary:
        temporary.write_text("whole")
    assert path.read_text() == "whole"


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
