"""Measurements beside the truth: errors, the Pareto front, and what there is to say of them in a few sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.image import compare, finish
from clusterviz.report.pages.tradeoff.ground_truth import GroundTruth
from clusterviz.report.pages.tradeoff.knobs import Setting
from clusterviz.report.pages.tradeoff.measure import Cost, Image
from clusterviz.report.pages.tradeoff.similarity import luminance, ssim
from clusterviz.scene.background import RGB

LEVEL = 1 / 255
INVISIBLE = 2 * LEVEL
"""An error that a screen of 8 bits hardly shows."""
MAX_DRIFT = 1.15
"""Above this factor between two measurements of the same, other work is taken to be the reason."""
GREY: RGB = (0.5, 0.5, 0.5)
"""Behind a transparent picture, for its structure: neither dark nor light parts vanish into it."""


@dataclass(frozen=True)
class RatedSetting:
    """A setting, what it costs, and how far it is from the truth.

    Attributes
    ----------
    setting, cost : as measured
    max, rms : of the difference, any channel of the premultiplied picture, of full scale 1
    wrong_pixels : how many differ by more than a level of 8 bits
    ssim : structural similarity of the two over the background, as 8 bits show them
    image : float32 (h, w, 4), the picture
    front : its number on the Pareto front, from the fastest on; 0 where another setting is as fast and as exact
    """

    setting: Setting
    cost: Cost
    max: float
    rms: float
    wrong_pixels: int
    ssim: float
    image: Image
    front: int = 0


@dataclass(frozen=True)
class FailedSetting:
    """A setting that could not be drawn, and why."""

    setting: Setting
    reason: str


def rate(setting: Setting, cost: Cost, image: Image, truth: GroundTruth, background: RGB | None) -> RatedSetting:
    """Compare one picture with the truth."""
    difference = compare(image.astype(np.float64), truth.picture, LEVEL)
    alike = ssim(_grey(image, background), _grey(truth.picture.astype(np.float32), background))
    return RatedSetting(setting, cost, difference.max, difference.rms, difference.count, alike, image)


def pareto_front(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Which points no other one beats in one of two costs without losing in the other.

    Parameters
    ----------
    points : two costs each, less is better; of equal points all are kept
    """
    return [
        not any(a <= x and b <= y and (a < x or b < y) for a, b in points)
        for x, y in points
    ]  # fmt: skip


def by_rms(truth: GroundTruth) -> bool:
    """Whether settings are judged by their rms errors, because single pixels of the truth are not known well enough.

    So it is where a pixel may fall on either side of the edge of a surface, whatever the step.
    """
    return truth.max > INVISIBLE


def error_of(one: RatedSetting, truth: GroundTruth) -> float:
    """What a setting is judged by, and claimed to err by at most: its largest error, or rms, and the truth's own.

    Both are distances, so that a setting is no farther from the real picture than their sum.
    """
    return sum(_distances(one, truth))


def _distances(one: RatedSetting, truth: GroundTruth) -> tuple[float, float]:
    """Of a setting from the truth, and of the truth from the real picture, as settings are judged."""
    return (one.rms, truth.rms) if by_rms(truth) else (one.max, truth.max)


def with_front_numbers(rated: Sequence[RatedSetting], truth: GroundTruth) -> list[RatedSetting]:
    """The same, with those numbered that lie on the front of time and error.

    A third digit of an error counts not, nor one below the truth's own: to be nearer to it than it is to the real
    picture is no merit.
    """
    errors = [float(f"{max(_distances(one, truth)):.1e}") for one in rated]
    on_it = pareto_front([(one.cost.total_seconds, error) for one, error in zip(rated, errors, strict=True)])
    by_time = sorted((i for i, on in enumerate(on_it) if on), key=lambda i: rated[i].cost.total_seconds)
    numbers = {i: number for number, i in enumerate(by_time, 1)}
    return [replace(one, front=numbers.get(i, 0)) for i, one in enumerate(rated)]


def fastest_within(rated: Sequence[RatedSetting], largest: float, truth: GroundTruth) -> RatedSetting | None:
    """The fastest whose error is no more than that."""
    return _fastest([one for one in rated if error_of(one, truth) <= largest])


def fastest_as_exact(rated: Sequence[RatedSetting], scene: RatedSetting, truth: GroundTruth) -> RatedSetting | None:
    """The fastest that errs by no more than the scene as it is: rms, and in the worst pixel where that is known."""
    known = not by_rms(truth)
    return _fastest([one for one in rated if one.rms <= scene.rms and (one.max <= scene.max or not known)])


def _fastest(rated: Sequence[RatedSetting]) -> RatedSetting | None:
    return min(rated, key=lambda one: one.cost.total_seconds, default=None)


def verdict(rated: Sequence[RatedSetting], truth: GroundTruth, drift: float = 1.0) -> list[str]:
    """What the scene's trade is, in sentences.

    Parameters
    ----------
    rated : the scene as it is comes first
    truth : what they were measured against
    drift : by which factor two measurements of the same differ; gains below it are not told
    """
    scene = rated[0]
    sentences = [f"As the scene is, a frame takes {milliseconds(scene)} and errs by {levels(scene, truth)}."]
    if by_rms(truth):
        sentences.append("Single pixels of the picture without error are not known well enough to judge by.")
    same = fastest_as_exact(rated, scene, truth)
    if same and faster(same, scene, drift):
        sentences.append(f"With {same.setting} it is {ratio(scene, same)} faster at no larger error.")
    else:
        sentences.append("No setting that was tried is faster at no larger error.")
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
    """An error in levels of 8 bits, rounded up."""
    error = error_of(one, truth)
    in_levels, of_scale = _rounded_up(error / LEVEL), _rounded_up(error)
    text = f"{in_levels:g} levels of 255" if error >= LEVEL / 20 else f"{of_scale:.1e} of full scale"
    return f"up to {text}{', rms' if by_rms(truth) else ''}"


def _rounded_up(value: float) -> float:
    """The next number of two digits that is not smaller, but for rounding of the value's own last digits."""
    if value <= 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit * (1 - 1e-9)) * unit


def milliseconds(one: RatedSetting) -> str:
    """A frame's time for reading."""
    return f"{1e3 * one.cost.total_seconds:.3g} ms"


def ratio(slow: RatedSetting, fast: RatedSetting) -> str:
    """How many times as fast."""
    return f"{slow.cost.total_seconds / fast.cost.total_seconds:.2g} times"


def faster(one: RatedSetting, other: RatedSetting, drift: float) -> bool:
    """Whether the difference is more than noise: half of one's frames took less than the fastest of the other's."""
    gain = max(1.05, drift)
    return one.cost.total_seconds < min(other.cost.total_seconds_min, other.cost.total_seconds / gain)


def _grey(rgba: NDArray[np.float32], background: RGB | None) -> NDArray[np.float64]:
    return luminance(finish(rgba, background or GREY)) / 255
