"""The colour spaces in which ParaView interpolates its presets.

References
----------
K. Moreland, "Diverging Color Maps for Scientific Visualization", ISVC 2009: Msh space and the interpolation through
white (section 5). CIE 1976 L*a*b* with the D65 white point and the sRGB transfer curve, as in VTK's vtkMath.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SPACES = ("RGB", "HSV", "Lab", "CIELAB", "Diverging", "Step")

XYZ_FROM_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = np.array([0.9505, 1.0, 1.089])


def between(space: str, first: Floats, second: Floats, share: Floats, wrap: bool = True) -> Floats:
    """Colours on the way from one to another.

    Parameters
    ----------
    space : one of `SPACES`
    first, second : float64 (3,), straight RGB
    share : float64 (n,), 0 is the first colour and 1 the second
    wrap : HSV only: go round the circle of hues the short way

    Returns
    -------
    rgb : float64 (n, 3); outside [0, 1] where the space leaves the gamut
    """
    if space == "Step":  # as VTK: the whole piece has the colour of its right end
        return np.broadcast_to(second, (len(share), 3)).copy()
    if space == "HSV":
        return _between_hsv(first, second, share, wrap)
    if space in ("Lab", "CIELAB"):
        return rgb_from_lab(_mix(lab_from_rgb(first), lab_from_rgb(second), share))
    if space == "Diverging":
        return _between_diverging(first, second, share)
    return _mix(first, second, share)


def lab_from_rgb(rgb: Floats) -> Floats:
    """CIE L*a*b* (…, 3) of sRGB (…, 3)."""
    linear = np.where(rgb > 0.04045, ((rgb + 0.055) / 1.055) ** 2.4, rgb / 12.92)
    scaled = linear @ XYZ_FROM_RGB.T / WHITE
    f = np.where(scaled > 0.008856, np.cbrt(scaled), 7.787 * scaled + 16 / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def rgb_from_lab(lab: Floats) -> Floats:
    """SRGB (…, 3) of CIE L*a*b* (…, 3)."""
    y = (lab[..., 0] + 16) / 116
    f = np.stack([y + lab[..., 1] / 500, y, y - lab[..., 2] / 200], -1)
    scaled = np.where(f**3 > 0.008856, f**3, (f - 16 / 116) / 7.787)
    linear = (scaled * WHITE) @ np.linalg.inv(XYZ_FROM_RGB).T
    return np.asarray(np.where(linear > 0.0031308, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055, 12.92 * linear))


def msh_from_lab(lab: Floats) -> Floats:
    """Moreland's polar Lab (3,): magnitude, saturation angle, hue angle."""
    magnitude = float(np.linalg.norm(lab))
    saturation = float(np.arccos(np.clip(lab[0] / magnitude, -1, 1))) if magnitude > 0.001 else 0.0
    hue = float(np.arctan2(lab[2], lab[1])) if saturation > 0.001 else 0.0
    return np.array([magnitude, saturation, hue])


def lab_from_msh(msh: Floats) -> Floats:
    """CIE L*a*b* (…, 3) of Msh (…, 3)."""
    m, s, h = msh[..., 0], msh[..., 1], msh[..., 2]
    return np.stack([m * np.cos(s), m * np.sin(s) * np.cos(h), m * np.sin(s) * np.sin(h)], -1)


def _mix(first: Floats, second: Floats, share: Floats) -> Floats:
    return (1 - share)[:, None] * first + share[:, None] * second


def _between_hsv(first: Floats, second: Floats, share: Floats, wrap: bool) -> Floats:
    import colorsys

    a, b = np.array(colorsys.rgb_to_hsv(*first)), np.array(colorsys.rgb_to_hsv(*second))
    if wrap and abs(a[0] - b[0]) > 0.5:
        (a if a[0] > b[0] else b)[0] -= 1
    mixed = _mix(a, b, share)
    return np.array([colorsys.hsv_to_rgb(h % 1.0, s, v) for h, s, v in mixed])


def _between_diverging(first: Floats, second: Floats, share: Floats) -> Floats:
    a, b = msh_from_lab(lab_from_rgb(first)), msh_from_lab(lab_from_rgb(second))
    turn = abs(a[2] - b[2])
    if min(a[1], b[1]) > 0.05 and min(turn, 2 * np.pi - turn) > np.pi / 3:
        # two saturated colours of different hue: through a white that is at least as bright as both
        white = np.array([max(a[0], b[0], 88.0), 0.0, 0.0])
        left = _between_msh(a, white, 2 * share)
        return np.where((share < 0.5)[:, None], left, _between_msh(white, b, 2 * share - 1))
    return _between_msh(a, b, share)


def _between_msh(a: Floats, b: Floats, share: Floats) -> Floats:
    a, b = a.copy(), b.copy()
    if a[1] < 0.05 < b[1]:
        a[2] = _adjusted_hue(b, a[0])
    elif b[1] < 0.05 < a[1]:
        b[2] = _adjusted_hue(a, b[0])
    return rgb_from_lab(lab_from_msh(_mix(a, b, np.clip(share, 0, 1))))


def _adjusted_hue(saturated: Floats, magnitude: float) -> float:
    """The hue that an unsaturated end should have, so that the way to it looks straight."""
    m, s, h = saturated
    if m >= magnitude - 0.1:
        return float(h)
    spin = s * np.sqrt(magnitude**2 - m**2) / (m * np.sin(s))
    return float(h + spin if h > -np.pi / 3 else h - spin)
