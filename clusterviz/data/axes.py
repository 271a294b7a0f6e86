"""Axes of a stored array: z, y and x, and the index taken along time and channels."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any, Literal, TypeVar

from clusterviz.content.volume.section import Scattered
from clusterviz.data.header import check_shape
from clusterviz.data.source import Index
from clusterviz.errors import DataError

MAX_LISTED = 12  # names in a message
Part = Literal["array", "time", "channel"]
"""Key of a scene that names a part of a file."""
NOUNS: dict[Part, str] = {"array": "array", "time": "time step", "channel": "channel"}
Opened = TypeVar("Opened")


@dataclass(frozen=True)
class Choice:
    """Choice of the first of several parts of a file, of which none is named.

    Attributes
    ----------
    key : that names a part
    parts : names or numbers, at least two; the first is chosen
    """

    key: Part
    parts: tuple[Any, ...]
    noun: str

    def __str__(self) -> str:
        names = f" ({listed(self.parts)})" if isinstance(self.parts[0], str) else ""
        return f"{self.noun} {self.parts[0]} of {len(self.parts)}{names}"


class UnnamedPartError(DataError):
    """A file has several arrays, time steps or channels, and none is named.

    Attributes
    ----------
    choice : that is made where a default is wanted
    """

    def __init__(
        self, key: Part, parts: Sequence[Any], *, where: str, found: object = None, allowed: object, noun: str = ""
    ) -> None:
        self.choice = Choice(key, tuple(parts), noun or NOUNS[key])
        several = f"{self.choice.noun.removesuffix('s')}s"
        super().__init__(f"several {several}: name one", where=where, found=found, allowed=allowed)


def first_parts(
    opener: Callable[[Subset], Opened], subset: Subset, keys: Collection[str] = tuple(NOUNS)
) -> tuple[Opened, Subset, list[Choice]]:
    """Open the part of a file that a subset names, and the first of those that it leaves open.

    Returns
    -------
    subset : with all names that it needs
    choices : that were made
    """
    choices = list[Choice]()
    while True:
        try:
            return opener(subset), subset, choices
        except UnnamedPartError as error:
            choice = error.choice
            if choice.key not in keys or getattr(subset, choice.key) is not None:
                raise
            subset = replace(subset, **{choice.key: choice.parts[0]})
            choices.append(choice)


def warn_of_choices(path: str, choices: Sequence[Choice], key: str = "", option: str = "-D ") -> None:
    """Say on one line which parts of a file are drawn, and how to take others.

    Parameters
    ----------
    key : of the file's entry in the scene and a point; empty if the last name of a key is enough
    """
    if choices:
        drawn = ", ".join(map(str, choices))
        others = " ".join(f"{option}{shlex.quote(f'{key}{choice.key}={choice.parts[1]}')}" for choice in choices)
        warnings.warn(f"{path}: {drawn} is drawn; for others give {others}", stacklevel=2)


def listed(names: Sequence[object]) -> str:
    """Return names on one line; at most `MAX_LISTED` of them."""
    return ", ".join(map(str, names[:MAX_LISTED])) + (", …" if len(names) > MAX_LISTED else "")


@dataclass(frozen=True)
class Subset:
    """Part of a file that is the volume.

    Attributes
    ----------
    array : name of the array, for files with several
    time : number of the time step, from 0
    channel : number of the channel, from 0, or its name if the file has names
    spaced : the spacing is given elsewhere, so coordinates that are on no lattice count as even
    scattered : the file holds points, whose values are interpolated on this grid
    vectors : the array holds vectors: an axis of three without a name, the last or first of space, is their channels
    """

    array: str | None = None
    time: int | None = None
    channel: int | str | None = None
    spaced: bool = False
    scattered: Scattered | None = None
    vectors: bool = False


@dataclass(frozen=True)
class Hyperslab:
    """Volume inside an array with more axes.

    Attributes
    ----------
    shape : of the whole array, slowest axis first
    index : for each axis the index taken along it; None along z, y and x
    time, channel : the index taken along these axes
    time_steps, channels : their number; 1 without such an axis
    channel_names : one a channel, or empty
    """

    shape: tuple[int, ...]
    index: tuple[int | None, ...]
    shape_zyx: Index
    time: int = 0
    time_steps: int = 1
    channel: int = 0
    channels: int = 1
    channel_names: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        return prod(self.shape)

    @property
    def label(self) -> str:
        """Suffix of the volume's name that says which part of the file it is."""
        parts = [f":time={self.time}"] if self.time_steps > 1 else []
        if self.channels > 1:
            parts.append(f":channel={self.channel_names[self.channel] if self.channel_names else self.channel}")
        return "".join(parts)

    def box(self, begin_zyx: Index, end_zyx: Index) -> tuple[slice, ...]:
        """Return the part of the array that holds a box of the volume."""
        spans = [slice(begin, end) for begin, end in zip(begin_zyx, end_zyx, strict=True)]
        kept = iter(spans[3 - self.index.count(None) :])
        return tuple(next(kept) if i is None else slice(i, i + 1) for i in self.index)

    def strides(self, itemsize: int, fortran: bool = False) -> tuple[int, Index]:
        """Return the bytes before the volume's first sample, and the strides in bytes along z, y and x."""
        axes = range(len(self.shape))
        strides = [itemsize * prod(self.shape[:axis] if fortran else self.shape[axis + 1 :]) for axis in axes]
        offset = sum(stride * (i or 0) for stride, i in zip(strides, self.index, strict=True))
        kept = [stride for stride, i in zip(strides, self.index, strict=True) if i is None]
        z, y, x = [itemsize * self.samples] * (3 - len(kept)) + kept
        return offset, (z, y, x)


def select(shape: Sequence[int], axes: str, subset: Subset, where: str, channel_names: Sequence[str] = ()) -> Hyperslab:
    """Return the volume that `subset` names in an array.

    Parameters
    ----------
    shape : slowest axis first
    axes : a letter an axis: T time, C channel, any other space. The last three axes of space are z, y and x; if there
        are more, axes with one sample are dropped.
    """
    sizes = [int(n) for n in shape]
    check_shape([min(sizes), 1, 1] if sizes else [], where)
    if axes.count("T") > 1 or axes.count("C") > 1:
        raise DataError("not a scalar volume", where=where, found=f"axes {axes} {tuple(sizes)}", allowed="one channel")
    time_steps, channels = (sizes[axes.index(letter)] if letter in axes else 1 for letter in "TC")
    names = tuple(channel_names) if len(channel_names) == channels else ()
    time = _pick("time", time_steps, subset.time, (), where)
    channel = _pick("channel", channels, subset.channel, names, where)
    space = [axis for axis, letter in enumerate(axes) if letter not in "TC"]
    for axis in [axis for axis in space if sizes[axis] == 1][: max(0, len(space) - 3)]:
        space.remove(axis)
    shape_zyx = check_shape([sizes[axis] for axis in space], where)
    other = {"T": time, "C": channel}
    index = tuple(None if axis in space else other.get(letter, 0) for axis, letter in enumerate(axes))
    return Hyperslab(tuple(sizes), index, shape_zyx, time, time_steps, channel, channels, names)


def unnamed_axes(shape: Sequence[int], subset: Subset) -> str:
    """Return the letters of axes without names.

    They are (time, channel, z, y, x); of four, the first is time unless only a channel is asked for. Vectors are
    (time, z, y, x, channel), or as above, where that axis has three.
    """
    dimensions = len(shape)
    if subset.vectors and shape[-1:] == (3,) and dimensions > 2:
        return {4: "ZYXC", 5: "TZYXC"}.get(dimensions, "Z" * (dimensions - 1) + "C")
    if dimensions == 4 and subset.channel is not None and subset.time is None:
        return "CZYX"
    if subset.vectors and dimensions == 4:
        return "CZYX" if shape[0] == 3 else "ZYXC"
    return {4: "TZYX", 5: "TCZYX"}.get(dimensions, "Z" * dimensions)


def _pick(key: Part, count: int, wanted: int | str | None, names: tuple[str, ...], where: str) -> int:
    noun = NOUNS[key]
    allowed = f"{key}: 0" if count == 1 else f"{key}: 0 to {count - 1}"
    if names:
        allowed += f", or a name: {listed(names)}"
    if wanted is None and count > 1:
        parts = names if len(set(names)) == count else range(count)
        raise UnnamedPartError(key, parts, where=where, found=f"{count} {noun}s", allowed=allowed)
    if wanted is None:
        return 0
    if wanted in names:
        return names.index(str(wanted))
    if not str(wanted).isdecimal() or int(wanted) >= count:
        there = f"{wanted}, and {count} {noun}{'s' if count > 1 else ''}"
        raise DataError(f"no such {noun}", where=where, found=there, allowed=allowed)
    return int(wanted)
