"""prepare compiles what is not kept, and says so; what cannot be kept is an error."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from clusterviz.cli import prepare
from clusterviz.kernels import objects


def test_kernels_are_made_once(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "cast-1.o"
    monkeypatch.setattr(prepare, "_files", lambda kernels: {path: (objects._keep, (path, b"code"))})
    found = [json.loads(cli("prepare", "--json").out) for _ in range(2)]
    assert [(each["compiled"], each["kept"]) for each in found] == [(["cast"], []), ([], ["cast"])]


def test_a_folder_that_cannot_be_written_is_said(
    cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(prepare, "_files", lambda kernels: {tmp_path / "cast-1.o": (len, ("",))})
    outcome = cli("prepare")
    assert (outcome.status, "kernels cannot be kept" in outcome.err) == (2, True)


def test_the_common_kernels_have_names_of_their_own() -> None:
    for lanes in (4, 16):
        names = [kernel.name for kernel in prepare.common_kernels(lanes)]
        assert len(set(names)) == len(names) > 10
