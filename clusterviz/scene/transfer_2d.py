"""Two-dimensional transfer functions: tables of opacity, or colour and opacity, over scalar and gradient magnitude.

A table is a .npy file with a row for each magnitude and a column for each scalar, at equal distances over the ranges in
the scene. It is interpolated bilinearly and constant beyond its edges.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from clusterviz.errors import SceneError, guard
from clusterviz.input_files import require_regular_file
from clusterviz.scene.checks import check_path
from clusterviz.scene.field_types import Clim, Section

Floats = NDArray[np.float64]
LARGEST_SIDE = 4096
SHAPES = f"numbers in 0..1, (magnitudes, values) or (magnitudes, values, 4), at most {LARGEST_SIDE} a side"


class Transfer2d(Section):
    """Transfer function of scalar and gradient magnitude, as a table."""

    path: Annotated[str, AfterValidator(check_path)] = Field(
        description="A .npy file of numbers in 0..1, relative to the scene file: opacities (magnitudes, values), or "
        "straight colours and opacities (magnitudes, values, 4), which take the place of cmap."
    )
    values: Clim | None = Field(default=None, description="Data values of the first and last column; default: clim.")
    magnitudes: Clim | None = Field(
        default=None,
        description="Magnitudes of the first and last row, data values per world unit; default: from 0 to a quarter of "
        "clim's range over the smallest spacing.",
    )


class MadeTable(Transfer2d):
    """Table that is made of other keys, not read from a file."""

    def table(self) -> TransferTable:
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class TransferTable:
    """Table of a two-dimensional transfer function with its ranges."""

    opacities: Floats  # float64 (m, v), over one opacity unit distance
    colours: Floats | None  # float64 (m, v, 3), straight RGB; None if the colour map applies
    values: tuple[float, float]  # data values of the first and last column
    magnitudes: tuple[float, float]  # gradient magnitudes of the first and last row, data values per world unit

    @property
    def max_opacity_points(self) -> tuple[Floats, Floats]:
        """Control points (values, opacities) of the maximum over all magnitudes, float64 (v,) each."""
        low, high = self.values
        share = np.linspace(0.0, 1.0, self.opacities.shape[1])
        return low * (1 - share) + high * share, self.opacities.max(axis=0)


def load_table(settings: Transfer2d, *, where: str = "transfer_2d") -> TransferTable:
    """Return the table of a completed volume.

    Raises SceneError: the file cannot be read, or is not a table. Raises ValueError: the volume is not completed.
    """
    if settings.values is None or settings.magnitudes is None:
        raise ValueError("a table needs a completed volume; call complete_scene first")
    if isinstance(settings, MadeTable):
        return settings.table()
    opacities, colours = read_table(settings.path, where=where)
    return TransferTable(opacities, colours, settings.values, settings.magnitudes)


def read_table(path: str, *, where: str = "transfer_2d") -> tuple[Floats, Floats | None]:
    """Read opacities (m, v), and colours (m, v, 3) or None, float64.

    `path`: a .npy file; `where`: the file and key named in errors. Raises SceneError: the file cannot be read, or is
    not a table.
    """
    with guard(SceneError, f"{where}: {path}"):
        require_regular_file(path, SceneError, f"{where}: {path}")
        try:
            status = os.stat(path)
            table = _loaded(path, status.st_mtime_ns, status.st_size)
        except OSError as error:
            raise SceneError(f"cannot read the table: {error.strerror}", where=where, found=path) from None
        except (ValueError, EOFError) as error:
            raise SceneError(f"not a .npy file: {error}", where=where, found=path, allowed=SHAPES) from None
    shaped = (table.ndim == 2 or table.shape[2:] == (4,)) and table.size > 0
    if not shaped or max(table.shape[:2]) > LARGEST_SIDE or table.dtype.kind not in "fiu":
        raise SceneError("not a table", where=f"{where}: {path}", found=f"{table.dtype} {table.shape}", allowed=SHAPES)
    if not ((table >= 0) & (table <= 1)).all():
        raise SceneError("the table is out of range", where=where, found=path, allowed="0 to 1")
    exact: Floats = table.astype(np.float64)
    return (exact, None) if exact.ndim == 2 else (exact[..., 3], exact[..., :3])


@lru_cache(maxsize=2)
def _loaded(path: str, changed: int, size: int) -> NDArray[Any]:
    table = np.array(np.lib.format.open_memmap(path, mode="r"))  # refuses a truncated file
    table.setflags(write=False)
    return table
