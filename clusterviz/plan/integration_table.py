"""Table of a transfer function's integrals over segments, by the scalars at both ends and the length.

It is the plain variant of `preintegration.py`, whose error does not depend on the resolution of a table.

References
----------
S. P. Callahan, M. Ikits, J. L. D. Comba, C. T. Silva: Hardware-assisted visibility sorting for unstructured volume
rendering, IEEE TVCG 11(3), 2005, section 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.scene.transfer import TransferFunction

SCALARS, LENGTHS = 64, 32
"""As in integration_table.glsl: 2 MiB."""
STEPS = 48
"""Parts of a segment, each with the scalar in its middle."""


def make_integration_table(transfer: TransferFunction, longest: float) -> NDArray[np.float32]:
    """Return the head and the table, float32 (1 + LENGTHS · SCALARS², 4): premultiplied colour and opacity.

    Scalars cover clim and all control points, and lengths the range up to the longest. Interpolated linearly over the
    length, the opacity of a segment is off by (κ · longest / 31)² / 8 at most, with κ over the opacity unit distance;
    over scalars, peaks that are narrower than 1/63 of their range may be lost.

    `longest`: opacity unit distances, more than 0.
    """
    low, high = transfer.domain
    values = np.concatenate([transfer.domain, transfer.colour_values, transfer.opacity_values])
    ends = np.linspace(values.min(), values.max(), SCALARS)
    found = np.empty((LENGTHS, SCALARS, SCALARS, 4))
    at = (np.arange(STEPS) + 0.5) / STEPS
    lengths = np.linspace(0, longest, LENGTHS)[:, None, None]
    for row, back in enumerate(ends):
        scalars = ends[:, None] + (back - ends[:, None]) * at
        depth = transfer.extinction(scalars) * transfer.unit_distance / STEPS * lengths
        before = np.exp(depth - np.cumsum(depth, axis=2))
        alpha = before * -np.expm1(-depth)
        found[:, row, :, 3] = alpha.sum(axis=2)
        found[:, row, :, :3] = np.einsum("lfm,fmc->lfc", alpha, transfer.colour(scalars))
    least, most = ((value - low) / (high - low) for value in (ends[0], ends[-1]))
    head = least, (SCALARS - 1) / (most - least), (LENGTHS - 1) / longest, 0.0
    return np.concatenate([[head], found.reshape(-1, 4)]).astype(np.float32)
