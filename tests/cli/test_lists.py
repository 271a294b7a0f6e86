"""Commands that list what there is: colour maps, samples, keys of a scene."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clusterviz.cli import COMMANDS
from clusterviz.data import samples


def test_maps_are_listed_with_colours(cli: Callable[..., Any]) -> None:
    outcome = cli("cmaps", "VIRI", "--json")
    listed = json.loads(outcome.out)
    (viridis,) = (each for each in listed if each["name"] == "viridis")
    assert viridis == {
        "name": "viridis",
        "kind": "sequential",
        "source": "bids",
        "colours": ["#440154", "#3b528b", "#21908c", "#5dc963", "#fde725"],
    }
    assert all("viri" in each["name"].lower() for each in listed)
    cyclic = json.loads(cli("cmaps", "--kind", "cyclic", "--json").out)
    assert {each["kind"] for each in cyclic} == {"cyclic"}
    assert "twilight" in {each["name"] for each in cyclic}
    plain = cli("cmaps", "viridis").out
    assert "sequential" in plain
    assert "#440154" in plain
    assert "\x1b" not in plain


def test_a_terminal_gets_swatches(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLORTERM", "truecolor")
    assert cli("cmaps", "viridis").out.count("\x1b[48;2;") == 32


def test_presets_are_listed_with_a_line_each(cli: Callable[..., Any]) -> None:
    listed = json.loads(cli("presets", "--json").out)
    assert {"tissue", "bone", "vessels", "mip", "labels"} <= {each["name"] for each in listed}
    lines = cli("presets").out.splitlines()
    assert [line.split(maxsplit=1) for line in lines] == [[each["name"], each["description"]] for each in listed]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CLUSTERVIZ_CACHE", str(tmp_path))
    return tmp_path


def test_every_sample_is_listed_with_its_licence(cli: Callable[..., Any], cache: Path) -> None:
    lines = cli("samples").out.splitlines()
    assert [line.split()[0] for line in lines] == [*samples.SAMPLES, "cache:"]
    assert all(sample.licence in line for sample, line in zip(samples.SAMPLES.values(), lines, strict=False))
    assert not any(line.endswith("cached") for line in lines)
    assert COMMANDS["samples"].example.split()[-1] in samples.SAMPLES


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


def test_schema_is_json_that_names_every_section(cli: Callable[..., Any]) -> None:
    outcome = cli("schema")
    schema = json.loads(outcome.out)
    assert outcome.status == 0
    sections = "volumes meshes lines points grids flows automatic lights clip camera image annotations quality cluster"
    assert list(schema["properties"]) == sections.split()
    assert schema["$defs"]["Quality"]["properties"]["step"]["exclusiveMinimum"] == 0
