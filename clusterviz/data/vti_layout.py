"""Layout of a .vti file: attributes and arrays of its XML, and the positions of their data.

The parser notes byte positions instead of inline data, and stops at appended data (raw bytes are not XML), so a file of
any size takes little memory.

References
----------
VTK File Formats, "XML File Formats", https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from clusterviz.data.files import kind_of, readable, start_of
from clusterviz.errors import DataError

CHUNK = 1 << 16
Attributes = Mapping[str, str]


@dataclass(frozen=True)
class VtiArray:
    """DataArray of a .vti file; its inline text is at bytes `text_begin` to `text_end` of the file."""

    name: str
    on_cells: bool
    active: bool
    attributes: Attributes
    text_begin: int
    text_end: int


@dataclass
class VtiLayout:
    """Attributes of the file, image, pieces and appended data, and the arrays in order."""

    file: Attributes = field(default_factory=dict)
    image: Attributes = field(default_factory=dict)
    pieces: list[Attributes] = field(default_factory=list)
    arrays: list[VtiArray] = field(default_factory=list)
    appended_encoding: str | None = None
    appended_begin: int = 0


class _AppendedReached(Exception):  # noqa: N818 - ends the parsing; nothing is wrong
    pass


class _Scan:
    """One pass over the XML; `stack` holds the names of the open tags."""

    def __init__(self) -> None:
        self.layout = VtiLayout()
        self.stack: list[str] = []
        self.attributes: Attributes = {}
        self.text_begin: int | None = None
        self.active = {False: "", True: ""}
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        layout, parent = self.layout, self.stack[-1] if self.stack else ""
        self.stack.append(tag)
        if tag == "VTKFile":
            layout.file = attributes
        elif tag == "ImageData":
            layout.image = attributes
        elif tag == "Piece":
            layout.pieces.append(attributes)
        elif tag in ("PointData", "CellData"):
            self.active[tag == "CellData"] = attributes.get("Scalars", "")
        elif tag == "DataArray" and parent in ("PointData", "CellData"):
            self.attributes = attributes
            self._await_text()
        elif tag == "AppendedData":
            layout.appended_encoding = attributes.get("encoding", "base64")
            layout.appended_begin = self.parser.CurrentByteIndex
            raise _AppendedReached

    def _end(self, tag: str) -> None:
        self.stack.pop()
        parent, end = self.stack[-1] if self.stack else "", self.parser.CurrentByteIndex
        if parent == "DataArray":
            self._await_text()  # the data follows the information keys
        elif tag == "DataArray" and parent in ("PointData", "CellData"):
            begin = end if self.text_begin is None else self.text_begin
            name, on_cells = self.attributes.get("Name", ""), parent == "CellData"
            active = bool(name) and self.active[on_cells] == name
            self.layout.arrays.append(VtiArray(name, on_cells, active, self.attributes, begin, end))

    def _await_text(self) -> None:
        self.text_begin = None
        self.parser.CharacterDataHandler = self._text

    def _text(self, _: str) -> None:
        if self.text_begin is None:
            self.text_begin = self.parser.CurrentByteIndex
        self.parser.CharacterDataHandler = None


def scan_vti(path: Path) -> VtiLayout:
    """Read the XML of the file at `path` up to its appended data.

    Raises
    ------
    DataError
        Not XML, ends early, or not a VTK file of type ImageData.
    """
    scan, layout = _Scan(), VtiLayout()
    with readable(path), path.open("rb") as file:
        try:
            while chunk := file.read(CHUNK):
                scan.parser.Parse(chunk, False)
            scan.parser.Parse(b"", True)
        except _AppendedReached:
            scan.layout.appended_begin = _after_underscore(file, scan.layout.appended_begin, path)
        except expat.ExpatError as error:
            found = kind_of(start_of(path))
            raise DataError(
                f"truncated or damaged XML: {error}", where=str(path), found=found, allowed="VTK's XML"
            ) from error
        finally:
            layout = scan.layout
            scan.parser.StartElementHandler = scan.parser.EndElementHandler = None  # no reference cycle stays
    kind: Any = layout.file.get("type")
    if kind != "ImageData":
        raise DataError("not a VTK image file", where=str(path), found=f"type {kind}", allowed="VTKFile type ImageData")
    return layout


def _after_underscore(file: Any, tag_begin: int, path: Path) -> int:
    """Return the position of the first appended byte, after the underscore that follows the AppendedData tag."""
    file.seek(tag_begin)
    head = file.read(4096)
    found = head.find(b"_", head.find(b">") + 1)
    if found < 0:
        raise DataError("truncated: the appended data is missing", where=str(path))
    return int(tag_begin + found + 1)
