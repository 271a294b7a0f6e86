from __future__ import annotations

import numpy as np
import pytest
from data.checks import DTYPES, check_source, refused, values

from clusterviz.data.grid import Grid
from clusterviz.data.memory import ArraySource


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_in_either_byte_order(dtype: str, order: str) -> None:
    check_source(ArraySource(values(order + dtype)), values(order + dtype))


def test_views_and_pictures() -> None:
    array = values("f4", (10, 12, 14))
    check_source(ArraySource(array[::2, ::-2, 3:].T), array[::2, ::-2, 3:].T)
    check_source(ArraySource(array[0]), array[:1])


def test_what_is_read_is_a_copy() -> None:
    array = values("u1")
    read = ArraySource(array).read((0, 0, 0), array.shape)
    read[:] = 0
    np.testing.assert_array_equal(array, values("u1"))


def test_the_grid_must_fit() -> None:
    grid = Grid((5, 6, 7), spacing=(2, 3, 4))
    assert ArraySource(values("u1"), grid).grid is grid
    refused(lambda: ArraySource(values("u1"), Grid((7, 6, 5))), "does not fit", "7, 6, 5", "5, 6, 7")
    refused(lambda: ArraySource(np.zeros((2, 2, 2, 3))), "4 axes", "array")
    refused(lambda: ArraySource(np.zeros((2, 2, 2), object), name="mine"), "not a scalar volume", "mine")
