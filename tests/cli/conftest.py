"""Running commands inside the test's process, as `clusterviz` runs them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from clusterviz.cli import run
from clusterviz.cli.termination import RANK_VARIABLES


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    status: int
    out: str
    err: str


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """Run a command: `cli("info", path)`; no launcher's variables are in its environment."""
    for name in RANK_VARIABLES:
        monkeypatch.delenv(name, raising=False)

    def call(*arguments: str) -> Outcome:
        capsys.readouterr()
        status = run(arguments)
        captured = capsys.readouterr()
        return Outcome(status, captured.out, captured.err)

    return call


@pytest.fixture
def octahedron(tmp_path: Path) -> Path:
    """A file with a mesh."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    lines = [f"v {x} {y} {z}" for x, y, z in corners.tolist()]
    lines += [f"f {a} {b} {c}" for a in (1, 4) for b in (2, 5) for c in (3, 6)]
    path = tmp_path / "octahedron.obj"
    path.write_text("\n".join(lines))
    return path
