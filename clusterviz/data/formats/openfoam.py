"""OpenFOAM cases (.foam): the mesh in `constant/polyMesh`, and fields of cells at one time step.

A .foam file is empty, and stands for its folder. Files are text or binary, packed by gzip or not. All cells are cut
around their centres, as polyhedra. In the value of a uniform field `$name` stands for an entry of its file, or of one
that it includes. Fields that OpenFOAM computes (`#calc`, `#codeStream`) are left out, with a warning. A case that is
decomposed is read by its folders `processor0`, …: see `grid_files`.

References
----------
OpenFOAM User Guide, section 4.1, "Mesh description", and 2.2.1, "Case file structure".
"""

from __future__ import annotations

import gzip
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import read_file
from clusterviz.data.grid_files import choose_step
from clusterviz.data.header import check_size
from clusterviz.data.unstructured import Polyhedra, UnstructuredGrid, linearised
from clusterviz.errors import DataError, warn_of_data

WIDTHS = {"volScalarField": 1, "volVectorField": 3}
"""Components of fields of cells, by their class."""
COUNT = re.compile(rb"(\d+)\s*\(")
LIST = re.compile(rb"(\d+)\s*([({;])")
"""A list N(…), one of equal entries N{…}, or an empty one."""
COMMENT = re.compile(rb"//[^\n]*|/\*.*?\*/", re.DOTALL)
MACRO = re.compile(rb"\$\{?[:.]*([\w.]+)\}?")
MOST = 1 << 30
"""Entries of a list."""
DEEPEST = 8
"""Files that include one another, or entries that name one another."""


def read_openfoam(path: Path, time: float | None = None) -> UnstructuredGrid:
    mesh = path.parent / "constant" / "polyMesh"
    points, _ = _load(mesh / "points").numbers(3)
    owners, _ = _load(mesh / "owner").numbers(1, is_label=True)
    inner, _ = _load(mesh / "neighbour").numbers(1, is_label=True)
    inner = inner[: np.append(np.flatnonzero(inner < 0), len(inner))[0]]
    begins, sizes, values = _faces(_load(mesh / "faces"))
    if len(owners) != len(sizes) or len(inner) > len(sizes) or owners.min(initial=0) < 0:
        found = f"{len(owners)} owners, {len(inner)} neighbours, {len(sizes)} faces"
        raise DataError("owners do not fit the faces", where=str(mesh), found=found)
    both = np.concatenate([owners, inner])
    cells = int(both.max(initial=-1)) + 1
    check_size(len(both), cells, str(mesh / "owner"))
    begins, sizes = (np.concatenate([each, each[: len(inner)]]) for each in (begins, sizes))
    steps = {float(one.name): one for one in path.parent.iterdir() if _is_time(one)}
    times = np.array(sorted(steps))
    step = choose_step(times, time, str(path))
    files = sorted(steps[times[step]].iterdir()) if len(times) else []
    fields = {file.name.removesuffix(".gz"): _field(file, cells) for file in files if file.is_file()}
    of_cells = {name: field for name, field in fields.items() if field is not None}
    polyhedra = Polyhedra(cells, both, begins, sizes, values)
    return linearised(points.reshape(-1, 3), [("polyhedron", polyhedra)], {}, of_cells, str(path))


def _is_time(folder: Path) -> bool:
    return re.fullmatch(r"\d+(\.\d+)?([eE][-+]?\d+)?", folder.name) is not None and folder.is_dir()


@dataclass(frozen=True)
class _File:
    """File after its header."""

    path: Path
    header: dict[str, str]
    body: bytes

    def numbers(self, width: int, is_label: bool = False, begin: int = 0) -> tuple[NDArray[Any], int]:
        found = LIST.search(self.body, begin)
        if found is None or (found[2] == b";" and int(found[1])):
            raise DataError("no list", where=str(self.path), allowed="N ( … ) or N { … }")
        repeats, count, at = None, int(found[1]) * width, found.end()
        if found[2] == b"{":
            repeats, count = int(found[1]), width
            if repeats > MOST:
                raise DataError("too large", where=str(self.path), found=repeats, allowed=f"at most {MOST}")
        stored = np.dtype(np.int64 if is_label else np.float64)
        if found[2] == b";":
            return np.zeros(0, stored), at
        if self.header.get("format") == "binary":
            size = re.search(r"label=(\d+)" if is_label else r"scalar=(\d+)", self.header.get("arch", ""))
            stored = np.dtype(f"<{'i' if is_label else 'f'}{int(size[1]) // 8 if size else 4 if is_label else 8}")
            check_size(len(self.body) - at, count * stored.itemsize, str(self.path))
            end = at + count * stored.itemsize
            values = np.frombuffer(self.body, stored, count, at).astype(np.int64 if is_label else stored)
        else:
            ends = rb"\}" if repeats is not None else rb"\)\s*\)" if width > 1 and count else rb"\)"
            close = re.compile(ends).search(self.body, at)
            end = close.end() if close else len(self.body)
            words = _words(self.body[at:end].removesuffix(b"}"))
            if close is None or len(words) != count:
                raise DataError("truncated", where=str(self.path), found=f"{len(words)} numbers", allowed=count)
            values = np.array(words, stored)
        return values if repeats is None else np.tile(values, repeats), end


def _words(text: bytes) -> list[bytes]:
    return text.replace(b"(", b" ").replace(b")", b" ").split()


def _load(path: Path) -> _File:
    packed = path.with_name(f"{path.name}.gz")
    path = packed if packed.exists() and not path.exists() else path
    content = gzip.decompress(read_file(path)) if path.suffix == ".gz" else read_file(path)
    found = re.search(rb"FoamFile\s*\{(.*?)\}", content, re.DOTALL)
    if found is None:
        raise DataError("not a file of OpenFOAM", where=str(path), allowed="FoamFile { … }")
    entries = dict(re.findall(r'(\w+)\s+("[^"]*"|[^;]+);', found[1].decode("ascii", "replace")))
    body = content[found.end() :]
    return _File(path, entries, body if entries.get("format") == "binary" else COMMENT.sub(b"", body))


def _faces(file: _File) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    if file.header.get("class") == "faceCompactList":
        offsets, end = file.numbers(1, is_label=True)
        return offsets[:-1], np.diff(offsets), file.numbers(1, is_label=True, begin=end)[0]
    found = COUNT.search(file.body)
    if found is None or file.header.get("format") == "binary":
        raise DataError("no list of faces", where=str(file.path), allowed="text, or a binary faceCompactList")
    sizes = np.array([int(size) for size in COUNT.findall(file.body, found.end())], np.int64)
    if len(sizes) != int(found[1]):
        raise DataError("truncated", where=str(file.path), found=f"{len(sizes)} faces", allowed=int(found[1]))
    return np.cumsum(sizes + 1) - sizes, sizes, np.array(_words(file.body[found.end() :]), np.int64)


def _field(path: Path, cells: int) -> NDArray[Any] | None:
    """Return a field of cells; None for files of other kinds, and for a field that is computed."""
    file = _load(path.with_name(path.name.removesuffix(".gz")))
    kind, _, internal = file.header.get("class", "").partition("::")
    width, key = WIDTHS.get(kind), rb"value" if internal == "Internal" else rb"internalField"
    found = re.search(rb"(?:^|\s)" + key + rb"\s+([^\s;]+)([^;]*);", file.body)
    if width is None or found is None:
        return None
    if found[1].startswith(b"#"):
        where, found_in = "/".join(file.path.parts[-2:]), found[1].decode("ascii", "replace")  # alike in all pieces
        warn_of_data("a field that is computed is not read", where=where, found=found_in)
        return None
    if found[1] == b"nonuniform":
        values = file.numbers(width, begin=found.start(2))[0]
        return values if width == 1 else values.reshape(-1, width)
    words = _words(_expanded(found[1] + found[2], file))
    if words[:1] != [b"uniform"] or len(words) != 1 + width:
        said = b" ".join(words).decode("ascii", "replace")
        raise DataError("not a field", where=str(file.path), found=said, allowed=f"uniform and {width} numbers")
    one = np.array(words[1:], np.float64)
    return np.full(cells, one[0]) if width == 1 else np.tile(one, (cells, 1))


def _expanded(text: bytes, file: _File) -> bytes:
    """Return text with the entries that `$name` stands for."""
    entries = _entries(file.path, file.body.partition(b"boundaryField")[0]) if b"$" in text else {}

    def entry(found: re.Match[bytes]) -> bytes:
        if found[1] not in entries:
            allowed = "entries of this file and of those that it includes"
            raise DataError("no such entry", where=str(file.path), found=found[0].decode(), allowed=allowed)
        return entries[found[1]]

    for _ in range(DEEPEST):
        text = MACRO.sub(entry, text)
    return text


def _entries(path: Path, text: bytes, depth: int = 0) -> dict[bytes, bytes]:
    """Return the entries of a file and of those that it includes, by name; later ones count."""
    text = COMMENT.sub(b"", text)
    found = dict[bytes, bytes]()
    for name in re.findall(rb'#include\w*\s+"([^"]+)"', text) if depth < DEEPEST else ():
        case = re.sub(r"^(\$FOAM_CASE|<case>)", str(path.parent.parent), name.decode("utf-8", "replace"))
        beside = path.parent / case
        found |= _entries(beside, read_file(beside), depth + 1)
    return found | dict(re.findall(rb"([\w.:]+)\s+([^;{}#]*);", text))
