"""prepare: compiles kernels that are not cached, and reports a cache that cannot be written."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from clusterviz.cli import prepare
from clusterviz.cli.console import announce_compilation
from clusterviz.kernels import objects
from clusterviz.render.variant import Variant


def test_kernels_are_made_once(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "cast-1.o"
    monkeypatch.setattr(prepare, "_files", lambda *_: {path: (objects._save, (path, b"code"))})
    found = [json.loads(cli("prepare", "--json").out) for _ in range(2)]
    assert [(each["compiled"], each["kept"]) for each in found] == [(["cast"], []), ([], ["cast"])]


def test_only_those_of_a_first_picture(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Variant] = []
    monkeypatch.setattr(prepare, "_files", lambda kernels, _: asked.extend(kernels) or {})
    assert cli("prepare", "--common").status == 0
    assert asked == prepare.first_variants(prepare.host_width().lanes)


def test_a_folder_that_cannot_be_written_is_said(
    cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(prepare, "_files", lambda *_: {tmp_path / "cast-1.o": (len, ("",))})
    # Processes would import the package for seconds.
    monkeypatch.setattr(prepare, "ProcessPoolExecutor", lambda count, mp_context: ThreadPoolExecutor(count))
    outcome = cli("prepare")
    assert (outcome.status, "kernels cannot be kept" in outcome.err) == (2, True)


def test_the_common_kernels_have_files_of_their_own() -> None:
    for lanes in (4, 16):
        common, first = prepare.common_variants(lanes), prepare.first_variants(lanes)
        assert len(prepare._files(common, ())) == len(set(common)) + len(prepare._files([], ())) > 10
        assert set(first) < set(common)


def test_the_first_compilation_is_announced_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    try:
        ours, theirs = os.openpty()
    except OSError as error:  # a root without /dev/pts
        pytest.skip(f"no terminal can be opened here: {error}")
    os.set_blocking(ours, False)
    monkeypatch.setattr(sys, "stderr", os.fdopen(theirs, "w"))
    monkeypatch.setattr(objects, "on_compiling", objects.on_compiling)
    monkeypatch.setattr(objects, "folders", lambda: (tmp_path,))
    announce_compilation()
    for name in ("cast", "put"):
        with pytest.raises(KeyError):  # what would compile
            objects.function_address(name, [b"source"], {}.popitem)
    assert os.read(ours, 1000).count(b"compiling kernels") == 1
    os.close(ours)
