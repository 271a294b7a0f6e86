"""Mutation testing: a mistake at a time, in a copy of the checkout, and whether the tests of that part find it.

    python tests/mutants.py 20 --seed 3 --seconds 300

A mutant is a comparison, constant or operator exchanged, two arguments swapped, a condition negated, or a statement
left out. The first test that fails kills it. Of those that survive, find out whether they change nothing that
matters, or no test looks there.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("clusterviz/render", "clusterviz/composite", "clusterviz/plan", "clusterviz/partition", "shaders")
RELATED = {
    "clusterviz/render/abuffer": "render/test_fragments.py",
    "clusterviz/render/cells": "render/test_cells.py render/test_walk.py",
    "clusterviz/render/cpu": "render/cpu render/test_conformance.py",
    "clusterviz/render": "render/test_pieces.py render/test_skipping.py render/test_conformance.py",
    "clusterviz/composite": "composite",
    "clusterviz/plan": "plan render/test_known_pictures.py",
    "clusterviz/partition": "partition distribution/test_distributions.py",
    "shaders/abuffer": "render/test_fragments.py",
    "shaders/cells": "render/test_cells.py render/test_walk.py",
    "shaders/flow": "flow",
    "shaders/jobs": "jobs",
    "shaders/slices": "render/test_slices.py render/test_adaptive_slices.py",
    "shaders/volumes": "render/test_multi_volume.py",
    "shaders": "render/test_shader_functions.py render/test_known_pictures.py render/test_conformance.py",
}
"""Tests of what lies in a folder; the longest name counts. Those that name the module itself come before them."""
COMPARED = {"==": "!=", "!=": "==", "<=": "<", ">=": ">", "<": "<=", ">": ">="}
OPERATORS = COMPARED | {"+": "-", "-": "+", "*": "/", "/": "*", "and": "or", "or": "and", "&&": "||", "||": "&&"}
BYTES = "latin-1"  # a character for each byte, as columns are counted
SIGN = re.compile(r" (==|!=|<=|>=|<|>|\+|-|\*|/|and|or|&&|\|\|) ")


class Mutant(NamedTuple):
    """A stretch of a file's text, and what is there instead."""

    path: Path
    begin: int
    end: int
    text: str


def of_python(text: str) -> Iterator[tuple[int, int, str]]:
    """Return mutants of a module: begin, end, and the new text."""
    lines = [0, *(found.end() for found in re.finditer("\n", text))]

    def span(node: Any) -> tuple[int, int]:
        return lines[node.lineno - 1] + node.col_offset, lines[node.end_lineno - 1] + node.end_col_offset

    def between(left: ast.AST, right: ast.AST) -> Iterator[tuple[int, int, str]]:
        begin, end = span(left)[1], span(right)[0]
        if found := SIGN.search(text, begin - 1, end + 1):
            yield *found.span(1), OPERATORS[found[1]]

    for node in ast.walk(ast.parse(text.encode(BYTES))):
        match node:
            case ast.Compare(left=left, comparators=[right, *_]) | ast.BinOp(left=left, right=right):
                yield from between(left, right)
            case ast.BoolOp(values=[left, right, *_]):
                yield from between(left, right)
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                yield *span(node), repr(value + 1)
            case ast.Call(args=[one, other, *_]):
                (begin, middle), (after, end) = span(one), span(other)
                yield begin, end, text[after:end] + text[middle:after] + text[begin:middle]
            case ast.Expr(value=ast.Call()) | ast.Assign() | ast.AugAssign():
                yield *span(node), "pass"
        if isinstance(node, (ast.If, ast.While, ast.IfExp)):
            begin, end = span(node.test)
            yield begin, end, f"not ({text[begin:end]})"


def of_shader(text: str) -> Iterator[tuple[int, int, str]]:
    """Return mutants of a shader, outside of comments and preprocessor lines."""
    code = re.sub(r"//[^\n]*|/\*.*?\*/|^#[^\n]*", lambda found: " " * len(found[0]), text, flags=re.M | re.S)
    yield from ((*found.span(1), OPERATORS[found[1]]) for found in SIGN.finditer(code))
    for found in re.finditer(r"\bif \((.*)\)(?= \{| \w)", code):
        yield *found.span(1), f"!({found[1]})"
    for found in re.finditer(r"(?<![\w.])(\d+\.\d*)(?![\w.])", code):
        yield *found.span(1), repr(float(found[1]) + 1.0)
    for found in re.finditer(r"^ +(?!return|for|if|else)[\w.\[\]]+ [-+*|&]?= [^;\n]*;", code, flags=re.M):
        yield *found.span(), ""


def every_mutant(root: Path) -> list[Mutant]:
    """Return all mutants of `PARTS`, in the order of the files."""
    paths = sorted(path for part in PARTS for end in ("py", "glsl") for path in (root / part).rglob(f"*.{end}"))
    makers = {".py": of_python, ".glsl": of_shader}
    return [Mutant(path, *made) for path in paths for made in makers[path.suffix](path.read_text(BYTES))]


def tests_of(path: str) -> list[str]:
    """Return the tests of a file: those that name it, smallest first, then those of its folder."""
    package, _, name = path.removesuffix(".py").replace("/", ".").rpartition(".")
    naming = re.compile(rf"{package}\.{name}\b|from {package} import [^\n]*\b{name}\b")
    files = sorted((ROOT / "tests").rglob("test_*.py"), key=lambda file: file.stat().st_size)
    own = [str(file.relative_to(ROOT)) for file in files if naming.search(file.read_text())]
    folder = max((name for name in RELATED if path.startswith(name)), key=len)
    return list(dict.fromkeys([*own[:6], *(f"tests/{name}" for name in RELATED[folder].split())]))


def outcome(copy: Path, mutant: Mutant, seconds: float) -> str:
    """Return what the tests of a mutated file come to."""
    whole = mutant.path.read_text(BYTES)
    mutant.path.write_text(whole[: mutant.begin] + mutant.text + whole[mutant.end :], BYTES)
    command = [sys.executable, "-m", "pytest", "-x", "-m", "not mpi and not fresh", "-p", "no:cacheprovider"]
    command += tests_of(str(mutant.path.relative_to(copy)))
    environment = os.environ | {"PYTHONPATH": str(copy)}
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=seconds)
        return "killed" if done.returncode else "SURVIVED"
    except subprocess.TimeoutExpired:
        return "timed out"
    finally:
        mutant.path.write_text(whole, BYTES)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=300, help="what the tests of a mutant may take")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "site", "build"))
        for mutant in random.Random(asked.seed).sample(every_mutant(copy), asked.count):
            text = mutant.path.read_text(BYTES)
            line, old = text.count("\n", 0, mutant.begin) + 1, " ".join(text[mutant.begin : mutant.end].split())
            place = f"{mutant.path.relative_to(copy)}:{line}"
            print(f"{outcome(copy, mutant, asked.seconds):9} {place}: {old} -> {mutant.text}", flush=True)


if __name__ == "__main__":
    main()
