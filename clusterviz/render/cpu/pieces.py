"""Transfer functions of few pieces, which fit in registers: a look-up is then a permutation, not a load.

A slab's opacity is a polynomial on each piece, so that pieces are few where chords (plan/segments.py) would be
hundreds. Pieces are cut until polynomials are as good as those chords. Where that takes too many, as it does near an
opacity of 1, pieces stay as they are and a slab's opacity is computed from that of a unit length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.segments import CHORD_ERROR, CHORD_FLOOR, FAR, halved, outline
from clusterviz.scene.transfer import OPAQUE, TransferFunction

MOST = 16  # floats in a register of AVX-512
CAPACITIES = (4, 8, MOST)  # one of few pieces is found in fewer steps
DEGREE = 5
START, PER_LENGTH, OPACITY = 0, 1, 2
COLOUR = OPACITY + DEGREE + 1
CHANGE = COLOUR + 3
ROWS = CHANGE + 3
"""Rows of the table: where pieces start, one over their lengths, coefficients, colour at the start and its change."""
_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
_COEFFICIENTS = np.linalg.inv(np.vander(_NODES, increasing=True))
_CHECKED = (np.arange(24) + 0.5) / 24
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pieces:
    """A transfer function of few pieces.

    Attributes
    ----------
    table : float32 (ROWS, MOST)
    capacity : columns of it that may hold pieces
    fitted : coefficients give the opacity of a slab; else the first two give that of a unit length
    """

    table: NDArray[np.float32]
    capacity: int
    fitted: bool


def pieces_of(transfer: TransferFunction, units: float) -> Pieces | None:
    """A transfer function for slabs of a length; None where it has more pieces than a register holds.

    It begins with the first piece that is visible at all: no sample below that is ever looked up.

    Parameters
    ----------
    units : of slabs, in opacity unit distances
    """
    uncut, _ = outline(transfer)
    uncut = uncut[np.argmax((uncut["unit_opacity"] > 0) | (uncut["unit_slope"] > 0)) :]
    if len(uncut) > MOST:
        return None
    records = uncut
    while len(records) <= MOST:
        lengths = _lengths(records)
        cut = _misses(records, lengths, units)
        if not cut.any():
            return _held(records, lengths, _COEFFICIENTS @ _slab(records, lengths, units, _NODES).T, True)
        records = halved(records, cut)
    lengths = _lengths(uncut)
    return _held(uncut, lengths, np.array([uncut["unit_opacity"], uncut["unit_slope"] * lengths]), False)


def _lengths(records: NDArray[np.void]) -> Floats:
    """Of all pieces; the outer ones are constant, and count as points."""
    lengths = np.append(np.diff(records["start"]), 0.0)
    return np.where(records["start"] > -FAR, lengths, 0.0)


def _slab(records: NDArray[np.void], lengths: Floats, units: float, share: float | Floats) -> Floats:
    """A slab's opacity at a share of each piece."""
    alpha = records["unit_opacity"][:, None] + (records["unit_slope"] * lengths)[:, None] * np.atleast_1d(share)
    found: Floats = -np.expm1(units * np.log1p(-np.clip(alpha, 0.0, OPAQUE)))
    return found


def _misses(records: NDArray[np.void], lengths: Floats, units: float) -> NDArray[np.bool_]:
    """Which pieces a polynomial does not fit."""
    fitted = _slab(records, lengths, units, _NODES) @ _COEFFICIENTS.T
    error = np.abs(
        fitted @ np.vander(_CHECKED, DEGREE + 1, increasing=True).T - _slab(records, lengths, units, _CHECKED)
    )
    ends = _slab(records, lengths, units, np.array([0.0, 1.0]))
    allowed = CHORD_ERROR * ends.min(axis=1) + CHORD_FLOOR * min(1.0, units)
    middles = records["start"] + lengths / 2
    # What float32 cannot tell apart is not cut further.
    return np.asarray((error.max(axis=1) > allowed) & (middles.astype("f4") > records["start"].astype("f4")))


def _held(records: NDArray[np.void], lengths: Floats, coefficients: Floats, fitted: bool) -> Pieces:
    count = len(records)
    table = np.zeros((ROWS, MOST))
    table[START, count:] = FAR
    table[START, :count] = np.where(records["start"] > -FAR, records["start"], 0.0)
    table[PER_LENGTH, :count] = np.where(lengths > 0, 1 / np.maximum(lengths, 1 / FAR), 0.0)
    table[OPACITY : OPACITY + len(coefficients), :count] = coefficients
    table[COLOUR:CHANGE, :count] = records["colour"].T
    table[CHANGE:, :count] = (records["colour_slope"] * lengths[:, None]).T
    capacity = next(capacity for capacity in CAPACITIES if count <= capacity)
    return Pieces(np.clip(table, -FAR, FAR).astype(np.float32), capacity, fitted)
