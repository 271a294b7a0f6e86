"""What is said of rays that were not checked, by those that were."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.report.frame_coherence import BLOCK, BLOCKS, rays_at_most


def test_nothing_found_leaves_as_many_as_chance_may_have_hidden() -> None:
    """Of 16 times n blocks that are wrong as a whole, n are drawn in the mean, and none with a probability exp(-n)."""
    assert rays_at_most(0) == np.ceil(np.log(20) * BLOCK**2 * BLOCKS**2)
    assert rays_at_most(1) > rays_at_most(0)


@pytest.mark.parametrize("rays", [1, 5, 16], ids=lambda n: f"{n} in a block")
@pytest.mark.parametrize("blocks", [20, 48, 60, 200, 1000])
def test_the_bound_holds_in_nineteen_cases_of_twenty(blocks: int, rays: int) -> None:
    generator = np.random.default_rng([blocks, rays])
    told = [rays_at_most(rays * found) for found in generator.binomial(blocks, 1 / BLOCKS**2, 400)]
    assert np.mean(np.array(told) < blocks * rays) <= 0.05
