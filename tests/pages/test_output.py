"""Output folders appear whole or not at all, and other files are not overwritten."""

from __future__ import annotations

from pathlib import Path

import pytest

from clusterviz.errors import OutputError
from clusterviz.pages.output import check_folder, replacing_folder

MARK = "report.json"


def write(target: Path, text: str) -> None:
    with replacing_folder(target, MARK) as folder:
        assert not (target / "page").exists() or (target / "page").read_text() != text
        (folder / MARK).write_text("{}")
        (folder / "page").write_text(text)


def write_half(target: Path, error: BaseException) -> None:
    with replacing_folder(target, MARK) as folder:
        (folder / "half").write_text("half")
        raise error


def contents(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


def test_it_is_made_and_replaced_as_a_whole(tmp_path: Path) -> None:
    target = tmp_path / "out"
    write(target, "first")
    (target / "old").write_text("of the first")
    write(target, "second")
    assert contents(tmp_path) == {"out/page": "second", "out/report.json": "{}"}


def test_an_empty_folder_is_used(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write(tmp_path / "out", "text")
    assert sorted(contents(tmp_path)) == ["out/page", "out/report.json"]


@pytest.mark.parametrize("error", [RuntimeError("lost"), KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_failure_leaves_the_older_report_and_nothing_else(tmp_path: Path, error: BaseException) -> None:
    write(tmp_path / "out", "first")
    with pytest.raises(OutputError if isinstance(error, OSError) else type(error)):
        write_half(tmp_path / "out", error)
    assert contents(tmp_path) == {"out/page": "first", "out/report.json": "{}"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_other_files_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "thesis.tex").write_text("")
    (tmp_path / "file").write_text("")
    for target, said in (
        ("used", "would overwrite other files"),
        ("file", "found a file"),
        ("none/out", "none is missing"),
    ):
        with pytest.raises(OutputError, match=said):
            check_folder(tmp_path / target, MARK)
    check_folder(tmp_path / "new", MARK)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "used"]
