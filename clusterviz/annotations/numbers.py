"""Ticks of a range, and numbers as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

EXPONENTS = (-3, 5)
"""Powers of ten from which, and up to which, numbers are written as they are."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def ticks(low: float, high: float, most: int) -> NDArray[np.float64]:
    """Return at most `most` round numbers in [low, high], float64 (n,), ascending.

    Steps are 1, 2, 2.5 or 5 times a power of ten, as chosen by matplotlib's MaxNLocator.
    """
    from matplotlib.ticker import MaxNLocator

    if not low < high or not math.isfinite(high - low):
        return np.array([low] if low == high else [])
    slack, found = 1e-9 * (high - low), np.empty(0)
    for intervals in range(most + 1, 0, -1):  # they cover the range, so that the outer two may be cut
        every = np.asarray(MaxNLocator(intervals, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high), np.float64)
        found = every[(every >= low - slack) & (every <= high + slack)]
        if len(found) <= most:
            break
    return found


def tick_labels(values: Sequence[float] | NDArray[np.float64]) -> tuple[list[str], str]:
    """Return ticks as text with equal numbers of decimals, and a common factor such as "×10⁻⁹", or ""."""
    numbers = np.asarray(values, np.float64)
    largest = float(np.abs(numbers).max(initial=0.0))
    step = float(np.diff(numbers).min()) if len(numbers) > 1 else largest
    exponent = math.floor(math.log10(largest) + 1e-9) if largest > 0 else 0
    factor = "" if EXPONENTS[0] <= exponent < EXPONENTS[1] else "×10" + str(exponent).translate(SUPERSCRIPTS)
    power = exponent if factor else 0
    scaled, step = numbers / 10.0**power, step / 10.0**power
    decimals = next((d for d in range(12) if np.all(np.abs(np.round(scaled, d) - scaled) <= 1e-3 * abs(step))), 12)
    texts = (f"{number:.{decimals}f}" for number in scaled + 0.0)
    return [text.replace("-", "−") for text in texts], factor


def number_text(value: float) -> str:
    """Return one number as text."""
    (text,), factor = tick_labels([value])
    return text + factor


def round_number(most: float) -> float:
    """Return the largest of 1, 2 and 5 times powers of ten up to a positive number."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(power * digit for digit in (1, 2, 5) if digit * power <= most * (1 + 1e-9))
