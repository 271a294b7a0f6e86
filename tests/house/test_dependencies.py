"""What the code imports is what pyproject.toml asks for: a package that happens to be installed is no promise."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# The other halves of declared packages, which pin them exactly.
HALVES = {"llvmlite": "numba", "pydantic-core": "pydantic"}
NAME = re.compile(r"[\w.-]+")


def canonical(requirement: str) -> str:
    """The name in a requirement, spelt as packages compare names."""
    name = NAME.match(requirement)
    assert name, requirement
    return re.sub(r"[-_.]+", "-", name.group()).lower()


def imported(folder: str) -> set[str]:
    """Top-level names of all modules that the files below a folder import."""
    found = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(), str(path))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).split(".")[0])
    return found


@pytest.mark.parametrize(
    ("folder", "extras"), [("clusterviz", ["report", "movie", "store", "zfp", "view", "notebook"]), ("tests", ["test"])]
)
def test_what_is_imported_is_asked_for(folder: str, extras: list[str]) -> None:
    wanted = PROJECT["dependencies"] + [name for extra in extras for name in PROJECT["optional-dependencies"][extra]]
    declared = {canonical(requirement) for requirement in wanted} | {"clusterviz"}
    declared |= {half for half, whole in HALVES.items() if whole in declared}
    distributions = packages_distributions()
    foreign = {name for name in imported(folder) - sys.stdlib_module_names if name in distributions}
    undeclared = {name for name in foreign if not declared & {canonical(owner) for owner in distributions[name]}}
    assert undeclared == set()


def test_constraints_pin_every_dependency_by_version_alone() -> None:
    lines = (ROOT / "constraints.txt").read_text().split()
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines)
    wanted = PROJECT["dependencies"] + [name for names in PROJECT["optional-dependencies"].values() for name in names]
    assert {canonical(requirement) for requirement in wanted} - {canonical(line) for line in lines} == set()
