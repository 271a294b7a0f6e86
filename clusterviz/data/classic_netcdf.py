"""Classic netCDF files (versions 1, 2 and 5): the header, and boxes of variables as h5py's datasets give them.

References
----------
NetCDF User's Guide, "File Format Specifications": https://docs.unidata.ucar.edu/nug/current/file_format_specifications.html
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import readable, require_file
from clusterviz.data.header import check_size
from clusterviz.errors import DataError

TYPES = {1: "i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8", 7: "u1", 8: ">u2", 9: ">u4", 10: ">i8", 11: ">u8"}
STREAMING = (1 << 32) - 1, (1 << 64) - 1
"""Numbers of records that stand for "as many as the file holds"."""


@dataclass(frozen=True)
class ClassicDimension:
    """Axis of a variable, as h5py's dimensions: its name, and the coordinate variable if there is one."""

    label: str
    scales: tuple[Any, ...]

    def __len__(self) -> int:
        return len(self.scales)

    def __getitem__(self, number: int) -> Any:
        return self.scales[number]


@dataclass
class ClassicVariable:
    """Variable, with the attributes of h5py's datasets that the reader of netCDF uses.

    Attributes
    ----------
    path, begin : the file, and the offset of the first number in it
    name : with a slash before it
    strides : bytes between neighbours along each axis
    dims : one an axis
    """

    path: Path
    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    begin: int
    attrs: Mapping[str, Any]
    dims: list[ClassicDimension] = field(default_factory=list)
    chunks: None = None

    def __getitem__(self, box: Any) -> NDArray[Any]:
        with readable(self.path):
            content = np.memmap(self.path, np.uint8, "r")
        return np.array(np.ndarray(self.shape, self.dtype, content, self.begin, self.strides)[box])


def read_classic(path: Path) -> dict[str, ClassicVariable]:
    """Return the variables of a file by name; numbers are not read."""
    size, where = require_file(path, (b"CDF",)), str(path)
    with readable(path), path.open("rb") as file:
        version = file.read(4)[3:]
        if version not in (b"\1", b"\2", b"\5"):
            raise DataError("not classic netCDF", where=where, found=f"version {version!r}", allowed="1, 2, 5")
        wide, far = 8 if version == b"\5" else 4, 4 if version == b"\1" else 8

        def data(count: int) -> bytes:
            check_size(size, file.tell() + count, where)
            found = file.read(count)
            file.seek(-count % 4, 1)
            return found

        def number(width: int = wide) -> int:
            return int.from_bytes(data(width), "big")

        def entries() -> Iterator[str]:
            """Yield the names of a list."""
            number(4)
            for _ in range(number()):
                yield data(number()).decode("utf-8", "replace")

        def attributes() -> dict[str, Any]:
            return {name: _attribute(data, _dtype(number(4), where), number()) for name in entries()}

        records = number()
        dimensions = [(name, number()) for name in entries()]
        attributes()
        found = list[tuple[str, list[int], dict[str, Any], np.dtype[Any], int]]()
        for name in entries():
            axes = [number() for _ in range(number())]
            if max(axes, default=0) >= max(1, len(dimensions)):
                raise DataError(f"no such dimension of {name}", where=where, found=max(axes))
            attrs, dtype = attributes(), _dtype(number(4), where)
            number()
            found.append((name, axes, attrs, dtype, number(far)))
    lengths = [length for _, length in dimensions]
    of_record = [bool(axes) and not lengths[axes[0]] for _, axes, *_ in found]  # the axis without a length is records
    bytes_each = [
        dtype.itemsize * prod(lengths[axis] for axis in axes if lengths[axis]) for _, axes, _, dtype, _ in found
    ]
    parts = [count for count, stepped in zip(bytes_each, of_record, strict=True) if stepped]
    step = parts[0] if len(parts) == 1 else sum(-(-count // 4) * 4 for count in parts)
    if records in STREAMING:
        first = min((begin for (*_, begin), stepped in zip(found, of_record, strict=True) if stepped), default=size)
        records = max(0, size - first) // max(1, step)
    variables = dict[str, ClassicVariable]()
    for (name, axes, attrs, dtype, begin), count, stepped in zip(found, bytes_each, of_record, strict=True):
        shape = [lengths[axis] for axis in axes]
        strides = [dtype.itemsize * prod(shape[axis + 1 :]) for axis in range(len(shape))]
        if stepped:
            shape[0], strides[0] = records, step
        if 0 not in shape:
            check_size(size, begin + count + (step * (records - 1) if stepped else 0), where)
        variables[name] = ClassicVariable(path, f"/{name}", dtype, tuple(shape), tuple(strides), begin, attrs)
    for (_, axes, *_), variable in zip(found, variables.values(), strict=True):
        names = [dimensions[axis][0] for axis in axes]
        variable.dims = [ClassicDimension(n, (variables[n],) if n in variables else ()) for n in names]
    return variables


def _dtype(kind: int, where: str) -> np.dtype[Any]:
    if kind not in TYPES:
        raise DataError("unknown type", where=where, found=kind, allowed=f"1 to {len(TYPES)}")
    return np.dtype(TYPES[kind])


def _attribute(data: Any, dtype: np.dtype[Any], count: int) -> Any:
    content = data(count * dtype.itemsize)
    return content.rstrip(b"\0") if dtype.kind == "S" else np.frombuffer(content, dtype)
