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

from clusterviz.data.files import kind_of, readable, require_file
from clusterviz.data.storage import numbers_of_words
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
Lines = Sequence[list[bytes]]


def read_avs(path: Path) -> UnstructuredGrid:
    """Read a file.

    Raises
    ------
    DataError
        Not such a file, damaged or truncated, unknown cells or numbers, or as of `linearised`.
    """
    where = str(path)
    require_file(path)
    with readable(path):
        content = path.read_bytes()
    lines = [line.split() for line in re.sub(rb"(?m)^[ \t]*#.*$", b"", content).splitlines() if line.strip()]
    if not lines or len(lines[0]) != 5 or not all(word.isdigit() and len(word) < 16 for word in lines[0]):
        allowed = "text that begins with five counts"
        raise DataError("not AVS-UCD", where=where, found=kind_of(content[:348]), allowed=allowed)
    nodes, cells, of_nodes, of_cells, _ = map(int, lines[0])
    text = _Text(lines[1:], where)
    table = text.numbers(nodes, 4)
    rows, points = _row_of(table[:, 0], "nodes", where), table[:, 1:]
    listed = text.take(cells)
    blocks, order = _blocks(listed, rows, where)
    arrays = text.data(nodes, rows, "nodes") if of_nodes else {}
    numbers = _row_of(numbers_of_words([row[0] for row in listed], np.float64), "cells", where)
    on_cells = text.data(cells, numbers, "cells") if of_cells else {}
    on_cells["avsucd:material"] = numbers_of_words([row[1] for row in listed], np.int64)
    return linearised(points, blocks, arrays, {name: array[order] for name, array in on_cells.items()}, where)


class _Text:
    """Lines of words that are left."""

    def __init__(self, lines: Lines, where: str) -> None:
        self._lines, self._at, self._where = lines, 0, where

    def take(self, count: int) -> Lines:
        """Return the next lines."""
        found, self._at = self._lines[self._at : self._at + count], self._at + count
        if len(found) != count:
            raise DataError("truncated", where=self._where, found=f"{len(self._lines)} lines", allowed=self._at)
        return found

    def numbers(self, count: int, width: int) -> NDArray[np.float64]:
        """Return the numbers of the next lines, (count, width)."""
        rows = self.take(count)
        if any(len(row) < width for row in rows):
            raise DataError("truncated: a line lacks numbers", where=self._where, allowed=width)
        try:
            return numbers_of_words([word for row in rows for word in row[:width]], np.float64).reshape(count, width)
        except ValueError as error:
            raise DataError(f"not a number: {error}", where=self._where) from error

    def data(self, count: int, rows: dict[int, int], noun: str) -> dict[str, NDArray[Any]]:
        """Return the arrays of numbered nodes or cells by name, (count,) or (count, components)."""
        sizes = [int(word) for word in self.take(1)[0][1:]]
        labels = [b" ".join(row).partition(b",")[0].decode("utf-8", "replace") for row in self.take(len(sizes))]
        table = self.numbers(count, 1 + sum(sizes))
        own = _rows_of(table[:, 0], rows, noun, self._where)
        values = np.empty((count, sum(sizes)))
        values[own] = table[:, 1:]
        ends, found = np.cumsum(sizes), dict[str, NDArray[Any]]()
        for label, end, size in zip(labels, ends.tolist(), sizes, strict=True):
            array = values[:, end - size : end]
            found[label.strip().replace(" ", "_")] = array[:, 0] if size == 1 else array
        return found


def _row_of(numbers: NDArray[np.float64], noun: str, where: str) -> dict[int, int]:
    """Return the row of each number."""
    found = {number: row for row, number in enumerate(numbers.astype(np.int64).tolist())}
    if len(found) != len(numbers):
        raise DataError(f"two {noun} have one number", where=where, found=f"{len(numbers) - len(found)} times")
    return found


def _rows_of(numbers: NDArray[np.float64], rows: dict[int, int], noun: str, where: str) -> NDArray[np.int64]:
    """Return the rows of numbers."""
    listed = numbers.astype(np.int64).tolist()
    unknown = [number for number in listed if number not in rows]
    if unknown:
        raise DataError(f"unknown numbers of {noun}", where=where, found=unknown[0])
    return np.array([rows[number] for number in listed], np.int64)


def _blocks(
    listed: Lines, rows: dict[int, int], where: str
) -> tuple[list[tuple[str, NDArray[np.int64]]], NDArray[np.int64]]:
    """Return the cells of each kind, and their places in the file."""
    of_kind: dict[bytes, list[int]] = {}
    for number, row in enumerate(listed):
        if len(row) < 3 or row[2] not in KINDS or len(row) != 3 + len(KINDS[row[2]][1]):
            found, allowed = b" ".join(row).decode("utf-8", "replace"), b", ".join(KINDS).decode()
            raise DataError("not a cell", where=where, found=found, allowed=f"number, material, {allowed}, nodes")
        of_kind.setdefault(row[2], []).append(number)
    blocks, order = list[tuple[str, NDArray[np.int64]]](), [np.zeros(0, np.int64)]
    for word, places in of_kind.items():
        kind, corners = KINDS[word]
        words = [each for number in places for each in listed[number][3:]]
        nodes = _rows_of(numbers_of_words(words, np.float64), rows, "nodes", where).reshape(-1, len(corners))
        blocks.append((kind, nodes[:, corners]))
        order.append(np.array(places))
    return blocks, np.concatenate(order)
