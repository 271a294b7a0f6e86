from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from selection import SLOW, covering, values_of


@dataclass(frozen=True)
class Row:
    mode: str
    keys: dict[str, int]


def test_chosen_rows_hold_every_value_that_any_row_holds() -> None:
    rows: list[dict[str, Any]] = [
        {"row": Row("lit", {"size": 1}), "name": "one"},
        {"row": Row("lit", {"size": 2}), "name": "one, two"},
        {"row": Row("cubic", {}), "name": "one"},
        {"row": Row("cubic", {"size": 1}), "name": "two"},
    ]
    assert covering(rows) == [1, 3]
    assert covering([{"n": 1}, {"n": 2}, {"n": 1}]) == [0, 1]
    assert set(values_of("name", "one, two")) == {("name", "one"), ("name", "two")}


def test_slow_tests_are_there() -> None:
    """Else a test that was renamed would be taken for a fast one."""
    missing = []
    for name in SLOW.read_text().split():
        file, function = name.split("::")
        path = SLOW.parents[1] / file
        if not (path.exists() and f"def {function}(" in path.read_text()):
            missing.append(name)
    assert not missing, "remove them, or run tests/selection.py with a report of all tests"
