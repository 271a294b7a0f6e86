"""Labels, such as the ids of segmented cells, as small numbers: what is drawn is a float32, which holds no large id.

Known labels become their places in a list, so that they stay apart. Where there are too many for a list, labels become
one of a few numbers by a hash, as in Neuroglancer; different labels may share a number then, and 0 stays 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.volume.presets import MAX_LABELS
from clusterviz.data.axes import Hyperslab
from clusterviz.data.source import Grid, Index, Source
from clusterviz.errors import DataError

Labels = tuple[int, ...] | Literal["hashed"]
"""Labels that are drawn as 0, 1, 2, …, while others are drawn as their count; or all as numbers by a hash."""


@dataclass(frozen=True)
class LabelSource:
    """Volume of small numbers, one for each label of another volume."""

    stored: Source
    labels: Labels

    @property
    def name(self) -> str:
        return self.stored.name

    @property
    def grid(self) -> Grid:
        return self.stored.grid

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.uint16)

    @property
    def slab(self) -> Hyperslab | None:
        return getattr(self.stored, "slab", None)

    @property
    def version(self) -> str:
        return getattr(self.stored, "version", "")

    def at_time(self, time: int) -> LabelSource | None:
        found = getattr(self.stored, "at_time", lambda step: None)(time)
        return replace(self, stored=found) if found is not None else None

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        samples = self.stored.read(begin_zyx, end_zyx)
        return hashed(samples) if self.labels == "hashed" else places(samples, self.labels)


def as_labels(source: Source, labels: Labels | None) -> Source:
    """Return a source whose labels are small numbers; the source itself without `labels`, or if it is one already."""
    inner: Any = source
    while hasattr(inner, "source"):  # wrapped by a guard or another grid
        inner = inner.source
    if labels is None or isinstance(inner, LabelSource):
        return source
    if source.dtype.kind not in "iu":
        raise DataError("labels of no integer type", where=source.name, found=source.dtype, allowed="integers")
    return LabelSource(source, labels)


def places(samples: NDArray[Any], labels: tuple[int, ...]) -> NDArray[np.uint16]:
    """Return the place of each sample in a list, or the length of the list."""
    limits = np.iinfo(samples.dtype)
    known = [(label, place) for place, label in enumerate(labels) if limits.min <= label <= limits.max]
    ordered = np.array([label for label, _ in sorted(known)], samples.dtype)
    at = np.append([place for _, place in sorted(known)], len(labels)).astype(np.uint16)
    found = np.searchsorted(ordered, samples)
    found[ordered.take(found, mode="clip") != samples] = len(ordered)
    return at[found]


def hashed(samples: NDArray[Any]) -> NDArray[np.uint16]:
    """Return a number from 1 to `MAX_LABELS` − 1 for each sample other than 0, by the last steps of SplitMix64."""
    mixed = samples.astype(np.uint64)
    with np.errstate(over="ignore"):
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            mixed ^= mixed >> np.uint64(shift)
            mixed *= np.uint64(factor)
        mixed ^= mixed >> np.uint64(31)
    return np.where(samples == 0, 0, 1 + mixed % np.uint64(MAX_LABELS - 1)).astype(np.uint16)
