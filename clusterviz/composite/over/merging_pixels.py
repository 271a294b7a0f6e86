"""Compiled loops of the merge operators of projections."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from clusterviz.composite.over import merge_code, vector_code
from clusterviz.composite.over.intrinsics import compiled, define_intrinsic
from clusterviz.composite.over.job import FLOAT, MAXIMUM, MINIMUM, SUM


def _stepper(merge: Callable[[Any, Any, Any], Any], pixels: int) -> Any:
    """Return a function that merges `pixels` pixels of front and behind; the target may be either of them."""

    def emit(builder: Any, target: Any, front: Any, behind: Any) -> None:
        floats = (vector_code.load(builder, FLOAT, address, pixels) for address in (front, behind))
        vector_code.store(builder, FLOAT, target, merge(builder, *floats))

    return define_intrinsic(3, emit)


def _merger(merge: Callable[[Any, Any, Any], Any]) -> Any:
    """Return a loop over pixels: 64 bytes at a time, then single pixels."""
    four, one = _stepper(merge, 4), _stepper(merge, 1)

    @compiled
    def merge_all(target, front, behind, count):  # type: ignore[no-untyped-def]
        i, size = 0, 16 * count
        while i < size - 63:
            four(target + i, front + i, behind + i)
            i += 64
        while i < size:
            one(target + i, front + i, behind + i)
            i += 16

    return merge_all


_maximum, _minimum = _merger(merge_code.maximum), _merger(merge_code.minimum)
_total, _stretch = _merger(merge_code.add), _merger(merge_code.stretch)


@compiled
def merge_pixels(operator, target, front, behind, count):  # type: ignore[no-untyped-def]
    """Merge `count` float pixels at addresses: target = front merged with behind; the target may be either of them."""
    if operator == MAXIMUM:
        _maximum(target, front, behind, count)
    elif operator == MINIMUM:
        _minimum(target, front, behind, count)
    elif operator == SUM:
        _total(target, front, behind, count)
    else:
        _stretch(target, front, behind, count)
