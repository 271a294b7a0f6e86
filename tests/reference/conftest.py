"""How fast an error falls: measured, not assumed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest


@pytest.fixture
def order_of() -> Callable[[Callable[[float], float], float, int], list[float]]:
    """`order_of(error, coarse, halvings)`: log₂ of how much each halving of a parameter shrinks the error."""

    def orders(error: Callable[[float], float], coarse: float, halvings: int) -> list[float]:
        errors = [error(coarse / 2**k) for k in range(halvings + 1)]
        return [math.log2(a / b) for a, b in itertools.pairwise(errors)]

    return orders
