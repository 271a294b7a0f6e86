"""Volumes of one grid and type that belong together: time steps, channels, or time steps of channels.

They are files, which a list or a pattern of names gives, or volumes in one file with axes of time and channels.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, UnnamedPartError, first_parts
from clusterviz.data.derived import DerivedSource
from clusterviz.data.grid_files import by_numbers
from clusterviz.data.source import Grid, Index, Source
from clusterviz.errors import DataError

Open = Callable[[str, Subset], Source]
MOST_STEPS = 100_000


@dataclass(frozen=True)
class Series:
    """Volumes with the same grid and type.

    Attributes
    ----------
    sources : the channels of the first time step, then those of the next one, and so on
    axes : letters of the axes along which there are several: t, c, both, or none
    counts : their number along each of these axes
    channels : names of the channels; empty if there is one
    omero : how each channel is shown, as of `ZarrSource`; empty if no file says it
    """

    sources: tuple[Source, ...]
    axes: str = ""
    counts: tuple[int, ...] = ()
    channels: tuple[str, ...] = ()
    omero: tuple[Any, ...] = ()

    @property
    def indices(self) -> list[tuple[int, ...]]:
        return list(product(*map(range, self.counts)))

    @property
    def labels(self) -> list[str]:
        """Text for each volume that says which one it is, before other text."""
        names = {"t": "time step", "c": "channel"}
        return [
            "".join(f"{names[axis]} {i}, " for axis, i in zip(self.axes, index, strict=True)) for index in self.indices
        ]


@dataclass(frozen=True)
class FileOfSeries(DerivedSource):
    """Volume of a file that is one of several time steps."""

    time: int
    time_steps: int

    @property
    def grid(self) -> Grid:
        found: Grid = self.source.grid
        return found

    @property
    def slab(self) -> Hyperslab:
        """The volume's part of the file, at its time step."""
        shape = self.grid.shape_zyx
        found = getattr(self.source, "slab", None) or Hyperslab(shape, (None,) * 3, shape)
        return replace(found, time=self.time, time_steps=self.time_steps)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        found: NDArray[Any] = self.source.read(begin_zyx, end_zyx)
        return found


def files_of_pattern(text: str) -> list[str]:
    """Return the files that a pattern with *, ? or [] stands for, 2 before 10; the text itself if it is a name."""
    path = Path(text)
    if ":" in text or not re.search(r"[*?[]", path.name) or path.exists():
        return [text]
    found = [str(each) for each in sorted(path.parent.glob(path.name), key=by_numbers)]
    if not found:
        raise DataError("no file matches", where=text)
    return found


def open_step(files: Sequence[str], subset: Subset, opener: Open, where: str) -> Source:
    steps, time = range(len(files)), 0 if len(files) == 1 else subset.time
    found, allowed = f"{len(files)} time steps", f"time: 0 to {steps[-1]}"
    if time is None:
        raise UnnamedPartError("time", steps, where=where, found=found, allowed=allowed)
    if time >= len(files):
        raise DataError("no such time step", where=where, found=f"{time}, and {found}", allowed=allowed)
    return FileOfSeries(opener(files[time], replace(subset, time=None)), time, len(files))


def open_series(names: Sequence[str], along: str, subset: Subset, opener: Open) -> Series:
    """Open files as time steps or channels; of one file all its time steps and channels, unless the subset names one.

    Parameters
    ----------
    names : files and patterns; if they are in alphabetical order, 2 comes before 10
    along : what several files are: time or channels
    """
    if list(names) == sorted(names):  # as a shell lists them
        names = sorted(names, key=lambda name: by_numbers(Path(name)))
    files = [file for name in names for file in files_of_pattern(name)]
    letter = "t" if along == "time" else "c"
    first, _, _ = first_parts(lambda part: opener(files[0], part), subset, ("time", "channel"))
    slab = getattr(first, "slab", None)
    within = {"t": slab.time_steps, "c": slab.channels} if slab else {"t": 1, "c": 1}
    given = {"t": subset.time, "c": subset.channel}
    within = {axis: 1 if given[axis] is not None else count for axis, count in within.items()}
    if len(files) > 1 and within[letter] > 1:
        text = f"files with several {'time steps' if along == 'time' else 'channels'}"
        raise DataError(text, where=files[0], found=within[letter], allowed="one such file, or --time or --channel")
    counts = within | ({letter: len(files)} if len(files) > 1 else {})
    if prod(counts.values()) > MOST_STEPS:
        raise DataError("too many volumes", where=files[0], found=prod(counts.values()), allowed=MOST_STEPS)
    sources = []
    for t, c in product(range(counts["t"]), range(counts["c"])):
        file = files[{"t": t, "c": c}[letter] if len(files) > 1 else 0]
        time = t if within["t"] > 1 else subset.time
        channel = c if within["c"] > 1 else subset.channel
        sources.append(opener(file, replace(subset, time=time, channel=channel)))
        check_same(sources[0], sources[-1])
    axes = "".join(axis for axis in "tc" if counts[axis] > 1)
    channels = tuple(slab.channel_names) if slab and within["c"] > 1 else ()
    if counts["c"] > 1 and not channels:
        stems = [Path(file).name.split(".")[0] for file in files]
        channels = tuple(stems if len(set(stems)) == counts["c"] else map(str, range(counts["c"])))
    omero = getattr(getattr(first, "source", first), "omero", ()) if within["c"] > 1 else ()
    return Series(tuple(sources), axes, tuple(counts[axis] for axis in axes), channels, tuple(omero))


def check_same(first: Source, other: Source) -> None:
    """Refuse a volume of another shape, type or grid."""
    if first.grid.shape_zyx != other.grid.shape_zyx or first.dtype != other.dtype:
        each = [f"{' × '.join(map(str, s.grid.shape_zyx[::-1]))} {s.dtype}" for s in (other, first)]
        what = "volumes of different shape or type"
    elif np.abs(first.grid.world_from_index - other.grid.world_from_index).max() > 1e-3 * min(first.grid.spacing):
        each = [f"spacing {s.grid.spacing}, origin {s.grid.origin}" for s in (other, first)]
        what = "volumes on different grids"
    else:
        return
    raise DataError(what, where=other.name, found=each[0], allowed=f"{each[1]}, as of {first.name}")
