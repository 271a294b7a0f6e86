"""Stages loop over the entries of a scene and do not ask which kind of content one is."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from clusterviz.content.sections import CONTENT_SECTIONS
from clusterviz.content.table import KINDS
from clusterviz.scene.values import Scene

PACKAGE = Path(__file__).parents[2] / "clusterviz"
SECTIONS = {*CONTENT_SECTIONS, "geometry"}
CLASSES = {section.__name__ for section in CONTENT_SECTIONS.values()} | {kind.facts.__name__ for kind in KINDS}
CLASSES |= {"GeometrySection", "OpenedVolume", "OpenedFlow", "KnownGeometry", "KnownCells"}
CLASSES |= {"LicVolume", "VectorVolume", "FlowLines", "FlowPoints"}
MAY_ASK = ("content", "reference", "scene/compatibility.py", "scene/values.py")
"""The kinds, the reference, which has a file for each, and the scene, whose sections exclude and require each other."""


def questions(text: str) -> list[str]:
    """Return the places of a module that ask for a kind of content: attributes of a scene, and `isinstance`."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and node.attr in SECTIONS:
            owner = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
            if owner in ("scene", "completed") or owner.endswith("_scene"):
                found.append(f"line {node.lineno}: {owner}.{node.attr}")
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
            named = {each.id for each in ast.walk(node.args[1]) if isinstance(each, ast.Name)}
            found += [f"line {node.lineno}: isinstance of {name}" for name in sorted(named & CLASSES)]
    return found


def test_no_stage_asks_for_a_kind() -> None:
    asking = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if not name.startswith(MAY_ASK) and (found := questions(path.read_text())):
            asking[name] = found
    assert not asking, "loop over `entries_of` instead"


@pytest.mark.parametrize("text", ["len(scene.grids)", "work.scene.flows", "isinstance(one, (int, GridSection))"])
def test_a_question_is_found(text: str) -> None:
    assert len(questions(text)) == 1


def test_the_table_has_every_section_of_a_scene_once() -> None:
    listed = [name for kind in KINDS for name in kind.sections]
    assert listed == list(CONTENT_SECTIONS)
    assert all(isinstance(getattr(Scene(), kind.name), tuple) for kind in KINDS)
    assert set(listed) <= Scene.model_fields.keys()
