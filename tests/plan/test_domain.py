"""The box around several volumes."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.plan.domain import Domain, domain_layout, make_domain

TURNED = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # x to y, y to -x


def test_it_is_the_box_around_all_in_cells_of_the_smallest_spacing() -> None:
    domain = make_domain([Grid((5, 5, 5), (1, 2, 3), (0, 0, 0)), Grid((3, 4, 6), (0.5, 0.5, 0.5), (10, 0, 1), TURNED)])
    assert domain == Domain((0.0, 0.0, 0.0), 0.5, (20.0, 16.0, 24.0))
    assert domain.grid.shape_zyx == (25, 17, 21)


def test_a_part_of_a_cell_is_a_cell_but_rounding_is_none() -> None:
    grid = Grid((2, 2, 2), (0.1, 0.1, 0.1), (0.3, 0.3, 0.3))  # 0.3 + 0.1 - 0.3 is not 0.1
    assert make_domain([grid, grid]).grid.shape_zyx == (2, 2, 2)
    assert Domain((0.0, 0.0, 0.0), 1.0, (2.5, 0.0, 3.0)).grid.shape_zyx == (4, 2, 4)


def test_volumes_far_apart_for_their_spacing_are_refused() -> None:
    near, far = Grid((9, 9, 9), (1e-3, 1e-3, 1e-3)), Grid((9, 9, 9), (1.0, 1.0, 1.0), (1e4, 1e4, 1e4))
    with pytest.raises(InputError, match=r"too far apart.*found 1e\+07 × .*cluster.brick"):
        domain_layout(make_domain([near, far]), 64)
    fine, wide = Grid((64, 64, 64), (0.03,) * 3), Grid((201, 201, 201))
    said = r"volumes\[0\] of 200 × 200 × 200 has 1, volumes\[1\] of 1.89 .*has 0.03; .*cluster.brick=256 instead of 64"
    with pytest.raises(InputError, match=said):
        domain_layout(make_domain([wide, fine]), 64, volumes=[wide, fine])
    assert np.prod(domain_layout(make_domain([wide, fine]), 256, volumes=[wide, fine]).counts_zyx) < 1 << 16
    assert np.prod(domain_layout(make_domain([near, near]), 64).counts_zyx) == 1
