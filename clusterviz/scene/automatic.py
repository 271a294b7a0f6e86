"""Automatic rendering settings for data without a scene, chosen by the class of its values.

- mask: an isosurface
- labels: one colour a label
- hounsfield (computed tomography): translucent skin, ivory bone
- signed: a diverging colour map around zero
- scalar: opaque above Otsu's threshold

All are shaded, on a dark background, at half the default step. Keys that a user has set are kept.

References
----------
Otsu, A threshold selection method from gray-level histograms, IEEE Transactions on Systems, Man, and Cybernetics, 1979.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.scene.geometry import GeometryInfo, GeometrySection, LinesSection, as_sections
from clusterviz.scene.grids import GridInfo
from clusterviz.scene.values import Scene, Volume


@dataclass(frozen=True, eq=False)
class VolumeInfo:
    """Grid and value statistics of a volume.

    Attributes
    ----------
    shape_zyx : samples along z, y, x
    spacing : distance of samples along x, y, z, world units
    corners : float64 (8, 3), corners of the volume's box, world
    minimum, maximum, percentile_1, percentile_99 : data values; undefined if the volume has no finite sample
    finite : number of samples that are neither NaN nor infinite
    orientation : see `Grid.orientation`
    is_integer : whether the samples have an integer type
    histogram : int64 (bins,), equal bins from minimum to maximum
    blocks : float64 (2, z, y, x), minimum and maximum of each block; the last along an axis may be smaller
    block_sides : sides of a block along z, y and x, cells
    values, counts : float64 (n,), int64 (n,), distinct values and their numbers of samples; None if the samples are not
        whole numbers, or have too many distinct values
    equal_share : share of equal pairs among neighbouring samples that do not both have the most frequent value
    jump_share : share of pairs that differ by more than 1 among unequal neighbouring samples
    """

    shape_zyx: tuple[int, int, int]
    spacing: tuple[float, float, float]
    corners: NDArray[np.float64]
    minimum: float
    maximum: float
    percentile_1: float
    percentile_99: float
    finite: int = 1
    orientation: str = ""
    is_integer: bool = False
    histogram: NDArray[np.int64] | None = None
    blocks: NDArray[np.float64] | None = None
    block_sides: tuple[int, int, int] = (1, 1, 1)
    values: NDArray[np.float64] | None = None
    counts: NDArray[np.int64] | None = None
    equal_share: float = 0.0
    jump_share: float = 0.0


BACKGROUND = (0.09, 0.1, 0.12)
STEP = 0.5
OPT_OUT_KEYS = (
    "opacity",
    "opacity_unit_distance",
    "blending",
    "isosurfaces",
    "transfer_2d",
    "gradient_opacity",
    "shader",
)
"""Keys of a volume that turn automatic settings off: a scene that sets one gets the defaults of scene files."""
MASK = ((0.0, 0.93, 0.84, 0.70), (1.0, 0.93, 0.84, 0.70))
MAX_LABELS = 512
HOUNSFIELD_COLOURS = (
    (-400.0, 0.72, 0.45, 0.36),
    (0.0, 0.86, 0.60, 0.47),
    (80.0, 0.80, 0.38, 0.30),
    (180.0, 0.88, 0.62, 0.45),
    (300.0, 0.96, 0.90, 0.78),
    (1500.0, 1.0, 0.99, 0.95),
)
HOUNSFIELD_OPACITY = ((-400.0, 0.0), (-150.0, 0.03), (60.0, 0.03), (160.0, 0.06), (280.0, 0.5), (900.0, 0.95))


Info = VolumeInfo | GeometryInfo | GridInfo
GEOMETRY_KEYS = {"color": (0.93, 0.9, 0.84), "ambient": 0.12, "diffuse": 0.85, "specular": 0.15, "specular_power": 20.0}


def automatic_scene(scene: Scene, infos: Sequence[VolumeInfo], geometry: Sequence[GeometryInfo] = ()) -> Scene:
    """Return a scene whose unset keys are chosen by the classes of its volumes, and the arrays of its geometry.

    Parameters
    ----------
    scene : a scene with `automatic: true`
    infos, geometry : information on each volume, and on each of `scene.geometry`
    """
    if any(key in volume.model_fields_set for volume in scene.volumes for key in OPT_OUT_KEYS):
        return scene.model_copy(update={"automatic": False})
    volumes = tuple(automatic_volume(*each) for each in zip(scene.volumes, infos, strict=True))
    image = _with_defaults(scene.image, {"background": BACKGROUND})
    quality = _with_defaults(scene.quality, {"step": STEP})
    coloured = as_sections(automatic_geometry(*each) for each in zip(scene.geometry, geometry, strict=True))
    found = {"automatic": False, "volumes": volumes, "image": image, "quality": quality}
    return scene.model_copy(update=found | coloured)


def automatic_geometry(section: GeometrySection, info: GeometryInfo) -> GeometrySection:
    """Return meshes, lines or points in light, and lines without colours by their direction."""
    found: dict[str, Any] = dict(GEOMETRY_KEYS)
    if colours := own_colours(section, info):
        found["scalars"] = colours
    elif isinstance(section, LinesSection) and not {"color", "scalars"} & section.model_fields_set:
        found["color_by"] = "direction"
    chosen: GeometrySection = _with_defaults(section, found)
    return chosen


def own_colours(section: GeometrySection, info: GeometryInfo) -> str | None:
    """Return the file's array of colours by its name, if there is one and the scene has no colour."""
    if {"color", "scalars"} & section.model_fields_set:
        return None
    return next((name for name in ("RGB", "RGBA") if info.arrays.get(name, ("", 0))[1] in (3, 4)), None)


def automatic_volume(volume: Volume, info: VolumeInfo) -> Volume:
    """Return a volume whose unset keys are chosen by the class of its values."""
    light = {"shade": True, "ambient": 0.35, "diffuse": 0.8}
    kept: Volume = _with_defaults(volume, light | SETTINGS_OF_CLASS[classify_values(info)](volume, info))
    return kept


def classify_values(info: VolumeInfo) -> str:
    """Return the class of a volume's values: mask, labels, hounsfield, signed or scalar."""
    values = info.values
    low, high = info.percentile_1, info.percentile_99
    if values is not None and len(values) == 2 and tuple(values) == (info.minimum, info.maximum):
        return "mask"
    is_even = info.equal_share > 0.6 and (info.jump_share > 0.2 or (values is not None and len(values) <= 8))
    if values is not None and 2 < len(values) <= MAX_LABELS and info.minimum >= 0 and is_even:
        return "labels"
    if (
        -4096 <= info.minimum <= -500
        and info.maximum > 300
        and _histogram_share(info, -1100, -850) > 0.02 < _histogram_share(info, -200, 200)
    ):
        return "hounsfield"
    if low < 0 < high and 0.4 < -low / high < 2.5:
        return "signed"
    return "scalar"


def _with_defaults(section: Any, found: dict[str, Any]) -> Any:
    """Return a section with other defaults; keys that a user has set are kept."""
    return section.model_copy(update={key: v for key, v in found.items() if key not in section.model_fields_set})


def _mask(volume: Volume, info: VolumeInfo) -> dict[str, Any]:
    low, high = info.minimum, info.maximum
    cmap = tuple((low + share * (high - low), *colour) for share, *colour in MASK)
    surface = {
        "blending": "isosurface",
        "isosurfaces": ((low / 2 + high / 2, 1.0),),
        "interpolation": "cubic",
        "specular": 0.0,
    }
    return {**surface, "clim": (low, high), "cmap": cmap}


def _labels(volume: Volume, info: VolumeInfo) -> dict[str, Any]:
    """Settings for label maps: one colour a label; larger labels are paler and more transparent."""
    assert info.values is not None
    assert info.counts is not None
    nothing = 0.0 if info.values[0] == 0 else info.values[info.counts.argmax()]
    shown = info.values != nothing
    largest = max(1, int(info.counts[shown].max(initial=0)))
    cmap, opacity = [], []
    for number, (value, count) in enumerate(zip(info.values.tolist(), info.counts.tolist(), strict=True)):
        part = 0.0 if value == nothing else 1 - count / largest
        colour = colorsys.hsv_to_rgb(
            0.08 + 0.618034 * number, (0.7, 0.85, 0.5)[number % 3] * part, (1, 0.9)[number % 2]
        )
        alpha = 0.0 if value == nothing else 0.05 + 0.95 * part**4
        for end in (value - 0.5, value + 0.5):
            cmap.append((end, *colour))
            opacity.append((end, alpha))
    clim = (info.minimum, info.maximum)
    return {
        "interpolation": "nearest",
        "ambient": 0.6,
        "diffuse": 0.5,
        "specular": 0.0,
        "clim": clim,
        "cmap": tuple(cmap),
        "opacity": tuple(opacity),
    }


def _hounsfield(volume: Volume, info: VolumeInfo) -> dict[str, Any]:
    return {"clim": (-400.0, 1500.0), "cmap": HOUNSFIELD_COLOURS, "opacity": HOUNSFIELD_OPACITY}


def _signed(volume: Volume, info: VolumeInfo) -> dict[str, Any]:
    """Settings for signed fields: equal opacity on both sides of zero, none at zero."""
    end = max(-info.percentile_1, info.percentile_99)
    points = ((-end, 0.8), (-0.4 * end, 0.0), (0.4 * end, 0.0), (end, 0.8))
    return {"clim": (-end, end), "cmap": "coolwarm", "opacity": points}


def _scalar(volume: Volume, info: VolumeInfo) -> dict[str, Any]:
    found: dict[str, Any] = {"cmap": _cmap(info)}
    if volume.clim is None and info.histogram is not None and info.histogram.any():
        low, high = _foreground(info)
        if low < high:
            # clim begins below the visible range: the darkest colours hardly differ from the background.
            found["clim"] = (low - 0.5 * (high - low), high)
            found["opacity"] = ((low, 0.0), (low + 0.15 * (high - low), 0.15), (high, 0.8))
    return found


SETTINGS_OF_CLASS = {"mask": _mask, "labels": _labels, "hounsfield": _hounsfield, "signed": _signed, "scalar": _scalar}


def _cmap(info: VolumeInfo) -> str:
    """Return bone for acquired data (integers, or with an orientation), viridis for simulated data."""
    return "bone" if info.is_integer or info.orientation else "viridis"


def _histogram_share(info: VolumeInfo, low: float, high: float) -> float:
    """Return the share of samples between two values, estimated from the histogram."""
    if info.histogram is None or not info.histogram.any():
        return 0.0
    centres = info.minimum + (np.arange(len(info.histogram)) + 0.5) * (info.maximum - info.minimum) / len(
        info.histogram
    )
    return float(info.histogram[(centres >= low) & (centres <= high)].sum() / info.histogram.sum())


def _foreground(info: VolumeInfo) -> tuple[float, float]:
    """Return Otsu's threshold and the 98th percentile of the values above it.

    The brightest 1 % are clipped first, since few very bright samples raise the threshold far.
    """
    assert info.histogram is not None
    bins, size = info.histogram.astype(np.float64), info.maximum - info.minimum
    share = bins / bins.sum()
    top = int(np.searchsorted(np.cumsum(share), 0.99))
    clipped = share[: top + 1].copy()
    clipped[top] += share[top + 1 :].sum()
    cut = _otsu(clipped if top > 8 else share)
    above = np.cumsum(bins[cut + 1 :])
    last = cut + 1 + int(np.searchsorted(above, 0.98 * above[-1])) if len(above) else cut
    return info.minimum + (cut + 1) / len(bins) * size, info.minimum + (last + 1) / len(bins) * size


def _otsu(share: np.ndarray) -> int:
    """Return the last bin of the background by Otsu's method."""
    below, means = np.cumsum(share), np.cumsum(share * np.arange(len(share)))
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (means[-1] * below - means) ** 2 / (below * (1 - below))
    return int(np.nan_to_num(between[:-1]).argmax())
