"""Pixels of two parts merged by the operators of projections, compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from clusterviz.composite.over import merge_code, vector_code
from clusterviz.composite.over.instructions import compiled, instruction
from clusterviz.composite.over.job_layout import FLOAT, MAXIMUM, MINIMUM, SUM


def _stepper(merge: Callable[[Any, Any, Any], Any], pixels: int) -> Any:
    """target = front merged with behind, so many pixels; the target may be either of them."""

    def emit(builder: Any, target: Any, front: Any, behind: Any) -> None:
        floats = (vector_code.load(builder, FLOAT, address, pixels) for address in (front, behind))
        vector_code.store(builder, FLOAT, target, merge(builder, *floats))

    return instruction(3, emit)


# 64 bytes, and one pixel.
_maximum_4, _maximum_1 = _stepper(merge_code.maximum, 4), _stepper(merge_code.maximum, 1)
_minimum_4, _minimum_1 = _stepper(merge_code.minimum, 4), _stepper(merge_code.minimum, 1)
_total_4, _total_1 = _stepper(merge_code.total, 4), _stepper(merge_code.total, 1)
_stretch_4, _stretch_1 = _stepper(merge_code.stretch, 4), _stepper(merge_code.stretch, 1)


@compiled
def merge_pixels(operator, target, front, behind, count):  # type: ignore[no-untyped-def]
    """target = front merged with behind, addresses of so many pixels of floats; the target may be either of them."""
    i, size = 0, 16 * count
    if operator == MAXIMUM:
        while i < size - 63:
            _maximum_4(target + i, front + i, behind + i)
            i += 64
        while i < size:
            _maximum_1(target + i, front + i, behind + i)
            i += 16
    elif operator == MINIMUM:
        while i < size - 63:
            _minimum_4(target + i, front + i, behind + i)
            i += 64
        while i < size:
            _minimum_1(target + i, front + i, behind + i)
            i += 16
    elif operator == SUM:
        while i < size - 63:
            _total_4(target + i, front + i, behind + i)
            i += 64
        while i < size:
            _total_1(target + i, front + i, behind + i)
            i += 16
    else:
        while i < size - 63:
            _stretch_4(target + i, front + i, behind + i)
            i += 64
        while i < size:
            _stretch_1(target + i, front + i, behind + i)
            i += 16
