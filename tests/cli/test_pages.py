"""Commands that write pages: required libraries, output folders, and launchers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

FIELD = "field:gaussian:12"
pytestmark = pytest.mark.parametrize("command", ["scale", "tradeoff"])


@pytest.mark.parametrize("library", ["jinja2", "matplotlib"])
def test_a_missing_library_is_named(
    command: str, library: str, cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    outcome = cli(command, FIELD, "-o", str(tmp_path / "out"))
    assert outcome.status == 1
    assert f"reports need {library}: pip install 'clusterviz[report]'" in outcome.err


def test_a_folder_with_other_files_is_kept(command: str, cli: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    outcome = cli(command, FIELD, "-o", str(tmp_path))
    assert (outcome.status, "would overwrite other files" in outcome.err) == (2, True)


def test_it_is_not_run_by_mpirun(
    command: str, cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    outcome = cli(command, FIELD, "-o", str(tmp_path / "out"))
    assert (outcome.status, "starts mpirun by itself" in outcome.err) == (2, True)
