"""Files that an unstructured grid is read from: pieces of a parallel grid, and time steps of a series.

A .pvtu file names its pieces, a decomposed case of OpenFOAM has a folder for each, a .pvd file names pieces and time
steps, a file series of ParaView (.vtu.series) time steps. A pattern such as `part_*.vtu` or `disk.e.4.*` stands for the
files that match it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import read_file, read_xml
from clusterviz.errors import DataError, warn_of_data

SERIES = (".pvd", ".series")
"""Extensions of files that list time steps, each a file of its own."""


@dataclass(frozen=True)
class GridFile:
    """File with a grid or a piece of one.

    Attributes
    ----------
    path : of the file, which may be missing
    time : number of a time step in it (int), or its time (float); None: the last one
    """

    path: Path
    time: float | None = None

    @property
    def size(self) -> int:
        return max(1, self.path.stat().st_size) if self.path.exists() else 1


def grid_files(path: Path, time: float | None = None) -> list[GridFile]:
    """Return the files of a grid's pieces, in their order; one file for a grid that is not in pieces.

    Parameters
    ----------
    time : number of a time step (int), or its time (float); None: the last one
    """
    if re.search(r"[*?[]", path.name) and not path.exists():
        found = sorted(path.parent.glob(path.name), key=by_numbers)
        if not found:
            raise DataError("no file matches", where=str(path))
        return [piece for each in found for piece in grid_files(each, time)]
    kind = path.suffix.lower()
    if kind in SERIES:
        steps = _pvd_steps(path) if kind == ".pvd" else _series_steps(path)
        times = np.array(sorted(steps))
        files = steps[times[choose_step(times, time, str(path))]]
        return [piece for each in files for piece in grid_files(path.parent / each)]
    pieces = _pieces(path) if kind == ".pvtu" else []
    if kind == ".foam" and not (path.parent / "constant" / "polyMesh").exists():
        pieces = [folder / path.name for folder in sorted(path.parent.glob("processor[0-9]*"), key=by_numbers)]
    return [GridFile(each, time) for each in pieces or [path]]


def choose_step(times: NDArray[Any], time: float | None, where: str) -> int:
    """Return the number of the step that a number (int) or a time (float) names; None: the last one, with a warning."""
    if time is None:
        if len(times) > 1:
            found = f"{len(times)} from {times[0]:g} to {times[-1]:g}"
            # Without the file, as each piece of a grid says it.
            warn_of_data("the last time step is taken", where="", found=found, allowed="time: a number, or a time")
        return max(0, len(times) - 1)
    if isinstance(time, int) and 0 <= time < len(times):
        return time
    if not isinstance(time, int) and len(times):
        nearest = int(np.abs(times - time).argmin())
        if abs(times[nearest] - time) <= 1e-6 * max(abs(time), float(np.ptp(times)) / len(times)):
            return nearest
    allowed = f"0 to {len(times) - 1}, or a time from {times[0]} to {times[-1]}" if len(times) else "no time steps"
    raise DataError("no such time step", where=where, found=time, allowed=allowed)


def _pieces(path: Path) -> list[Path]:
    pieces = [each.get("Source", "") for each in _tags(path, "PUnstructuredGrid", "Piece")]
    if not pieces or not all(pieces):
        raise DataError("no pieces", where=str(path), allowed="<Piece Source=…>")
    return [path.parent / name for name in pieces]


def _pvd_steps(path: Path) -> dict[float, list[str]]:
    listed = [(each.get("timestep", "0"), each.get("file", "")) for each in _tags(path, "Collection", "DataSet")]
    return _steps(listed, path)


def _series_steps(path: Path) -> dict[float, list[str]]:
    content = read_file(path)
    try:
        files = json.loads(content)["files"]
        listed = [(each["time"], each["name"]) for each in files]
    except (ValueError, TypeError, KeyError) as error:
        allowed = '{"files": [{"name": …, "time": …}, …]}'
        raise DataError("not a list of a file series", where=str(path), allowed=allowed) from error
    return _steps(listed, path)


def _steps(listed: Sequence[tuple[Any, Any]], path: Path) -> dict[float, list[str]]:
    found = dict[float, list[str]]()
    for time, name in listed:
        try:
            number = float(time)
        except (TypeError, ValueError):
            number = np.nan
        if not np.isfinite(number) or not isinstance(name, str) or not name:
            raise DataError("not a time and a file", where=str(path), found=f"{time}, {name}")
        found.setdefault(number, []).append(name)
    if not found:
        raise DataError("lists no files", where=str(path))
    return found


def _tags(path: Path, kind: str, tag: str) -> list[dict[str, str]]:
    root = read_xml(path, "VTK's XML")
    if root.tag != "VTKFile" or root.get("type") != kind:
        raise DataError("not a VTK file of this type", where=str(path), found=root.get("type", root.tag), allowed=kind)
    return [each.attrib for each in root.iter(tag)]


def by_numbers(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts names by the numbers in them."""
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in re.split(r"(\d+)", path.name)]
