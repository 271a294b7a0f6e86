"""Vectors on regular grids: files, formulas and arrays behind one contract, `VectorSource`.

A file has vectors as an array with an axis of three components, the last or the first one, or as three arrays of
scalars, which are named together: `array="u,v,w"`. Two names, "u,v", are a flow without a third component. Without
a name the only array of vectors is taken, or the arrays of `KNOWN_NAMES`. Every format of volumes may hold vectors.
On an unstructured grid they are those of points or of cells; see `clusterviz.flow.cells`.

Components are along the axes x, y and z of the world, whatever the direction of the grid is. `order` names the axes of
stored components, "zyx" for files of NumPy programs; `scale` converts units, such as that of time.

Time steps are an axis of the array, or files that a pattern of names stands for. Numbers in the names that skip a step
are an error: a flow that is interpolated over a hole would look like one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.data import open_source
from clusterviz.data.axes import Subset, first_parts
from clusterviz.data.field import open_vector_field
from clusterviz.data.grid_files import by_numbers
from clusterviz.data.header import check_box, check_dtype, check_step
from clusterviz.data.series import check_same, files_of_pattern
from clusterviz.data.source import Grid, Index, Source
from clusterviz.errors import DataError

KNOWN_NAMES = ("u,v,w", "U,V,W", "vx,vy,vz", "Vx,Vy,Vz", "ux,uy,uz", "velocity_x,velocity_y,velocity_z", "VX,VY,VZ")
"""Names of three arrays that are taken together where none is named."""


class VectorSource(Protocol):
    """Vectors at the samples of a regular grid.

    Attributes
    ----------
    times : of the time steps, ascending; () if the flow is steady
    """

    @property
    def name(self) -> str: ...

    @property
    def grid(self) -> Grid: ...

    @property
    def times(self) -> tuple[float, ...]: ...

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the vectors of the half-open box [begin, end).

        Returns
        -------
        vectors : float32 or float64 (z, y, x, 3), components along x, y, z of the world per unit of time, owned by the
            caller; NaN where there are none
        """
        ...

    def at_time(self, step: int) -> VectorSource: ...


def index_from_world_vectors(vectors: NDArray[Any], grid: Grid) -> NDArray[Any]:
    """Return vectors of the world (…, 3) in samples along x, y, z of a grid per unit of time, of the same dtype."""
    return _turned(vectors, np.linalg.inv(grid.world_from_index[:3, :3]).astype(vectors.dtype))


def index_from_world(points: NDArray[Any], grid: Grid) -> NDArray[np.float64]:
    """Return points of the world (n, 3) as float64 indices of samples along x, y, z."""
    return _turned(
        np.asarray(points, np.float64) - np.asarray(grid.origin), np.linalg.inv(grid.world_from_index[:3, :3])
    )


def world_from_index(indices: NDArray[Any], grid: Grid) -> NDArray[np.float64]:
    """Return indices of samples along x, y, z, (n, 3), as points of the world, float64."""
    matrix = grid.world_from_index
    found = _turned(np.asarray(indices, np.float64), matrix[:3, :3])
    found += matrix[:3, 3]
    return found


def _turned(vectors: NDArray[Any], matrix: NDArray[Any]) -> NDArray[Any]:
    """Return a matrix times vectors (…, 3); a diagonal one, of most grids, without waiting for the threads of BLAS."""
    is_diagonal = (matrix == np.diag(np.diagonal(matrix))).all()
    found: NDArray[Any] = vectors * np.diagonal(matrix) if is_diagonal else vectors @ matrix.T
    return found


class VectorArray:
    """Vectors in memory.

    Parameters
    ----------
    values : numbers (z, y, x, 3), or (steps, z, y, x, 3) with `times`; components along x, y, z of the world
    grid : positions of the samples; by default 1 apart from the world's origin
    times : of the steps, ascending

    Raises
    ------
    DataError
        Not vectors, a grid of another shape, or times that do not ascend.
    """

    def __init__(
        self, values: NDArray[Any], grid: Grid | None = None, times: Sequence[float] = (), name: str = "array"
    ) -> None:
        check_dtype(values.dtype, name)
        if values.ndim != 4 + bool(times) or values.shape[-1] != 3 or 0 in values.shape:
            allowed = "(steps, z, y, x, 3)" if times else "(z, y, x, 3)"
            raise DataError("not vectors", where=name, found=values.shape, allowed=allowed)
        if times and (len(times) != len(values) or not (np.diff(times) > 0).all()):
            raise DataError("impossible times", where=name, found=times, allowed=f"{len(values)} that ascend")
        shape: Index = values.shape[-4:-1]
        if grid is not None and grid.shape_zyx != shape:
            raise DataError("the grid does not fit the vectors", where=name, found=grid.shape_zyx, allowed=shape)
        self.name, self.grid, self.times = name, grid or Grid(shape), tuple(float(time) for time in times)
        self._steps, self._step = values if times else values[None], 0
        self._dtype = _dtype([values.dtype])

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        (z, y, x), (z_end, y_end, x_end) = begin_zyx, end_zyx
        return np.array(self._steps[self._step, z:z_end, y:y_end, x:x_end], self._dtype, order="C", copy=True)

    def at_time(self, step: int) -> VectorArray:
        found = VectorArray.__new__(VectorArray)
        found.__dict__ |= self.__dict__ | {"_step": check_step(step, self.times, self.name)}
        return found


def _dtype(dtypes: Sequence[np.dtype[Any]]) -> np.dtype[Any]:
    """Return float32 for small types, float64 for others."""
    return np.dtype(np.float32 if all(np.can_cast(each, np.float32) for each in dtypes) else np.float64)


@dataclass(frozen=True)
class ComponentVectors:
    """Vectors of which each component is a source of scalars; see `VectorSource`.

    Attributes
    ----------
    components : along x, y, z; None is zero everywhere
    open_step : function that opens a time step
    """

    name: str
    grid: Grid
    components: tuple[Source | None, ...]
    scale: float
    times: tuple[float, ...]
    open_step: Callable[[int], VectorSource]

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        dtype = _dtype([source.dtype for source in self.components if source])
        found = np.zeros((*check_box(begin_zyx, end_zyx, self.grid.shape_zyx), 3), dtype)
        for component, source in enumerate(self.components):
            if source:
                found[..., component] = source.read(begin_zyx, end_zyx)
        if self.scale != 1:
            found *= dtype.type(self.scale)
        return found

    def at_time(self, step: int) -> VectorSource:
        found = self.open_step(check_step(step, self.times, self.name))
        if found.grid.shape_zyx != self.grid.shape_zyx:
            what = "time steps of different shapes"
            raise DataError(what, where=found.name, found=found.grid.shape_zyx, allowed=self.grid.shape_zyx)
        return found


def open_vectors(
    path: str | Path,
    array: str | None = None,
    time: int | None = None,
    order: str = "xyz",
    scale: float = 1.0,
    interval: float = 1.0,
) -> VectorSource:
    """Open vectors by name; only headers are read.

    Parameters
    ----------
    path : a file with a volume, a pattern of names of files, which are time steps, or `field:NAME[:SIZE[:STEPS]]`
    array : name of the array of vectors, or of three arrays of components, "u,v,w"
    time : number of the time step, from 0; None: the first
    order : the axes of the stored components, such as "zyx"
    interval : time between two steps of files

    Raises
    ------
    DataError
        As `open_source`, the array holds no vectors, an impossible order, scale or interval, or time steps are missing.
    """
    text = str(path)
    check_components(text, order, scale, interval)
    if text.startswith("field:"):
        return open_vector_field(text, scale).at_time(time or 0)
    files = files_of_pattern(text)
    numbers = _step_numbers(files, text)
    names, parts = _parts(text, array, time)
    stored = [slab for part in parts if part and (slab := getattr(part, "slab", None))]
    steps = max([slab.time_steps for slab in stored], default=1)
    times = tuple(interval * number for number in (numbers if len(files) > 1 else range(steps))) if steps > 1 else ()
    reopen = partial(open_vectors, path, names, order=order, scale=scale, interval=interval)
    first = next(part for part in parts if part)
    placed = tuple(parts[order.index(axis)] for axis in "xyz")
    name = f"{text}:{names}" if names else text
    return ComponentVectors(name, first.grid, placed, scale, times, lambda step: reopen(time=step))


def check_components(where: str, order: str, scale: float, interval: float = 1.0) -> None:
    """Refuse an impossible order of components, scale, or time between steps; see `open_vectors`."""
    if sorted(order) != ["x", "y", "z"]:
        raise DataError("impossible order of components", where=where, found=repr(order), allowed="xyz, zyx, yxz, …")
    for key, number in (("scale", scale), ("interval", interval)):
        if not np.isfinite(number) or number == 0 or (key == "interval" and number < 0):
            raise DataError(f"impossible {key}", where=where, found=number, allowed="a finite number, not 0")


def _parts(path: str, array: str | None, time: int | None) -> tuple[str | None, list[Source | None]]:
    """Return the names of arrays, and the source of each stored component; None: it is zero."""
    if array is None:
        try:
            return None, _components(path, None, time)
        except DataError as error:
            for known in KNOWN_NAMES:
                try:
                    _at_first_step(path, Subset(known.split(",")[0], time))
                except DataError:
                    continue
                return _parts(path, known, time)
            raise error from None
    names = [name.strip() for name in array.split(",")]
    if len(names) == 1:
        return array, _components(path, array, time)
    if len(names) not in (2, 3):
        raise DataError("impossible names of arrays", where=path, found=array, allowed="two or three: u,v,w")
    found = [_at_first_step(path, Subset(each, time))[0] for each in names]
    for other in found[1:]:
        check_same(found[0], other)
    return array, [*found, *[None] * (3 - len(found))]


def _components(path: str, array: str | None, time: int | None) -> list[Source | None]:
    first, subset = _at_first_step(path, Subset(array, time, channel=0, vectors=True))
    slab = getattr(first, "slab", None)
    channels = slab.channels if slab else 1
    if channels != 3:
        where = f"{path}:{array}" if array else path
        found = (
            f"{channels} component{'s' if channels > 1 else ''} in {' × '.join(map(str, slab.shape)) if slab else '1'}"
        )
        allowed = "3 components; or array: u,v,w for arrays of one"
        raise DataError("not vectors", where=where, found=found, allowed=allowed)
    return [first, *(open_source(path, subset=replace(subset, channel=channel)) for channel in (1, 2))]


def _at_first_step(path: str, subset: Subset) -> tuple[Source, Subset]:
    """Open a source at a time step, by default the first one; return it, and the subset with the step."""
    return first_parts(lambda part: open_source(path, subset=part), subset, ("time",))[:2]


def _step_numbers(files: Sequence[str], where: str) -> list[float]:
    """Return the times of files in steps, by the numbers in their names: 0, 1, 2, … if these are even."""
    keys = [[number for number, _ in by_numbers(Path(file)) if number >= 0] for file in files]
    varying = [column for column in zip(*keys, strict=False) if len(set(column)) == len(files)]
    if len(files) < 2 or len({len(key) for key in keys}) > 1 or len(varying) != 1:
        return [float(number) for number in range(len(files))]
    numbers = np.array(varying[0])
    gaps = np.diff(numbers)
    least = int(gaps.min())
    if (gaps % least == 0).all() and (gaps > least).any():
        hole = int(numbers[np.flatnonzero(gaps > least)[0]]) + least
        found = f"{len(files)} files with steps {numbers[0]} to {numbers[-1]}, but none with {hole}"
        raise DataError("time steps are missing", where=where, found=found, allowed=f"one file each {least}")
    return [float(number - numbers[0]) / least for number in numbers]
