"""A ball of flint glass before white stripes: light of each wavelength bends by its own refractive index.

python examples/refraction.py refraction.png
"""

from __future__ import annotations

import sys

import numpy as np

import clusterviz
from clusterviz.image.files import write_image

N = 96
axis = np.linspace(-1, 1, N)
z, y, x = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
# Above 0: a ball of glass, whose surface is at 0.5. Below 0: white stripes.
scalars = np.clip(0.5 + 8 * (0.55 - np.sqrt((x + 0.15) ** 2 + y**2 + z**2)), 0, 1)
scalars = np.where((x > 0.85) & (np.sin(14 * y) > 0), -1.0, scalars).astype(np.float32)

nm = np.linspace(400, 700, 12)
micrometres = (nm / 1000) ** 2
# Sellmeier's equation of Schott N-SF11.
flint = np.sqrt(
    1
    + 1.73759695 * micrometres / (micrometres - 0.013188707)
    + 0.313747346 * micrometres / (micrometres - 0.0623068142)
    + 1.89878101 * micrometres / (micrometres - 155.23629)
)


def row(scalar: float, value: float) -> list[float]:
    """A control point with one value for all wavelengths."""
    return [scalar, *[value] * len(nm)]


picture = clusterviz.render(
    scalars,
    optics={
        "wavelengths": nm.tolist(),
        "scattering": [row(-1, 200), row(0, 0)],
        "refraction": True,
        "refractive_index": [row(0.5, 1), [0.5, *flint.tolist()]],
    },
    camera={"position": (-260, 47.5, 75), "focal_point": (47.5, 47.5, 47.5), "view_up": (0, 0, 1), "view_angle": 18},
    size=(480, 360),
    background="black",
    step=0.5,
)
if picture is not None:  # on rank 0
    write_image(sys.argv[1] if len(sys.argv) > 1 else "refraction.png", picture, (0.0, 0.0, 0.0))
