"""Presets: colours, opacity, blend mode and light of a volume by name, chosen from statistics of its values.

A preset is a function (info, clim) -> keys of a volume; `clim` is None unless a user has set it. Where the values have
no Hounsfield units, presets of computed tomography go by the histogram instead.

Automatic settings are presets too: `clusterviz.content.automatic` chooses one by the class of the values.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from clusterviz.content.volume.info import MOST_EXACT, VolumeInfo, default_clim

Keys = dict[str, Any]
Clim = tuple[float, float] | None


@dataclass(frozen=True)
class Preset:
    """Preset of a volume: a line, and a function from facts on it, and its clim if that is set, to other keys of it."""

    description: str
    keys: Callable[[VolumeInfo, Clim], Keys]


LIGHT: Keys = {"shade": True, "ambient": 0.35, "diffuse": 0.8}
SURFACE: Keys = {"blending": "isosurface", "interpolation": "cubic", "specular": 0.0}
PRESET_DEFAULTS: Keys = {
    "cmap": None,
    "clim": None,
    "opacity": None,
    "gradient_opacity": (),
    "transfer_2d": None,
    "shader": None,
    "interpolation": "linear",
    "blending": "composite",
    "isosurfaces": (),
    "threshold": None,
    "gradient": "central",
    "specular": 0.2,
    "specular_power": 10.0,
    "ambient_occlusion": None,
    **LIGHT,
}
"""Keys of a volume that presets choose, and their values where a preset has no other."""
IVORY = (0.93, 0.84, 0.70)
DENSITY_COLOUR = (0.62, 0.74, 0.88)
PARTICLE_DEVIATIONS, CRYSTAL_DEVIATIONS = 4.0, 2.0
"""Contour levels above the mean: of a particle in an empty box, and of a crystal's cell, which molecules fill."""
MAX_LABELS = 512
FARTHEST = 2.0**22
"""Distance of labels up to which float32 in units of their range tells them apart."""
TISSUE_COLOURS = (
    (-400.0, 0.72, 0.45, 0.36),
    (0.0, 0.86, 0.60, 0.47),
    (80.0, 0.80, 0.38, 0.30),
    (180.0, 0.88, 0.62, 0.45),
    (300.0, 0.96, 0.90, 0.78),
    (1500.0, 1.0, 0.99, 0.95),
)
TISSUE_OPACITY = ((-400.0, 0.0), (-150.0, 0.03), (60.0, 0.03), (160.0, 0.06), (280.0, 0.5), (900.0, 0.95))
BONE_COLOURS = ((150.0, 0.85, 0.62, 0.45), (350.0, 0.96, 0.90, 0.78), (1500.0, 1.0, 0.99, 0.95))
BONE_OPACITY = ((180.0, 0.0), (300.0, 0.5), (900.0, 0.95))
VESSEL_COLOURS = ((0.0, 0.45, 0.05, 0.05), (0.4, 0.85, 0.16, 0.10), (0.7, 0.95, 0.55, 0.40), (1.0, 1.0, 0.93, 0.85))
"""(share of a range, r, g, b)"""


def _tissue(info: VolumeInfo, clim: Clim) -> Keys:
    if not has_hounsfield_units(info):
        return _foreground(info, clim)
    return {"clim": (-400.0, 1500.0), "cmap": TISSUE_COLOURS, "opacity": TISSUE_OPACITY}


def _bone(info: VolumeInfo, clim: Clim) -> Keys:
    if has_hounsfield_units(info):
        return {"clim": (150.0, 1500.0), "cmap": BONE_COLOURS, "opacity": BONE_OPACITY}
    low, high = _foreground_range(info, clim)
    opacity = _over(low, high, (0.35, 0.0), (0.55, 0.4), (1.0, 0.95))
    return {"clim": (low, high), "cmap": "bone", "opacity": opacity}


def _vessels(info: VolumeInfo, clim: Clim) -> Keys:
    ends = (120.0, 700.0) if has_hounsfield_units(info) else (info.percentile(95.0), info.percentile(99.9))
    low, high = clim or _increasing(ends, info)
    cmap = tuple((low + share * (high - low), *colour) for share, *colour in VESSEL_COLOURS)
    return {"clim": (low, high), "cmap": cmap, "opacity": _over(low, high, (0.0, 0.0), (0.4, 0.3), (1.0, 0.8))}


def _mip(info: VolumeInfo, clim: Clim) -> Keys:
    """Keys of a maximum projection, dark values of which are transparent, so that no box stands before a background."""
    brightest = info.percentile(99.9)
    ends = (0.0, max(700.0, brightest)) if has_hounsfield_units(info) else (info.percentile(25.0), brightest)
    low, high = clim or _increasing(ends, info)
    opacity = _over(low, high, (0.0, 0.0), (0.2, 1.0), (1.0, 1.0))
    return {"blending": "maximum", "clim": (low, high), "cmap": "gray", "opacity": opacity, "shade": False}


def _xray(info: VolumeInfo, clim: Clim) -> Keys:
    ends = (-1000.0, 300.0) if has_hounsfield_units(info) else (info.percentile(1.0), info.percentile(99.0))
    clim = clim or _increasing(ends, info)
    return {"blending": "average", "clim": clim, "cmap": "gray", "opacity": 1.0, "shade": False}


def _small_labels(info: VolumeInfo) -> Keys:
    """Return the key that makes labels small numbers where they are too many or too far apart, else nothing."""
    if not info.is_integer:
        return {}
    if info.values is None or len(info.values) > MAX_LABELS:
        return {"labels": "hashed"}
    values, nothing = tuple(map(int, info.values.tolist())), int(_nothing(info))
    is_far = values[-1] - values[0] > FARTHEST or max(-values[0], values[-1]) > MOST_EXACT / 4
    return {"labels": (nothing, *(value for value in values if value != nothing))} if is_far else {}


def _nothing(info: VolumeInfo) -> Any:
    assert info.values is not None, "labels are known"
    assert info.counts is not None, "labels are known"
    return info.values[0 if info.values[0] == 0 else info.counts.argmax()]


def _labels(info: VolumeInfo, clim: Clim) -> Keys:
    labels = _small_labels(info)
    if labels or info.values is None or info.counts is None:
        low, high = clim or default_clim(info)
        opacity = _over(low, high, (0.0, 0.0), (0.02, 0.5), (1.0, 0.5))
        return {"interpolation": "nearest", "clim": (low, high), "cmap": "glasbey", "opacity": opacity, **labels}
    nothing = _nothing(info)
    shown = info.values != nothing
    largest = max(1, int(info.counts[shown].max(initial=0)))
    cmap = list[tuple[float, ...]]()
    alphas = list[tuple[float, float]]()
    for number, (value, count) in enumerate(zip(info.values.tolist(), info.counts.tolist(), strict=True)):
        part = 0.0 if value == nothing else 1.0 if info.is_flat else 1 - count / largest
        colour = colorsys.hsv_to_rgb(
            0.08 + 0.618034 * number, (0.7, 0.85, 0.5)[number % 3] * part, (1, 0.9)[number % 2]
        )
        alpha = 0.0 if value == nothing else 0.05 + 0.95 * part**4
        for end in (value - 0.5, value + 0.5):
            cmap.append((end, *colour))
            alphas.append((end, alpha))
    return {
        "interpolation": "nearest",
        "shade": not info.is_flat,
        "ambient": 0.6,
        "diffuse": 0.5,
        "specular": 0.0,
        "clim": (info.minimum, info.maximum),
        "cmap": tuple(cmap),
        "opacity": tuple(alphas),
    }


def _mask(info: VolumeInfo, clim: Clim) -> Keys:
    low, high = _increasing((info.minimum, info.maximum), info)
    return {**SURFACE, "isosurfaces": ((low / 2 + high / 2, 1.0),), "clim": (low, high), "cmap": _one_colour(low, high)}


def _density(info: VolumeInfo, clim: Clim) -> Keys:
    """Keys of a surface at a contour level in standard deviations, as maps of molecules are shown."""
    low, high = clim or default_clim(info)
    level = low / 2 + high / 2
    if info.has_histogram:
        mean, deviation = info.mean_and_deviation
        is_mostly_solvent = info.percentile(75.0) - info.percentile(25.0) < 0.5 * deviation
        level = mean + (PARTICLE_DEVIATIONS if is_mostly_solvent else CRYSTAL_DEVIATIONS) * deviation
        level = min(level, 0.8 * info.maximum + 0.2 * mean)
    surface = {"blending": "isosurface", "isosurfaces": ((level, 1.0),), "gradient": "smooth", "specular": 0.1}
    return {**surface, "clim": (low, high), "cmap": tuple((end, *DENSITY_COLOUR) for end in (low, high))}


def _block(info: VolumeInfo, clim: Clim) -> Keys:
    cmap = "gray" if info.is_acquired else "viridis"
    return {"clim": clim or default_clim(info), "cmap": cmap, "opacity": 1.0, "shade": False}


def _signed(info: VolumeInfo, clim: Clim) -> Keys:
    end = max(abs(info.percentile_1), abs(info.percentile_99)) or 1.0
    opacity = ((-end, 0.8), (-0.4 * end, 0.0), (0.4 * end, 0.0), (end, 0.8))
    return {"clim": (-end, end), "cmap": "coolwarm", "opacity": opacity}


def _foreground(info: VolumeInfo, clim: Clim) -> Keys:
    found: Keys = {"cmap": "bone" if info.is_acquired else "viridis"}
    if clim is None and info.has_histogram:
        low, high = info.foreground
        if low < high:
            # clim begins below the visible range: the darkest colours hardly differ from the background.
            found["clim"] = (max(info.minimum, low - 0.5 * (high - low)), high)
            found["opacity"] = _over(low, high, (0.0, 0.0), (0.15, 0.15), (1.0, 0.8))
    return found


def _percentiles(info: VolumeInfo, clim: Clim) -> Keys:
    low, high = clim or default_clim(info)
    places = [(info.percentile(q), alpha) for q, alpha in ((50.0, 0.0), (75.0, 0.03), (95.0, 0.15), (99.0, 0.6))]
    opacity = tuple((value, alpha) for value, alpha in places if low <= value <= high)
    return {"clim": (low, high), "cmap": "viridis", "opacity": opacity or _over(low, high, (0.0, 0.0), (1.0, 0.6))}


PresetName = Literal[
    "tissue",
    "bone",
    "vessels",
    "mip",
    "xray",
    "labels",
    "mask",
    "density",
    "block",
    "signed",
    "foreground",
    "percentiles",
]
"""Names of the table, for type checkers."""
PRESETS: dict[PresetName, Preset] = {
    "tissue": Preset("computed tomography: translucent skin, ivory bone; else as foreground", _tissue),
    "bone": Preset("computed tomography: bone alone; else the brighter part of the foreground", _bone),
    "vessels": Preset("computed tomography: contrast medium and bone, red to ivory; else the brightest 5 %", _vessels),
    "mip": Preset("the largest value along each ray, in grey", _mip),
    "xray": Preset("the mean value along each ray, in grey", _xray),
    "labels": Preset("one colour a label, not interpolated; large labels are pale and translucent", _labels),
    "mask": Preset("a smooth surface half-way between the smallest and the largest value", _mask),
    "density": Preset(
        "a surface four standard deviations above the mean, two in crystals: maps of molecules", _density
    ),
    "block": Preset("an opaque block, whose faces and cuts are slices", _block),
    "signed": Preset("blue below and red above zero, transparent around it", _signed),
    "foreground": Preset("opaque above Otsu's threshold", _foreground),
    "percentiles": Preset("opacity rises from the median to the 99th percentile", _percentiles),
}


def apply_preset(name: PresetName, info: VolumeInfo) -> Keys:
    """Return all keys of a volume that presets choose; `complete_scene` chooses those that are None."""
    return PRESET_DEFAULTS | PRESETS[name].keys(info, None)


def has_hounsfield_units(info: VolumeInfo) -> bool:
    """Return whether the values are those of computed tomography: air near −1000, water and soft tissue near 0."""
    return (
        -4096 <= info.minimum <= -500
        and info.maximum > 300
        and (info.modality == "CT" or info.share(-1100, -850) > 0.02 < info.share(-200, 200))
    )


def _foreground_range(info: VolumeInfo, clim: Clim) -> tuple[float, float]:
    return clim or (_increasing(info.foreground, info) if info.has_histogram else default_clim(info))


def _increasing(ends: tuple[float, float], info: VolumeInfo) -> tuple[float, float]:
    return ends if ends[0] < ends[1] else default_clim(info)


def _over(low: float, high: float, *points: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    return tuple((low + share * (high - low), alpha) for share, alpha in points)


def _one_colour(low: float, high: float) -> tuple[tuple[float, ...], ...]:
    return ((low, *IVORY), (high, *IVORY))
