"""trace: lines of a flow in a file that VTK reads, and a table of critical points."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.content.flow.section import Seeds
from clusterviz.data import read_geometry
from clusterviz.data.vectors import open_vectors
from clusterviz.flow.tracing import trace


def test_lines_and_points_are_written(cli: Callable[..., Any], tmp_path: Path) -> None:
    lines, points = tmp_path / "a.vtp", tmp_path / "a.csv"
    outcome = cli(
        *("trace", "field:saddle:9", "-o", str(lines), "--critical-points", str(points), "-D", "seeds.count=5")
    )
    assert outcome.status == 0
    assert "5 lines; 10 left the data" in outcome.out
    assert "saddle 2" in outcome.out
    assert points.read_text().splitlines()[1].split(",")[3] == "saddle 2"
    read = read_geometry(lines).lines
    traced = trace(open_vectors("field:saddle:9"), Seeds(count=5)).lines
    assert read is not None
    np.testing.assert_array_equal(read.points, traced.points)
    np.testing.assert_array_equal(read.offsets, traced.offsets)
    assert set(read.point_attributes) == {"speed", "time"}
    for name, values in (traced.point_attributes | traced.line_attributes).items():
        np.testing.assert_array_equal((read.point_attributes | read.line_attributes)[name], values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "nothing to do"),
        (("-o", "a.vtk"), "not a name of its file; found a.vtk; allowed a .vtp"),
        (("-o", "a.vtp", "-D", "show=lics"), "show"),
        (("-o", "a.vtp", "-D", "trace.step=-1"), "trace.step"),
    ],
)
def test_what_cannot_be_traced_is_refused(
    cli: Callable[..., Any],
    arguments: tuple[str, ...],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = cli("trace", "field:saddle:9", *arguments)
    assert outcome.status == 2
    assert message in outcome.err
    assert not list(tmp_path.iterdir())
