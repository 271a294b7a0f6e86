"""How a bare data file is shown: by what its values look like, in the way that its field expects.

A mask is a surface; a label map has a colour for each label; computed tomography in Hounsfield units has translucent
skin and ivory bone; values around zero diverge from it; everything else is opaque above the level that best parts
background and foreground. All are lit, on a dark background, at half the step. Keys that a user has set are kept.

References
----------
Otsu, A threshold selection method from gray-level histograms, IEEE Transactions on Systems, Man, and Cybernetics, 1979.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np

from clusterviz.scene.facts import VolumeFacts
from clusterviz.scene.values import Scene, Volume

BACKGROUND = (0.09, 0.1, 0.12)
STEP = 0.5
GIVEN = ("opacity", "opacity_unit_distance", "blending", "isosurfaces", "transfer_2d", "gradient_opacity")
"""Keys of a volume of which one is enough: whoever sets it knows the look, and gets the defaults of scene files."""
MASK = ((0.0, 0.93, 0.84, 0.70), (1.0, 0.93, 0.84, 0.70))
MOST_LABELS = 512
HOUNSFIELD_COLOURS = (
    (-400.0, 0.72, 0.45, 0.36),
    (0.0, 0.86, 0.60, 0.47),
    (80.0, 0.80, 0.38, 0.30),
    (180.0, 0.88, 0.62, 0.45),
    (300.0, 0.96, 0.90, 0.78),
    (1500.0, 1.0, 0.99, 0.95),
)
HOUNSFIELD_OPACITY = ((-400.0, 0.0), (-150.0, 0.03), (60.0, 0.03), (160.0, 0.06), (280.0, 0.5), (900.0, 0.95))


def automatic_scene(scene: Scene, facts: Sequence[VolumeFacts]) -> Scene:
    """The scene of bare data with what is left open chosen by the kinds of its volumes.

    Parameters
    ----------
    scene : its `automatic` is true
    facts : of each volume
    """
    if any(key in volume.model_fields_set for volume in scene.volumes for key in GIVEN):
        return scene.model_copy(update={"automatic": False})
    volumes = tuple(automatic_volume(*each) for each in zip(scene.volumes, facts, strict=True))
    image = _kept(scene.image, {"background": BACKGROUND})
    quality = _kept(scene.quality, {"step": STEP})
    return scene.model_copy(update={"automatic": False, "volumes": volumes, "image": image, "quality": quality})


def automatic_volume(volume: Volume, facts: VolumeFacts) -> Volume:
    """The volume as its kind is shown."""
    light = {"shade": True, "ambient": 0.35, "diffuse": 0.8}
    kept: Volume = _kept(volume, light | LOOKS[kind_of(facts)](volume, facts))
    return kept


def kind_of(facts: VolumeFacts) -> str:
    """What the values look like: mask, labels, hounsfield, signed, or scalar."""
    values = facts.values
    low, high = facts.percentile_1, facts.percentile_99
    if values is not None and len(values) == 2 and tuple(values) == (facts.minimum, facts.maximum):
        return "mask"
    is_even = facts.equal_share > 0.6 and (facts.jump_share > 0.2 or (values is not None and len(values) <= 8))
    if values is not None and 2 < len(values) <= MOST_LABELS and facts.minimum >= 0 and is_even:
        return "labels"
    if (
        -4096 <= facts.minimum <= -500
        and facts.maximum > 300
        and _share(facts, -1100, -850) > 0.02 < _share(facts, -200, 200)
    ):
        return "hounsfield"
    if low < 0 < high and 0.4 < -low / high < 2.5:
        return "signed"
    return "scalar"


def _kept(section: Any, found: dict[str, Any]) -> Any:
    """A section with what was found, but for keys that a user has set."""
    return section.model_copy(update={key: v for key, v in found.items() if key not in section.model_fields_set})


def _mask(volume: Volume, facts: VolumeFacts) -> dict[str, Any]:
    low, high = facts.minimum, facts.maximum
    cmap = tuple((low + share * (high - low), *colour) for share, *colour in MASK)
    surface = {
        "blending": "isosurface",
        "isosurfaces": ((low / 2 + high / 2, 1.0),),
        "interpolation": "cubic",
        "specular": 0.0,
    }
    return {**surface, "clim": (low, high), "cmap": cmap}


def _labels(volume: Volume, facts: VolumeFacts) -> dict[str, Any]:
    """A colour for each; the larger a label is, the paler it is, and the more it lets others shine through."""
    assert facts.values is not None
    assert facts.counts is not None
    nothing = 0.0 if facts.values[0] == 0 else facts.values[facts.counts.argmax()]
    shown = facts.values != nothing
    largest = max(1, int(facts.counts[shown].max(initial=0)))
    cmap, opacity = [], []
    for number, (value, count) in enumerate(zip(facts.values.tolist(), facts.counts.tolist(), strict=True)):
        part = 0.0 if value == nothing else 1 - count / largest
        colour = colorsys.hsv_to_rgb(
            0.08 + 0.618034 * number, (0.7, 0.85, 0.5)[number % 3] * part, (1, 0.9)[number % 2]
        )
        alpha = 0.0 if value == nothing else 0.05 + 0.95 * part**4
        for end in (value - 0.5, value + 0.5):
            cmap.append((end, *colour))
            opacity.append((end, alpha))
    clim = (facts.minimum, facts.maximum)
    return {
        "interpolation": "nearest",
        "ambient": 0.6,
        "diffuse": 0.5,
        "specular": 0.0,
        "clim": clim,
        "cmap": tuple(cmap),
        "opacity": tuple(opacity),
    }


def _hounsfield(volume: Volume, facts: VolumeFacts) -> dict[str, Any]:
    return {"clim": (-400.0, 1500.0), "cmap": HOUNSFIELD_COLOURS, "opacity": HOUNSFIELD_OPACITY}


def _signed(volume: Volume, facts: VolumeFacts) -> dict[str, Any]:
    """As much opacity on both sides of zero, which has none."""
    end = max(-facts.percentile_1, facts.percentile_99)
    points = ((-end, 0.8), (-0.4 * end, 0.0), (0.4 * end, 0.0), (end, 0.8))
    return {"clim": (-end, end), "cmap": "coolwarm", "opacity": points}


def _scalar(volume: Volume, facts: VolumeFacts) -> dict[str, Any]:
    found: dict[str, Any] = {"cmap": _cmap(facts)}
    if volume.clim is None and facts.histogram is not None and facts.histogram.any():
        low, high = _foreground(facts)
        if low < high:
            # Colours begin below what is seen: the darkest of a map hardly differ from the background.
            found["clim"] = (low - 0.5 * (high - low), high)
            found["opacity"] = ((low, 0.0), (low + 0.15 * (high - low), 0.15), (high, 0.8))
    return found


LOOKS = {"mask": _mask, "labels": _labels, "hounsfield": _hounsfield, "signed": _signed, "scalar": _scalar}


def _cmap(facts: VolumeFacts) -> str:
    """Grey levels with a tint for what scanners and microscopes give, colours for what is computed."""
    return "bone" if facts.is_integer or facts.orientation else "viridis"


def _share(facts: VolumeFacts, low: float, high: float) -> float:
    """Of the samples, those between two values, as far as a histogram tells."""
    if facts.histogram is None or not facts.histogram.any():
        return 0.0
    centres = facts.minimum + (np.arange(len(facts.histogram)) + 0.5) * (facts.maximum - facts.minimum) / len(
        facts.histogram
    )
    return float(facts.histogram[(centres >= low) & (centres <= high)].sum() / facts.histogram.sum())


def _foreground(facts: VolumeFacts) -> tuple[float, float]:
    """Otsu's threshold, and the value below which 98 % of what is above it lies.

    The brightest 1 % count as no brighter than the rest: few of them would lift the threshold far.
    """
    assert facts.histogram is not None
    bins, size = facts.histogram.astype(np.float64), facts.maximum - facts.minimum
    share = bins / bins.sum()
    top = int(np.searchsorted(np.cumsum(share), 0.99))
    clipped = share[: top + 1].copy()
    clipped[top] += share[top + 1 :].sum()
    cut = _otsu(clipped if top > 8 else share)
    above = np.cumsum(bins[cut + 1 :])
    last = cut + 1 + int(np.searchsorted(above, 0.98 * above[-1])) if len(above) else cut
    return facts.minimum + (cut + 1) / len(bins) * size, facts.minimum + (last + 1) / len(bins) * size


def _otsu(share: np.ndarray) -> int:
    """The last bin of the background."""
    below, means = np.cumsum(share), np.cumsum(share * np.arange(len(share)))
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (means[-1] * below - means) ** 2 / (below * (1 - below))
    return int(np.nan_to_num(between[:-1]).argmax())
