"""Errors of settings relative to the ground truth, their Pareto front, and conclusions in sentences.

References
----------
Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli: Image quality assessment: from error visibility to structural
similarity, IEEE Transactions on Image Processing 13(4), 2004, section III.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image import compare, finish
from clusterviz.pages.tradeoff.ground_truth import GroundTruth
from clusterviz.pages.tradeoff.knobs import Setting
from clusterviz.pages.tradeoff.measure import Cost, Image
from clusterviz.scene.background import RGB

Floats = NDArray[np.float64]

SIDE, SIGMA = 11, 1.5  # the paper's window: a circular Gaussian, 11 × 11
K1, K2, RANGE = 0.01, 0.03, 1.0


def ssim(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Return the mean SSIM of two grey pictures.

    `a`, `b`: (h, w), same shape, in [0, 1]. Returns 1 for equal pictures; the mean over all positions of the window
    inside the picture, which is mirrored at its edges if it is smaller than the window.
    """
    x, y = (_padded(np.asarray(picture, np.float64)) for picture in (a, b))
    mean_x, mean_y = _blur(x), _blur(y)
    # Rounding may give negative variances, which are 10⁻⁹ of c2.
    variance_x, variance_y = _blur(x * x) - mean_x**2, _blur(y * y) - mean_y**2
    covariance = _blur(x * y) - mean_x * mean_y
    c1, c2 = (K1 * RANGE) ** 2, (K2 * RANGE) ** 2
    above = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
    below = (mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2)
    return float(np.mean(above / below))


def luminance(rgb: NDArray[Any]) -> Floats:
    """Return luminance (h, w) of colours (h, w, 3) with the weights of ITU-R BT.601, as in the paper's program."""
    grey: Floats = np.asarray(rgb, np.float64) @ (0.299, 0.587, 0.114)
    return grey


def _blur(picture: Floats) -> Floats:
    """Return Gaussian weighted means over all windows inside the picture, by separable filters."""
    offset = np.arange(SIDE) - SIDE // 2
    weights = np.exp(-(offset**2) / (2 * SIGMA**2))
    weights /= weights.sum()
    for axis in (0, 1):
        picture = np.lib.stride_tricks.sliding_window_view(picture, SIDE, axis=axis) @ weights
    return picture


def _padded(picture: Floats) -> Floats:
    """Mirror a picture at its edges if it is smaller than the window."""
    if min(picture.shape) >= SIDE:
        return picture
    return np.pad(picture, SIDE // 2, mode="symmetric")


LEVEL = 1 / 255
INVISIBLE = 2 * LEVEL
"""Error that is hardly visible on an 8-bit screen."""
MAX_DRIFT = 1.15
"""Largest ratio of two measurements of one setting on an idle machine."""
LEAST_NOISE = 1.05
"""Least ratio of two times that counts as a difference."""
GREY: RGB = (0.5, 0.5, 0.5)
"""Background of transparent pictures for SSIM, on which dark and light parts are visible."""


@dataclass(frozen=True)
class RatedSetting:
    """Setting with its cost and error.

    `max`, `rms`: maximum and root mean square of the difference over all premultiplied channels, full scale 1.
    """

    setting: Setting
    cost: Cost
    max: float
    rms: float
    wrong_pixels: int  # number of pixels that differ by more than 1/255
    ssim: float  # structural similarity of the 8-bit pictures over the background
    image: Image  # float32 (h, w, 4), the picture
    front: int = 0  # number on the Pareto front, starting at 1 for the fastest; 0 if not on it


@dataclass(frozen=True)
class FailedSetting:
    """Setting that could not be drawn, with the reason."""

    setting: Setting
    reason: str


def rate(setting: Setting, cost: Cost, image: Image, truth: GroundTruth, background: RGB | None) -> RatedSetting:
    """Compare one picture with the ground truth."""
    difference = compare(image.astype(np.float64), truth.picture, LEVEL)
    similarity = ssim(_grey(image, background), _grey(truth.picture.astype(np.float32), background))
    return RatedSetting(setting, cost, difference.max, difference.rms, difference.count, similarity, image)


def pareto_front(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Return which points are on the Pareto front of two costs.

    `points`: pairs of costs, smaller is better; equal points are all on the front.
    """
    return [
        not any(a <= x and b <= y and (a < x or b < y) for a, b in points)
        for x, y in points
    ]  # fmt: skip


def by_rms(truth: GroundTruth) -> bool:
    """Return whether settings are rated by rms error, since the ground truth's maximum error is too large.

    This occurs if pixels at the edge of a surface do not converge with the step.
    """
    return truth.max > INVISIBLE


def error_of(one: RatedSetting, truth: GroundTruth) -> float:
    """Return the error bound by which a setting is rated: its distance from the ground truth plus that one's own error.

    By the triangle inequality the distance from the exact picture is at most this sum.
    """
    return sum(_distances(one, truth))


def _distances(one: RatedSetting, truth: GroundTruth) -> tuple[float, float]:
    """Return the distances of a setting from the ground truth, and of that from the exact picture."""
    return (one.rms, truth.rms) if by_rms(truth) else (one.max, truth.max)


def with_front_numbers(rated: Sequence[RatedSetting], truth: GroundTruth) -> list[RatedSetting]:
    """Return the settings numbered along the Pareto front of time and error.

    Errors are rounded to two digits, and errors below the ground truth's own count as equal to it.
    """
    errors = [float(f"{max(_distances(one, truth)):.1e}") for one in rated]
    on_it = pareto_front([(one.cost.total_seconds, error) for one, error in zip(rated, errors, strict=True)])
    by_time = sorted((i for i, on in enumerate(on_it) if on), key=lambda i: rated[i].cost.total_seconds)
    numbers = {i: number for number, i in enumerate(by_time, 1)}
    return [replace(one, front=numbers.get(i, 0)) for i, one in enumerate(rated)]


def fastest_within(rated: Sequence[RatedSetting], largest: float, truth: GroundTruth) -> RatedSetting | None:
    """Return the fastest setting within an error bound, or None."""
    return _fastest([one for one in rated if error_of(one, truth) <= largest])


def fastest_as_exact(rated: Sequence[RatedSetting], scene: RatedSetting, truth: GroundTruth) -> RatedSetting | None:
    """Return the fastest setting whose rms error, and maximum error if it is known, do not exceed the scene's."""
    known = not by_rms(truth)
    return _fastest([one for one in rated if one.rms <= scene.rms and (one.max <= scene.max or not known)])


def _fastest(rated: Sequence[RatedSetting]) -> RatedSetting | None:
    return min(rated, key=lambda one: one.cost.total_seconds, default=None)


def verdict(rated: Sequence[RatedSetting], truth: GroundTruth, drift: float = 1.0) -> list[str]:
    """Return the conclusions in sentences.

    `rated`: settings with cost and error; the unchanged scene comes first. `drift`: ratio of two measurements of one
    setting; smaller gains are not mentioned.
    """
    scene = rated[0]
    sentences = [f"As the scene is, a frame takes {milliseconds(scene)} and errs by {levels(scene, truth)}."]
    if by_rms(truth):
        sentences.append("Single pixels of the picture without error are not known well enough to judge by.")
    same = fastest_as_exact(rated, scene, truth)
    if same and faster(same, scene, drift):
        sentences.append(f"With {same.setting} it is {ratio(scene, same)} faster at no larger error.")
    else:
        noise = f"{100 * (noise_of(scene, drift) - 1):.0f} %"
        sentences.append(
            f"No setting that was tried is faster at no larger error by more than the noise of the times, {noise}."
        )
    hidden = fastest_within(rated, INVISIBLE, truth)
    if hidden is None:
        exact = min(rated, key=lambda one: error_of(one, truth))
        closest = f"; {exact.setting} comes closest, with {levels(exact, truth)}, and takes {milliseconds(exact)}"
        sentences.append(f"None comes within 2 levels of 8 bits{'' if exact is scene else closest}.")
    elif hidden not in (scene, same):
        sentences.append(f"The fastest within 2 levels of 8 bits is {hidden.setting}: {milliseconds(hidden)}.")
    quickest = min(rated, key=lambda one: one.cost.total_seconds)
    if quickest not in (scene, same, hidden) and faster(quickest, scene, drift):
        sentences.append(
            f"The fastest of all, {quickest.setting}, is {ratio(scene, quickest)} faster than the scene as it is "
            f"and errs by {levels(quickest, truth)}."
        )
    if drift > MAX_DRIFT:
        sentences.append(
            f"The machine was busy: the scene as it is, measured twice, took {drift:.2g} times as long once; smaller "
            "differences mean nothing, and --rounds 3 helps."
        )
    return sentences


def levels(one: RatedSetting, truth: GroundTruth) -> str:
    """Return an error in levels of 8 bits, rounded up, as text."""
    error = error_of(one, truth)
    in_levels, of_scale = _rounded_up(error / LEVEL), _rounded_up(error)
    text = f"{in_levels:g} levels of 255" if error >= LEVEL / 20 else f"{of_scale:.1e} of full scale"
    return f"up to {text}{', rms' if by_rms(truth) else ''}"


def _rounded_up(value: float) -> float:
    """Round up to two digits, with a tolerance for floating-point rounding."""
    if value <= 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit * (1 - 1e-9)) * unit


def milliseconds(one: RatedSetting) -> str:
    """Return the time of a frame as text."""
    return f"{1e3 * one.cost.total_seconds:.3g} ms"


def ratio(slow: RatedSetting, fast: RatedSetting) -> str:
    """Return the speed-up as text."""
    return f"{slow.cost.total_seconds / fast.cost.total_seconds:.2g} times"


def noise_of(one: RatedSetting, drift: float) -> float:
    """Return the noise of a time as a ratio: of two measurements, or of the median frame to the fastest."""
    return max(LEAST_NOISE, drift, one.cost.total_seconds / one.cost.total_seconds_min)


def faster(one: RatedSetting, other: RatedSetting, drift: float) -> bool:
    """Return whether one is faster than the other by more than the noise of the other's time."""
    return one.cost.total_seconds * noise_of(other, drift) < other.cost.total_seconds


def _grey(rgba: NDArray[np.float32], background: RGB | None) -> NDArray[np.float64]:
    return luminance(finish(rgba, background or GREY)) / 255
