"""Imports go one way: a package imports from packages of earlier levels, and two libraries stay in one package each."""

from __future__ import annotations

import ast
import functools
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# Packages on one line do not import each other. `report` holds values; its pages are in folders of their own.
LEVELS = (
    ("errors",),
    ("kernels", "input_files", "comm"),
    ("spmd", "image", "codec"),
    ("scene.keys", "report", "gl", "partition"),
    ("content.sections", "jobs.device", "composite"),
    ("scene.values", "content.transfer", "jobs.kernel"),
    ("scene", "content.flow.expansion", "image.pyramid", "frame.run"),
    ("data",),
    ("plan", "jobs", "reference"),
    ("partition.screen", "flow", "render"),
    ("content", "frame.work"),
    ("annotations", "distribution"),
    ("migration", "auto"),
    ("frame",),
    ("pages", "self_test", "viewer", "debugger"),
    ("cli",),
    ("__main__",),
)
LEVEL = {name: level for level, names in enumerate(LEVELS) for name in names}
KEYS = (
    "annotations",
    "background",
    "blend_modes",
    "camera",
    "checks",
    "cluster",
    "colormaps",
    "compatibility",
    "field_types",
)
PARTS = {f"scene.{name}": "scene.keys" for name in (*KEYS, "materials", "transfer", "transfer_2d", "yaml_text")}
PARTS |= {f"content.{kind}.section": "content.sections" for kind in ("volume", "geometry", "grid", "flow")}
PARTS |= {f"content.{name}": "content.sections" for name in ("facts", "volume.info", "volume.optics", "volume.presets")}
"""Modules that have one entry: those of which sections of a scene are made, and the sections of content with facts."""
LIBRARY_PACKAGES = {"mpi4py": {"comm"}, "moderngl": {"gl", "render"}, "glcontext": {"gl"}}
ALLOWED = {
    "kernels": {"errors", "kernels"},
    "spmd": {"errors", "kernels", "spmd"},
    "reference": {"scene", "content", "data", "image", "errors", "reference"},
}
"""Packages that stand alone: the compiler of GLSL with its object files, and the reference."""
COMPARED = {"clusterviz.scene.complete", "clusterviz.scene.transfer"}
"""Modules that the reference checks, and so must not use."""


@functools.cache
def modules() -> dict[str, ast.Module]:
    """Every module of the package by its dotted name, parsed."""
    paths = sorted((ROOT / "clusterviz").rglob("*.py"))
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in paths]
    return {name: ast.parse(path.read_text(), str(path)) for name, path in zip(names, paths, strict=True)}


def imports(tree: ast.Module) -> set[str]:
    """Dotted names of the modules that a module imports, at its top and inside its functions."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import"
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in modules() else str(node.module) for name in whole}
    return found


def entry(module: str) -> str:
    """Return the entry of LEVELS that a module belongs to; "" for `clusterviz` itself."""
    parts = module.split(".")[1:]
    names = (".".join(parts[:n]) for n in (3, 2, 1))
    return next((found for name in names if (found := PARTS.get(name, name)) in LEVEL), "")


def against_the_order(name: str) -> list[str]:
    """Return what is wrong with the imports of a module."""
    mine, wrong = entry(name), list[str]()
    if not mine:
        return [f"{name} has no entry in LEVELS"]
    for imported in imports(modules()[name]):
        library, other = imported.split(".")[0], entry(imported)
        if mine not in LIBRARY_PACKAGES.get(library, {mine}):
            wrong.append(f"{name} imports {imported}")
        if library != "clusterviz" or mine == other:
            continue
        if not other and mine != "cli":
            wrong.append(f"{name} imports the package itself")
        if other and LEVEL[other] >= LEVEL[mine]:
            wrong.append(f"{name} imports {imported}, against the order")
        top = other.split(".")[0]
        if top not in ALLOWED.get(mine, {top}) or (mine == "reference" and imported in COMPARED):
            wrong.append(f"the {mine} imports {imported}")
    return wrong


def test_imports_follow_the_order_of_levels() -> None:
    names = [name for name in modules() if name != "clusterviz"]
    assert len(names) > 500
    assert not [wrong for name in names for wrong in against_the_order(name)]


@pytest.mark.parametrize(
    ("name", "imported", "complaint"),
    [
        ("clusterviz.plan.x", "clusterviz.frame", "against the order"),
        ("clusterviz.plan.x", "mpi4py.MPI", "imports mpi4py.MPI"),
        ("clusterviz.reference.x", "clusterviz.kernels", "the reference imports"),
        ("clusterviz.reference.x", "clusterviz.scene.complete", "the reference imports"),
        ("clusterviz.spmd.x", "clusterviz.input_files", "the spmd imports"),
        ("clusterviz.plan.x", "clusterviz", "the package itself"),
        ("clusterviz.nowhere.x", "os", "no entry"),
    ],
)
def test_a_wrong_import_is_found(name: str, imported: str, complaint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(modules(), name, ast.parse(f"import {imported}"))
    assert any(complaint in wrong for wrong in against_the_order(name))


def test_no_module_imports_itself_round_a_circle() -> None:
    graph = {name: imports(tree) & modules().keys() for name, tree in modules().items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" imports ".join(reversed(circle.args[1])))


def test_any_module_can_be_imported_first() -> None:
    """Importing a.b.c imports a.b before; what is imported in functions, or for types only, waits."""
    graph: dict[str, set[str]] = {}
    for name, tree in modules().items():
        at_once = ast.Module([node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))], [])
        found = imports(at_once) & modules().keys()
        packages = {".".join(each.split(".")[:n]) for each in found for n in range(2, each.count(".") + 1)}
        graph[name] = {each for each in found | packages if not f"{name}.".startswith(f"{each}.")}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" imports ".join(reversed(circle.args[1])))
