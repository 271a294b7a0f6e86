"""Gmsh's meshes (.msh), versions 2, 4.0 and 4.1, text or binary: nodes, elements, and data of one time step.

Nodes and elements have numbers, by which data refers to them; those without a value are NaN. Of several time steps one
is read; data without this step is that of the step before. The numbers of entities become the arrays `gmsh:physical`
and `gmsh:geometrical`, where they are not all 0. `$ElementNodeData` is ignored, with a warning.

References
----------
Gmsh reference manual, "MSH file format", "MSH file format version 2 (Legacy)" and "Node ordering".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import read_file
from clusterviz.data.grid_files import choose_step
from clusterviz.data.unstructured import SECOND_ORDER, UnstructuredGrid, linearised, nodes_of
from clusterviz.errors import DataError, warn_of_data

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
_FIRST = """line triangle quad tetra hexahedron wedge pyramid line3 triangle6 quad9 tetra10 hexahedron27 wedge18
pyramid14 vertex quad8 hexahedron20 wedge15 pyramid13 triangle9 triangle10 triangle12 triangle15 triangle15 triangle21
line4 line5 line6 tetra20 tetra35 tetra56"""
KINDS = dict(enumerate(_FIRST.split(), 1)) | {36: "quad16", 37: "quad25", 38: "quad36", 90: "wedge40", 91: "wedge75"}
KINDS |= {92: "hexahedron64", 93: "hexahedron125"}
"""meshio's names of types of elements."""
EDGES = {
    "tetra": [(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)],
    "pyramid": [(0, 1), (0, 3), (0, 4), (1, 2), (1, 4), (2, 3), (2, 4), (3, 4)],
    "wedge": [(0, 1), (0, 2), (0, 3), (1, 2), (1, 4), (2, 5), (3, 4), (3, 5), (4, 5)],
    "hexahedron": [(0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)],
}
SIDES = {
    "pyramid14": [(0, 1, 2, 3)],
    "wedge18": [(0, 1, 3, 4), (0, 2, 3, 5), (1, 2, 4, 5)],
    "hexahedron27": [(0, 1, 2, 3), (0, 1, 4, 5), (0, 3, 4, 7), (1, 2, 5, 6), (2, 3, 6, 7), (4, 5, 6, 7), (*range(8),)],
}
"""Corners between which nodes on edges, and on faces and inside, lie, in Gmsh's order."""
COMPONENTS = 1, 3, 9
VERSIONS = {"2": "2", "2.1": "2", "2.2": "2", "4.0": "4.0", "4": "4.0", "4.1": "4.1"}
DATA, UNREAD = ("NodeData", "ElementData"), ("ElementNodeData",)


def read_gmsh(path: Path, time: float | None = None) -> UnstructuredGrid:
    where = str(path)
    sections = list(_sections(read_file(path), where))
    names = [name for name, _ in sections]
    if names[:1] != ["MeshFormat"]:
        raise DataError("not a mesh of Gmsh 2 or 4", where=where, found=names[:1], allowed="$MeshFormat")
    form = _Form.of(sections[0][1], where)
    heads = [body.partition(b"\n")[0].split() for name, body in sections if name == "Nodes"]
    if form.version == "4.0" and not form.order and heads and len(heads[0]) == 4:
        form = replace(form, version="4.1")  # of programs that call it 4, as Gmsh calls 4.0
    if unread := [name for name in UNREAD if name in names]:
        warn_of_data("not read", where=where, found=", ".join(f"${name}" for name in unread))
    physical, data, nodes, elements = dict[tuple[int, int], int](), [], list[tuple[Ints, Floats]](), list[_Elements]()
    for name, body in sections[1:]:
        values = _Values(body, form, f"{where}: ${name}")
        if name == "Entities":
            physical |= _entities(values)
        elif name == "Nodes":
            nodes += _nodes(values)
        elif name == "Elements":
            elements += _elements(values)
        elif name in DATA:
            data.append(_Data.read(name, values))
    if not nodes:
        raise DataError("no nodes", where=where, found=", ".join(names), allowed="$Nodes")
    numbers, points = (np.concatenate(each) for each in zip(*nodes, strict=True))
    rows = NumberedRows(numbers)
    blocks = [each.block(rows, where) for each in elements]
    own = NumberedRows(np.concatenate([np.zeros(0, np.int64), *(each.numbers for each in elements)]))
    chosen = _at_step(data, time, where) if data or time is not None else []
    of_elements = _arrays(chosen, "ElementData", own, where) | _tags(elements, physical)
    return linearised(points, blocks, _arrays(chosen, "NodeData", rows, where), of_elements, where)


def _sections(content: bytes, where: str) -> Iterator[tuple[str, bytes]]:
    start, at = re.compile(rb"\$(\w+)[^\n]*\n"), 0
    while found := start.search(content, at):
        name = found[1]
        end = content.find(b"$End" + name, found.end())
        if end < 0:
            what = f"truncated: no $End{name.decode()}"
            raise DataError(what, where=where, allowed="sections $Name … $EndName")
        yield name.decode(), content[found.end() : end]
        at = end + len(name) + 4


@dataclass(frozen=True)
class _Form:
    """How numbers are written: a value of `VERSIONS`, the byte order, "" of text, and the type of counts."""

    version: str
    order: str
    size: str

    @classmethod
    def of(cls, body: bytes, where: str) -> _Form:
        head, _, rest = body.partition(b"\n")
        words = head.decode("ascii", "replace").split()
        if len(words) != 3 or words[0] not in VERSIONS or words[1] not in "01" or words[2] not in ("4", "8"):
            allowed = f"version {', '.join(VERSIONS)}; 0 or 1; 4 or 8"
            raise DataError("an unknown format", where=f"{where}: $MeshFormat", found=" ".join(words), allowed=allowed)
        order = "" if words[1] == "0" else "<" if rest[:4] == b"\1\0\0\0" else ">"
        return cls(VERSIONS[words[0]], order, f"u{words[2]}")


class _Values:
    """Numbers of a section, one after another, behind lines of text."""

    def __init__(self, body: bytes, form: _Form, where: str) -> None:
        self._body, self.form, self.where, self._at = body, form, where, 0
        self._numbers: Floats | None = None

    def line(self) -> str:
        end = self._body.find(b"\n", self._at)
        line, self._at = self._body[self._at : end], end + 1
        if end < 0:
            raise DataError("truncated", where=self.where, found="no further line")
        return line.decode("utf-8", "replace").strip()

    def count(self) -> int:
        line = self.line()
        if not re.fullmatch(r"\d{1,18}", line):
            raise DataError("not a count", where=self.where, found=repr(line))
        return int(line)

    def rows(self, count: int, ints: int, floats: int = 0, kind: str = "i4") -> tuple[Ints, Floats]:
        """Return rows of whole numbers (count, ints), of a type in binary files, and of others (count, floats)."""
        if self.form.order:
            fields = [("ints", self.form.order + kind, (ints,)), ("floats", self.form.order + "f8", (floats,))]
            row, begin = np.dtype(fields), self._at
            self._need(count, row.itemsize, len(self._body) - begin)
            end = begin + count * row.itemsize
            found = np.ndarray(count, row, self._body[begin:end] if end > begin else bytes(1))
            self._at += count * row.itemsize
            return found["ints"].astype(np.int64), found["floats"].astype(np.float64)
        if self._numbers is None:
            self._numbers, self._at = numbers_of_text(self._body[self._at :], np.float64, self.where), 0
        begin, width = self._at, ints + floats
        self._need(count, width, len(self._numbers) - begin)
        self._at += count * width
        table = self._numbers[begin : self._at].reshape(count, width)
        return table[:, :ints].astype(np.int64), table[:, ints:]

    def rest(self) -> Ints:
        return numbers_of_text(self._body[self._at :], np.int64, self.where)

    def sizes(self, count: int) -> list[int]:
        found: list[int] = self.rows(1, count, kind=self.form.size)[0][0].tolist()
        return found

    def _need(self, count: int, width: int, left: int) -> None:
        if count < 0 or count * width > left:
            raise DataError("truncated, or the header lies about its size", where=self.where, found=f"{count} rows")


def _entities(values: _Values) -> dict[tuple[int, int], int]:
    """Return the first physical group of each entity, by dimension and number."""
    found = dict[tuple[int, int], int]()
    for dimension, count in enumerate(values.sizes(4)):
        for _ in range(count):
            tag = int(values.rows(1, 1, 3 if dimension == 0 and values.form.version == "4.1" else 6)[0][0, 0])
            groups = values.rows(1, values.sizes(1)[0])[0][0]
            if len(groups):
                found[dimension, tag] = int(groups[0])
            if dimension:
                values.rows(1, values.sizes(1)[0])
    return found


def _nodes(values: _Values) -> Iterator[tuple[Ints, Floats]]:
    version = values.form.version
    if version == "2":
        numbers, points = values.rows(values.count(), 1, 3)
        yield numbers[:, 0], points
        return
    for _ in range(values.sizes(4 if version == "4.1" else 2)[0]):
        entity = values.rows(1, 3)[0][0].tolist()
        dimension, count = entity[0 if version == "4.1" else 1], values.sizes(1)[0]
        parameters = dimension if entity[2] else 0
        if version == "4.1":
            numbers = values.rows(count, 1, kind=values.form.size)[0]
            points = values.rows(count, 0, 3 + parameters)[1]
        else:
            numbers, points = values.rows(count, 1, 3 + parameters)
        yield numbers[:, 0], points[:, :3]


@dataclass(frozen=True)
class _Elements:
    """Elements of one type: their numbers (k,), nodes (k, c), and physical group and entity (k, 2).

    Of versions 4 the group is that of the entity, a pair of dimension and number.
    """

    kind: int
    numbers: Ints
    nodes: Ints
    tags: Ints
    entity: tuple[int, int] | None = None

    def block(self, rows: NumberedRows, where: str) -> tuple[str, Ints]:
        kind = KINDS[self.kind]
        corners, is_known = rows.of(self.nodes)
        if not is_known.all():
            raise DataError("an element has an unknown node", where=where, found=int(self.nodes[~is_known][0]))
        return kind, corners[:, ORDERS[kind]] if kind in ORDERS else corners


def _orders() -> dict[str, list[int]]:
    """Return the places of VTK's nodes of each kind of second order."""
    found = {}
    for kind, order in SECOND_ORDER.items():
        linear = next(name for name in EDGES if kind.startswith(name))
        corners = [node for node in order.stored if len(node) == 1]
        nodes = [*corners, *EDGES[linear], *SIDES.get(kind, ())]
        found[kind] = [nodes.index(node) for node in order.stored]
    return found


ORDERS = _orders()


def _elements(values: _Values) -> Iterator[_Elements]:
    version = values.form.version
    if version == "2":
        yield from _binary_elements(values) if values.form.order else _text_elements(values)
        return
    size = values.form.size if version == "4.1" else "i4"
    for _ in range(values.sizes(4 if version == "4.1" else 2)[0]):
        first, second, kind = values.rows(1, 3)[0][0].tolist()
        dimension, tag = (first, second) if version == "4.1" else (second, first)
        count = values.sizes(1)[0]
        table = values.rows(count, 1 + _nodes_of(kind, values.where), kind=size)[0]
        tags = np.tile(np.array([0, tag]), (count, 1))
        yield _Elements(kind, table[:, 0], table[:, 1:], tags, (dimension, tag))


def _binary_elements(values: _Values) -> Iterator[_Elements]:
    left = values.count()
    while left > 0:
        kind, count, tags = values.rows(1, 3)[0][0].tolist()
        table = values.rows(count, 1 + max(0, tags) + _nodes_of(kind, values.where))[0]
        left -= max(1, count)
        yield _tagged(kind, table[:, 0], table[:, 1:], tags)


def _text_elements(values: _Values) -> Iterator[_Elements]:
    """Yield elements of equal type and number of tags together, in their order."""
    count = values.count()
    numbers = values.rest()
    starts, at, listed = list[int](), 0, numbers.tolist()
    for _ in range(count):
        if at + 3 > len(listed):
            raise DataError("truncated", where=values.where, found=f"{len(starts)} elements", allowed=count)
        starts.append(at)
        at += 3 + max(0, listed[at + 2]) + _nodes_of(listed[at + 1], values.where)
    if at > len(listed):
        raise DataError("truncated", where=values.where, found=f"{len(listed)} numbers", allowed=at)
    begin = np.array(starts, np.int64)
    heads = numbers[begin[:, None] + np.arange(3)] if count else np.zeros((0, 3), np.int64)
    for kind, tags in np.unique(heads[:, 1:], axis=0).tolist():
        own = begin[(heads[:, 1:] == (kind, tags)).all(axis=1)]
        width = max(0, tags) + _nodes_of(kind, values.where)
        yield _tagged(kind, numbers[own], numbers[own[:, None] + 3 + np.arange(width)], tags)


def _tagged(kind: int, numbers: Ints, table: Ints, tags: int) -> _Elements:
    """Return elements whose rows have tags, of which the first is the group and the second the entity, and nodes."""
    two = np.zeros((len(table), 2), np.int64)
    two[:, : min(tags, 2)] = table[:, : min(tags, 2)]
    return _Elements(kind, numbers, table[:, max(0, tags) :], two)


def _nodes_of(kind: int, where: str) -> int:
    if kind not in KINDS:
        raise DataError("elements of an unknown type", where=where, found=kind, allowed=", ".join(map(str, KINDS)))
    return nodes_of(KINDS[kind])


def numbers_of_text(text: bytes, dtype: type[np.float64] | type[np.int64], where: str) -> NDArray[Any]:
    """Return the numbers in text, several times as fast as from words."""
    try:
        return np.fromstring(text, dtype, sep=" ")
    except ValueError as error:
        what = "not a whole number" if dtype is np.int64 else "not a number"
        raise DataError(what, where=where, found="a word among numbers") from error


class NumberedRows:
    """Rows of numbered nodes or elements."""

    def __init__(self, numbers: Ints) -> None:
        self.count = len(numbers)
        self._order = np.argsort(numbers, kind="stable")
        self._sorted = numbers[self._order]

    def of(self, numbers: Ints) -> tuple[Ints, NDArray[np.bool_]]:
        """Return the rows of numbers (…), and which of these are known."""
        if not self.count:
            return np.zeros(numbers.shape, np.int64), np.zeros(numbers.shape, bool)
        place = np.minimum(np.searchsorted(self._sorted, numbers), self.count - 1)
        return self._order[place], self._sorted[place] == numbers


@dataclass(frozen=True)
class _Data:
    """Values (k, c) of nodes or elements, by their numbers (k,), at a step: its time and number."""

    section: str
    name: str
    step: tuple[float, int]
    numbers: Ints
    values: Floats

    @classmethod
    def read(cls, section: str, values: _Values) -> _Data:
        words = [values.line().strip('"') for _ in range(values.count())]
        times = [float(values.line()) for _ in range(values.count())]
        step, components, count = [*(int(values.line()) for _ in range(values.count())), 0, 0, 0][:3]
        if components not in COMPONENTS:
            raise DataError("impossible components", where=values.where, found=components, allowed=COMPONENTS)
        numbers, found = values.rows(count, 1, components)
        name = words[0] if words and words[0] else section
        return cls(section, name, (times[0] if times else 0.0, step), numbers[:, 0], found)


def _at_step(data: Sequence[_Data], time: float | None, where: str) -> list[_Data]:
    """Return the data of each name at a time step, or of the step before if it has none there, or of its first."""
    steps = sorted({each.step for each in data})
    times = np.array([each[0] for each in steps])
    if len(np.unique(times)) < len(times):
        times = np.array([each[1] for each in steps], float)
    number = choose_step(times, time, where)
    found = dict[tuple[str, str], list[_Data]]()
    for each in sorted(data, key=lambda one: one.step):
        known = found.setdefault((each.section, each.name), [each])
        if each.step == known[0].step and each is not known[0]:
            known.append(each)  # of another partition
        elif known[0].step < each.step <= steps[number]:
            found[each.section, each.name] = [each]
    return [each for known in found.values() for each in known]


def _arrays(data: Sequence[_Data], section: str, rows: NumberedRows, where: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of all nodes or elements by name, (n,) or (n, components), NaN where there is no value."""
    found, unknown = dict[str, NDArray[Any]](), 0
    for each in data:
        if each.section != section:
            continue
        own, is_known = rows.of(each.numbers)
        array = found.setdefault(each.name, np.full((rows.count, each.values.shape[1]), np.nan))
        if array.shape[1] != each.values.shape[1]:
            raise DataError("data with different components", where=where, found=each.name)
        array[own[is_known]] = each.values[is_known]
        unknown += int(np.count_nonzero(~is_known))
    if unknown:
        warn_of_data(f"values of ${section} are left out", where=where, found=f"{unknown} with unknown numbers")
    return {name: array[:, 0] if array.shape[1] == 1 else array for name, array in found.items()}


def _tags(elements: Sequence[_Elements], physical: Mapping[tuple[int, int], int]) -> dict[str, NDArray[Any]]:
    """Return the numbers of physical groups and of entities of all elements, unless all are 0."""
    tags = [np.zeros((0, 2), np.int64)]
    for each in elements:
        tags.append(each.tags.copy())
        if each.entity is not None:
            tags[-1][:, 0] = physical.get(each.entity, 0)
    groups, entities = np.concatenate(tags).T
    return {f"gmsh:{name}": own for name, own in (("physical", groups), ("geometrical", entities)) if own.any()}
