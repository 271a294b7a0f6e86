"""Raw files: samples without a header, described by a YAML sidecar.

For `head.raw` the sidecar is `head.raw.yaml`:

    shape: [84, 128, 128]        # samples along z, y, x; x varies fastest in the file; also [time, z, y, x] and
                                 # [time, channel, z, y, x]
    dtype: uint8                 # int8 … int64, uint8 … uint64, float16 … float64
    byte_order: little           # little | big; default little
    header_bytes: 0              # bytes before the first sample; default 0
    spacing: [1.0, 1.0, 2.0]     # world units between samples along x, y, z; default 1
    origin: [0.0, 0.0, 0.0]      # world position x, y, z of the first sample; default 0
    direction: [1, 0, 0, 0, 1, 0, 0, 0, 1]   # 3 × 3 row by row; column a is the unit vector of axis a; default identity

The file must have exactly the length that the sidecar implies, since a wrong shape would show noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from clusterviz.data.axes import Subset, select, unnamed_axes
from clusterviz.data.files import refuse_array, require_file
from clusterviz.data.header import check_dtype, check_size, make_grid, triple
from clusterviz.data.storage import FileBytes, FileRange, StridedSource, slab_source
from clusterviz.errors import DataError
from clusterviz.scene.yaml_text import parse_yaml, read_text, yaml_problem

KEYS = ("shape", "dtype", "byte_order", "header_bytes", "spacing", "origin", "direction")


def sidecar_of(path: Path) -> Path:
    return path.with_name(path.name + ".yaml")


def open_raw(path: Path, subset: Subset) -> StridedSource:
    size = require_file(path)
    refuse_array(subset.array, path)
    sidecar = sidecar_of(path)
    if not sidecar.exists():
        raise DataError(
            "a raw file needs a sidecar that describes it",
            where=str(path),
            allowed=f"{sidecar} with the keys {', '.join(KEYS)}",
        )
    where, keys = str(sidecar), _read_sidecar(sidecar)
    stored = _stored_dtype(keys, where)
    shape = _integers(keys["shape"], "shape", where)
    slab = select(shape, unnamed_axes(shape, subset), subset, where)
    (header_bytes,) = _integers([keys.get("header_bytes", 0)], "header_bytes", where)
    direction = np.asarray(keys.get("direction", np.eye(3).ravel().tolist()), object)
    if direction.size != 9:
        raise DataError(
            "impossible direction", where=where, found=keys.get("direction"), allowed="nine numbers, row by row"
        )
    columns = np.array([triple(row, where) for row in direction.reshape(3, 3)])
    spacing = triple(keys.get("spacing", (1, 1, 1)), where)
    grid = make_grid(slab.shape_zyx, columns * np.array(spacing), keys.get("origin", (0, 0, 0)), where)
    needed = slab.samples * stored.itemsize
    check_size(size, header_bytes + needed, str(path), exact=True)
    storage = FileBytes([FileRange(path, header_bytes, needed)])
    return slab_source(str(path), slab, grid, storage, stored)


def _read_sidecar(sidecar: Path) -> Mapping[str, Any]:
    require_file(sidecar)
    try:
        keys = parse_yaml(read_text(sidecar, DataError))
    except yaml.YAMLError as error:
        raise DataError(f"not YAML: {yaml_problem(error)}", where=str(sidecar)) from error
    if not isinstance(keys, dict):
        raise DataError("not a list of keys and values", where=str(sidecar), found=keys, allowed=", ".join(KEYS))
    unknown, missing = set(keys) - set(KEYS), {"shape", "dtype"} - set(keys)
    if unknown:
        raise DataError("unknown key", where=str(sidecar), found=sorted(map(str, unknown)), allowed=", ".join(KEYS))
    if missing:
        raise DataError("missing key", where=str(sidecar), found=sorted(keys), allowed=f"also {sorted(missing)}")
    return keys


def _stored_dtype(keys: Mapping[str, Any], where: str) -> np.dtype[Any]:
    order = keys.get("byte_order", "little")
    if order not in ("little", "big"):
        raise DataError("impossible byte_order", where=where, found=order, allowed="little, big")
    try:
        stored = np.dtype(str(keys["dtype"]))
    except TypeError as error:
        allowed = "uint8, int16, float32, …"
        raise DataError("impossible dtype", where=where, found=keys["dtype"], allowed=allowed) from error
    check_dtype(stored, where)
    return stored.newbyteorder("<" if order == "little" else ">")


def _integers(values: Any, key: str, where: str) -> list[int]:
    if not isinstance(values, list) or not all(type(n) is int and n >= 0 for n in values):
        raise DataError(f"impossible {key}", where=where, found=values, allowed="whole numbers, 0 or more")
    return values
