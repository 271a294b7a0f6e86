"""AVS-UCD (.avs) as text: numbered nodes and cells, and data of nodes and of cells.

The material of the cells becomes the array `avsucd:material`.

References
----------
AVS Developer's Guide, appendix E, "UCD file format"; https://lanl.github.io/LaGriT/pages/docs/read_avs.html
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import kind_of, read_file
from clusterviz.data.formats.gmsh import NumberedRows, numbers_of_text
from clusterviz.data.unstructured import UnstructuredGrid, linearised
from clusterviz.errors import DataError

KINDS: dict[bytes, tuple[str, tuple[int, ...]]] = {
    b"pt": ("vertex", (0,)),
    b"line": ("line", (0, 1)),
    b"tri": ("triangle", (0, 1, 2)),
    b"quad": ("quad", (0, 1, 2, 3)),
    b"tet": ("tetra", (0, 1, 3, 2)),
    b"pyr": ("pyramid", (1, 2, 3, 4, 0)),
    b"prism": ("wedge", (3, 4, 5, 0, 1, 2)),
    b"hex": ("hexahedron", (4, 5, 6, 7, 0, 1, 2, 3)),
}
"""meshio's names of kinds of cells, and the places of VTK's corners: in a file the top comes first."""


def read_avs(path: Path) -> UnstructuredGrid:
    where, content = str(path), read_file(path)
    lines = [line for line in re.sub(rb"(?m)^[ \t]*#.*$", b"", content).splitlines() if line.strip()]
    counts = lines[0].split() if lines else []
    if len(counts) != 5 or not all(word.isdigit() and len(word) < 16 for word in counts):
        allowed = "text that begins with five counts"
        raise DataError("not AVS-UCD", where=where, found=kind_of(content[:348]), allowed=allowed)
    nodes, cells, of_nodes, of_cells, _ = map(int, counts)
    text = _Text(lines[1:], where)
    table = text.numbers(nodes, 4)
    rows, points = NumberedRows(table[:, 0].astype(np.int64)), table[:, 1:]
    listed = [line.split() for line in text.take(cells)]
    blocks, order = _blocks(listed, rows, where)
    heads = numbers_of_text(b" ".join(word for row in listed for word in row[:2]), np.int64, where)
    if len(heads) != 2 * cells:
        raise DataError("not cells", where=where, found=f"{len(heads)} numbers", allowed=f"{cells} x number, material")
    arrays = text.data(rows, "nodes") if of_nodes else {}
    on_cells = text.data(NumberedRows(heads[::2]), "cells") if of_cells else {}
    on_cells["avsucd:material"] = heads[1::2]
    return linearised(points, blocks, arrays, {name: array[order] for name, array in on_cells.items()}, where)


class _Text:
    """Lines that are left."""

    def __init__(self, lines: Sequence[bytes], where: str) -> None:
        self._lines, self._at, self._where = lines, 0, where

    def take(self, count: int) -> Sequence[bytes]:
        found, self._at = self._lines[self._at : self._at + count], self._at + count
        if len(found) != count:
            raise DataError("truncated", where=self._where, found=f"{len(self._lines)} lines", allowed=self._at)
        return found

    def numbers(self, count: int, width: int) -> NDArray[np.float64]:
        lines = self.take(count)
        found = numbers_of_text(b"\n".join(lines), np.float64, self._where)
        if len(found) != count * width:
            allowed = f"{count} lines of {width}"
            raise DataError("a line lacks numbers", where=self._where, found=f"{len(found)} numbers", allowed=allowed)
        return found.reshape(count, width)

    def data(self, rows: NumberedRows, noun: str) -> dict[str, NDArray[Any]]:
        """Return the arrays of numbered nodes or cells by name, (n,) or (n, components)."""
        sizes = [int(word) for word in self.take(1)[0].split()[1:]]
        labels = [line.partition(b",")[0].decode("utf-8", "replace").strip() for line in self.take(len(sizes))]
        table = self.numbers(rows.count, 1 + sum(sizes))
        values = np.empty((rows.count, sum(sizes)))
        values[_known(rows, table[:, 0].astype(np.int64), noun, self._where)] = table[:, 1:]
        ends, found = np.cumsum(sizes), dict[str, NDArray[Any]]()
        for label, end, size in zip(labels, ends.tolist(), sizes, strict=True):
            array = values[:, end - size : end]
            found[label.replace(" ", "_")] = array[:, 0] if size == 1 else array
        return found


def _known(rows: NumberedRows, numbers: NDArray[np.int64], noun: str, where: str) -> NDArray[np.int64]:
    found, is_known = rows.of(numbers)
    if not is_known.all():
        raise DataError(f"unknown numbers of {noun}", where=where, found=int(numbers[~is_known][0]))
    return found


def _blocks(
    listed: Sequence[list[bytes]], rows: NumberedRows, where: str
) -> tuple[list[tuple[str, NDArray[np.int64]]], NDArray[np.int64]]:
    of_kind: dict[bytes, list[int]] = {}
    for number, row in enumerate(listed):
        if len(row) < 3 or row[2] not in KINDS or len(row) != 3 + len(KINDS[row[2]][1]):
            found, allowed = b" ".join(row).decode("utf-8", "replace"), b", ".join(KINDS).decode()
            raise DataError("not a cell", where=where, found=found, allowed=f"number, material, {allowed}, nodes")
        of_kind.setdefault(row[2], []).append(number)
    blocks, order = list[tuple[str, NDArray[np.int64]]](), [np.zeros(0, np.int64)]
    for word, places in of_kind.items():
        kind, corners = KINDS[word]
        numbers = numbers_of_text(b" ".join(each for number in places for each in listed[number][3:]), np.int64, where)
        if len(numbers) != len(places) * len(corners):
            raise DataError("not a number of a node", where=where, found=f"{len(numbers)} numbers")
        blocks.append((kind, _known(rows, numbers, "nodes", where).reshape(-1, len(corners))[:, corners]))
        order.append(np.array(places))
    return blocks, np.concatenate(order)
