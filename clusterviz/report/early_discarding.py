"""Fragments that `quality.early_discarding` does not store in a frame. Pictures are those without it, bit for bit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass
from typing import TypeVar

from clusterviz.report.kbuffer_counts import KBufferCounts

Counts = TypeVar("Counts", "EarlyDiscarding", KBufferCounts)


@dataclass(frozen=True)
class EarlyDiscarding:
    """Counts of one frame.

    Attributes
    ----------
    stored : fragments stored, those of pixels that were drawn again twice, and one for each pixel where some were left
        out
    pixels : pixels where some were left out, without those that were drawn again
    redrawn : pixels drawn again with all fragments, as their rays did not end in front of what was left out
    """

    stored: int = 0
    pixels: int = 0
    redrawn: int = 0

    def __str__(self) -> str:
        """Return a summary in one line."""
        return (
            f"{self.stored:,} fragments stored, some left out at {self.pixels:,} pixels; "
            f"{self.redrawn:,} pixels drawn again, none wrong"
        )


def all_counts(each: Iterable[Counts | None]) -> Counts | None:
    """Sum the counts of several pieces, ranks or frames; None if nothing was counted."""
    some = [one for one in each if one is not None]
    return type(some[0])(*map(sum, zip(*map(astuple, some), strict=True))) if some else None
