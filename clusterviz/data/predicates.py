"""Exact signs of determinants, which decide on which side of a plane or a line a point lies.

A determinant is computed in float64 with a bound of its error. Where the bound leaves the sign open, it is computed
again in whole numbers: every float64 is one, times a power of two.

References
----------
J. R. Shewchuk: Adaptive precision floating-point arithmetic and fast robust geometric predicates, Discrete &
Computational Geometry 18, 1997 (bounds; the exact part is plainer here).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
ERROR = 9 * 2.0**-53
"""Of the sum of the absolute products: seven roundings and terms of second order."""
SMALLEST = 1e-290
"""Determinants below it may have lost digits by underflow."""
CHUNK = 1 << 18


def orientation(a: Floats, b: Floats, c: Floats, d: Floats) -> NDArray[np.int8]:
    """Return the signs of the volumes of tetrahedra, int8 (n,): 1 where a, b, c are counter-clockwise seen from d.

    Parameters
    ----------
    a, b, c, d : float64 (n, 3), finite corners
    """
    return determinant_sign((b, c, d), (a, a, a))


def determinant_sign(ends: tuple[Floats, ...], begins: tuple[Floats | None, ...]) -> NDArray[np.int8]:
    """Return the exact signs, int8 (n,), of determinants with the rows end − begin.

    Parameters
    ----------
    ends, begins : three of float64 (n, 3) each, finite; a begin that is None is zero
    """
    found = np.empty(len(ends[0]), np.int8)
    for start in range(0, len(found), CHUNK):
        part = slice(start, start + CHUNK)
        found[part] = _signs([end[part] for end in ends], [None if each is None else each[part] for each in begins])
    return found


def _signs(ends: list[Floats], begins: list[Floats | None]) -> NDArray[np.int8]:
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        rows = [(end if begin is None else end - begin).T for end, begin in zip(ends, begins, strict=True)]
        found, size = _determinant(*rows), _permanent(*(np.abs(row) for row in rows))
        decided = np.abs(found) > ERROR * size + SMALLEST  # false where either overflows
    signs = np.sign(np.where(decided, found, 0)).astype(np.int8)
    left = np.flatnonzero(~decided)
    if len(left):
        whole = _as_integers([end[left] for end in ends], [None if b is None else b[left] for b in begins])
        signs[left] = np.sign(_determinant(*whole).astype(object)).astype(np.int8)
    return signs


def _determinant(a: Any, b: Any, c: Any) -> Any:
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def _permanent(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return the sums of the absolute products of absolute rows (3, n)."""
    found: Floats = (
        a[0] * (b[1] * c[2] + b[2] * c[1]) + a[1] * (b[2] * c[0] + b[0] * c[2]) + a[2] * (b[0] * c[1] + b[1] * c[0])
    )
    return found


def _as_integers(ends: list[Floats], begins: list[Floats | None]) -> list[NDArray[np.object_]]:
    """Return the rows end − begin as Python's integers, object (3, n), all multiplied by one power of two for a row."""
    rows = []
    for end, begin in zip(ends, begins, strict=True):
        mantissas, exponents = np.frexp(np.stack([end.T, np.zeros(end.shape).T if begin is None else begin.T]))
        exponents = np.where(mantissas == 0, exponents.max(initial=0), exponents)
        shifts = exponents - exponents.min(initial=0)
        whole = (mantissas * 2.0**53).astype(np.int64).astype(object) << shifts.astype(object)
        rows.append(whole[0] - whole[1])
    return rows
