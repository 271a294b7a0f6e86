"""What a rank holds of several volumes for one brick of their domain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from clusterviz.data.source import Index


@dataclass(frozen=True, eq=False)
class Portions:
    """The samples of one brick.

    Attributes
    ----------
    index_zyx : of the brick in the domain
    samples : of each volume (z, y, x), as its `Cut` and `read_bricks` say; None where nothing of it can be seen
    around : margin and reach of each volume's cut, with which they were read
    """

    index_zyx: Index
    samples: tuple[NDArray[Any] | None, ...]
    around: tuple[tuple[int, int], ...] = ()

    @property
    def size(self) -> int:
        """Samples of all volumes."""
        return sum(part.size for part in self.samples if part is not None)
