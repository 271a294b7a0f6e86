"""Tables of rows of floats, read a row a lane: four floats with one load, turned into vectors.

A gathering load for each float would take several times as long.
"""

from __future__ import annotations

from typing import Any

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import BYTES, F32, I64, Value

WIDTH = 4  # floats of a load


def rows(code: Code, address: Value, row: Value, floats: int, element: Any = F32) -> list[Value]:
    """The floats of a row of a table for each lane.

    Parameters
    ----------
    row : int32, which one
    floats : in a row; a multiple of four
    element : F32 or F64
    """
    numbers = row.to(I64) * (BYTES[element] * floats)
    places = [address + numbers.lane(lane) for lane in range(code.lanes)]
    columns: list[Value] = []
    for part in range(0, floats, WIDTH):
        quads = [code.load(element, place + BYTES[element] * part, WIDTH) for place in places]
        # Column j of a group holds rows j, j + 4, ... so that each quarter of the lanes is turned by itself.
        groups = [quads[start::WIDTH] for start in range(WIDTH)]
        columns += _turned(code, [_joined(code, group) for group in groups])
    return columns


def _joined(code: Code, parts: list[Value]) -> Value:
    while len(parts) > 1:
        parts = [code.join(a, b) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def _turned(code: Code, a: list[Value]) -> list[Value]:
    """Rows of four lanes each become columns: of every quarter, and for all of them at once."""
    n = a[0].lanes

    def mixed(first: Value, second: Value, pattern: tuple[int, int, int, int]) -> Value:
        # Numbers from 4 on are the second vector's.
        lanes = [quarter + (p if p < WIDTH else n + p - WIDTH) for quarter in range(0, n, WIDTH) for p in pattern]
        return code.shuffle(first, second, lanes)

    low, high = (0, 4, 1, 5), (2, 6, 3, 7)
    pairs = [mixed(a[0], a[1], low), mixed(a[2], a[3], low), mixed(a[0], a[1], high), mixed(a[2], a[3], high)]
    left, right = (0, 1, 4, 5), (2, 3, 6, 7)
    return [mixed(pairs[k], pairs[k + 1], side) for k in (0, 2) for side in (left, right)]
