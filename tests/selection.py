"""Which tests a run takes: all but the long ones, all (`--all`), or a few of every room (`--quick`).

- `@pytest.mark.long` leaves a test, or a row of its parameters, to `--all`.
- `@pytest.mark.cover` says that a test's rows combine values that others combine, too: rows that together hold each
  value once stay, and the others are long. Values are the arguments, the fields of a record, the keys of a dict,
  and what stands between the commas of a name. Rows whose ids the marker lists are long whatever they hold.
- `--quick` takes the first row of every test that is neither marked `fresh` or `browser` nor named in `slow.txt`.
  `python tests/selection.py REPORT` writes that list anew, from the JUnit report of a run of all tests.

A test that is named by its id, as in `pytest tests/x.py::test_y`, runs with all of its rows.
"""

from __future__ import annotations

import sys
import warnings
from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from statistics import mean
from typing import Any
from xml.etree import ElementTree

import pytest

SLOW = Path(__file__).with_name("slow.txt")
"""Tests of which a row takes longer than `SLOW_SECONDS` in the mean, one a line."""
SLOW_SECONDS = 0.15


def values_of(name: str, value: Any) -> Iterator[Hashable]:
    """What a row holds by an argument."""
    if is_dataclass(value):
        for field in fields(value):
            yield from values_of(f"{name}.{field.name}", getattr(value, field.name))
    elif isinstance(value, tuple) and any(map(is_dataclass, value)):
        for part in value:
            yield from values_of(name, part)
    elif isinstance(value, Mapping):
        yield from ((f"{name}.{key}", repr(one)) for key, one in value.items())
    elif isinstance(value, str):
        yield from ((name, word) for word in value.split(", "))
    else:
        yield name, repr(value)


def covering(rows: Iterable[Mapping[str, Any]]) -> list[int]:
    """Return the numbers of rows that together hold each value of each argument, chosen greedily."""
    held = [{each for name, value in row.items() for each in values_of(name, value)} for row in rows]
    left, chosen = set[Hashable]().union(*held), list[int]()
    while left:
        chosen.append(max(range(len(held)), key=lambda row: len(held[row] & left)))
        left -= held[chosen[-1]]
    return sorted(chosen)


def by_test(items: Iterable[pytest.Item]) -> dict[str, list[pytest.Function]]:
    """Rows by the name of their test, as `slow.txt` names it."""
    found = defaultdict[str, list[pytest.Function]](list)
    for item in items:
        if isinstance(item, pytest.Function):
            found[item.nodeid.split("[")[0]].append(item)
    return found


def mark_long(items: Iterable[pytest.Item]) -> None:
    """Mark the rows that no cover of their test needs."""
    for name, rows in by_test(items).items():
        marker = rows[0].get_closest_marker("cover")
        if marker is None or not hasattr(rows[0], "callspec"):
            continue
        ids = [row.nodeid.removeprefix(f"{name}[")[:-1] for row in rows]
        if unknown := set(marker.args) - set(ids):
            warnings.warn(f"{name} has no row {sorted(unknown)}", stacklevel=1)
        short = [row for row, own in zip(rows, ids, strict=True) if own not in marker.args]
        kept = covering(row.callspec.params for row in short)
        for row in {*rows} - {short[number] for number in kept}:
            row.add_marker(pytest.mark.long)


def chosen(items: list[pytest.Item], is_quick: bool) -> list[pytest.Item]:
    """Return the tests that are not long; quick: the first row of those that are not slow either."""
    mark_long(items)
    short = [item for item in items if not item.get_closest_marker("long")]
    if not is_quick:
        return short
    slow = set(SLOW.read_text().split())
    return [
        rows[0]
        for name, rows in by_test(short).items()
        if not {"fresh", "browser"} & set(rows[0].keywords) and name not in slow
    ]


def write_slow(report: Path) -> None:
    """Write `slow.txt` from a JUnit report."""
    seconds = defaultdict[str, list[float]](list)
    for case in ElementTree.parse(report).iter("testcase"):
        file = f"{case.get('classname', '').replace('.', '/')}.py"
        seconds[f"{file}::{case.get('name', '').split('[')[0]}"].append(float(case.get("time", 0)))
    slow = sorted(name for name in seconds if "::test_" in name and mean(seconds[name]) > SLOW_SECONDS)
    SLOW.write_text("".join(f"{name}\n" for name in slow))


if __name__ == "__main__":
    write_slow(Path(sys.argv[1]))
