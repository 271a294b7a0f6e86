"""`samples` lists, and prints the path of what is in the cache."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clusterviz.cli import COMMANDS
from clusterviz.data import samples


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CLUSTERVIZ_CACHE", str(tmp_path))
    return tmp_path


def test_every_sample_is_listed_with_its_licence(cli: Callable[..., Any], cache: Path) -> None:
    lines = cli("samples").out.splitlines()
    assert [line.split()[0] for line in lines] == [*samples.SAMPLES, "cache:"]
    assert all(sample.licence in line for sample, line in zip(samples.SAMPLES.values(), lines, strict=False))
    assert not any(line.endswith("cached") for line in lines)


def test_only_the_path_goes_to_standard_output(
    cli: Callable[..., Any], cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = b"a head"
    known = replace(samples.SAMPLES["mni152"], sha256=hashlib.sha256(content).hexdigest())
    monkeypatch.setitem(samples.SAMPLES, "mni152", known)
    (cache / known.file_name).write_bytes(content)
    outcome = cli("samples", "mni152")
    assert (outcome.status, outcome.out) == (0, f"{cache / known.file_name}\n")
    assert cli("samples").out.splitlines()[0].endswith("cached")


def test_the_example_names_a_sample() -> None:
    assert COMMANDS["samples"].example.split()[-1] in samples.SAMPLES


def test_an_unknown_name_is_bad_input(cli: Callable[..., Any], cache: Path) -> None:
    outcome = cli("samples", "mni")
    assert outcome.status == 2
    assert "no such sample; found mni; allowed mni152" in outcome.err
    assert outcome.out == ""
