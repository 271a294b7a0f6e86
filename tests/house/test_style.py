"""What no file of the project may hold."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DRAWERS = {"utils", "util", "common", "core", "helpers", "helper", "misc", "base", "manager"}
# Spelt in two halves, so that this file does not hold them itself.
UNFINISHED = re.compile(r"\b(TO" + r"DO|FIX" + r"ME|XX" + r"X)\b")
MACHINE_PATH = re.compile(r"(?<![\w.])/(wo" + r"rk|ro" + r"ot|ho" + r"me|Us" + r"ers)/\w")
# The directive with a number: the assembler may speak of it, a string with a shader in it has one.
SHADER = re.compile(r"#version\s+\d")


def tracked(*patterns: str) -> list[Path]:
    """Files under version control that are on the disk."""
    listed = subprocess.run(["git", "ls-files", "-z", *patterns], cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def text_of(path: Path) -> str:
    """The file's text; "" where it is no text."""
    try:
        return path.read_text()
    except UnicodeDecodeError:
        return ""


# No package index has clusterviz: `installation` in errors.py says what works.
INSTALLED_BY_NAME = re.compile(r"pip install \S*cluster" + r"viz\b")


@pytest.mark.parametrize("pattern", [UNFINISHED, MACHINE_PATH], ids=["unfinished", "machine-path"])
def test_no_file_holds(pattern: re.Pattern[str]) -> None:
    found = [
        f"{path.relative_to(ROOT)}: {hit.group()}" for path in tracked() for hit in pattern.finditer(text_of(path))
    ]
    assert found == []


def test_nothing_is_installed_by_a_name_that_no_index_has() -> None:
    files = [path for path in tracked("*.py", "*.md", "containers", "launch") if path.name != "CHANGELOG.md"]
    assert [str(path) for path in files if INSTALLED_BY_NAME.search(text_of(path))] == []


def test_files_that_pages_name_exist() -> None:
    named = re.compile(
        r"\b((?:clusterviz|tests|benchmarks|examples|docs|launch|shaders)/[\w./-]*\.(?:py|glsl|yaml|md))\b"
    )
    pages = [page for page in tracked("*.md") if page.name != "CHANGELOG.md"]
    assert len(pages) > 30
    found = [(page.name, name) for page in pages for name in named.findall(text_of(page)) if "NAME" not in name]
    assert [(page, name) for page, name in found if not (ROOT / name).exists()] == []


def test_shaders_are_files() -> None:
    assert [str(path.relative_to(ROOT)) for path in tracked("*.py") if SHADER.search(path.read_text())] == []


def test_no_package_is_a_drawer() -> None:
    assert [str(path.relative_to(ROOT)) for path in tracked("*.py") if DRAWERS & {path.stem, path.parent.name}] == []


def test_no_benchmark_has_the_name_of_a_folder_of_tests() -> None:
    """Both are found by name, and a module hides a folder without `__init__.py`, wherever it stands on the path."""
    folders = {path.name for path in (ROOT / "tests").iterdir() if path.is_dir()}
    assert not folders & {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
