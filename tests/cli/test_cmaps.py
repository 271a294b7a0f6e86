"""cmaps: names, kinds and colours of colour maps."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest


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
    plain = cli("cmaps", "viridis").out
    assert "sequential" in plain
    assert "#440154" in plain
    assert "\x1b" not in plain


def test_a_terminal_gets_swatches(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLORTERM", "truecolor")
    assert cli("cmaps", "viridis").out.count("\x1b[48;2;") == 32


def test_kinds_are_a_filter(cli: Callable[..., Any]) -> None:
    listed = json.loads(cli("cmaps", "--kind", "cyclic", "--json").out)
    assert {each["kind"] for each in listed} == {"cyclic"}
    assert "twilight" in {each["name"] for each in listed}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--kind", "warm"), "--kind: unknown kind; found warm; allowed cyclic, diverging, misc"),
        (("veridis",), "cmaps: unknown colour map; found veridis; allowed a name that `clusterviz cmaps` lists, for "),
    ],
)
def test_what_is_not_there_is_said(arguments: tuple[str, ...], said: str, cli: Callable[..., Any]) -> None:
    outcome = cli("cmaps", *arguments)
    assert (outcome.status, outcome.out) == (2, "")
    assert said in outcome.err
