"""A few of the random scenes of benchmarks/max_error_scenes.py: no bound is broken without a warning."""

from __future__ import annotations

import max_error_scenes
import pytest


@pytest.mark.gl
@pytest.mark.parametrize("number", [3, 102, 160])
def test_a_bound_is_kept_or_refused(number: int) -> None:
    one = max_error_scenes.tried(number, 48)
    assert one.function in ("peaks", "jumps")
    assert one.warned or one.error <= one.expected + one.known_to <= one.bound + one.known_to
    assert one.known_to < one.bound
