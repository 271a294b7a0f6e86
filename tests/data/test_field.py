from __future__ import annotations

import numpy as np
import pytest
from data.checks import check_source, refused
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.data import open_source
from clusterviz.data.field import FIELDS, open_field


@pytest.mark.parametrize("name", list(FIELDS))
@pytest.mark.parametrize("size", [1, 2, 13])
def test_a_sample_does_not_depend_on_its_box(name: str, size: int) -> None:
    source = open_field(f"field:{name}:{size}")
    whole = source.read((0, 0, 0), (size,) * 3)
    assert np.isfinite(whole).all()
    check_source(source, whole, brick=5)


@given(st.data())
def test_any_box_of_marschner_lobb(data: st.DataObject) -> None:
    source = open_field("field:marschner-lobb:20")
    whole = source.read((0, 0, 0), (20, 20, 20))
    begin = [data.draw(st.integers(0, 19)) for _ in range(3)]
    end = [data.draw(st.integers(b + 1, 20)) for b in begin]
    box = tuple(slice(b, e) for b, e in zip(begin, end, strict=True))
    np.testing.assert_array_equal(source.read(tuple(begin), tuple(end)), whole[box])  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [1, 2, 64, 1001])
def test_the_world_box(size: int) -> None:
    grid = open_field(f"field:gaussian:{size}").grid
    expected = 1.0 if size > 1 else 0.0
    np.testing.assert_allclose(np.abs(grid.corners), expected, atol=1e-14)


def test_a_size_that_fits_no_memory_is_read_by_the_box() -> None:
    source = open_field("field:shells:100001")
    middle = source.read((50000, 50000, 50000), (50001, 50001, 50001))
    assert middle.item() == pytest.approx(np.exp(-36), rel=1e-6)


def value(name: str, x: float, y: float, z: float) -> float:
    return float(FIELDS[name](*np.array([[x], [y], [z]])).item())


def test_values_that_are_known() -> None:
    assert value("ramp", -1, 0, 0) == 0
    assert value("ramp", 1, 0.3, 0.2) == 1
    assert value("constant", 0.1, 0.2, 0.3) == 0.5
    assert value("gaussian", 0, 0, 0.4) == pytest.approx(np.exp(-0.5))
    # Marschner and Lobb's formula, written out at points where its cosines are simple
    assert value("marschner-lobb", 0, 0, 0) == pytest.approx((1 + 0.25 * 2) / 2.5)
    assert value("marschner-lobb", 0, 0, 1) == pytest.approx(0.25 * 2 / 2.5)
    assert value("marschner-lobb", 1, 0, -1) == pytest.approx((2 + 0.25 * 2) / 2.5)
    assert value("marschner-lobb", 0, 2 / 3, 0) == pytest.approx((1 + 0.25 * 2) / 2.5)
    # hydrogen: the largest value is 1, 6 Bohr radii up the axis; none on the cone 3 cos² = 1
    assert value("hydrogen", 0, 0, 0.25) == pytest.approx(1)
    assert value("hydrogen", 0.2, 0, 0.2 / 2**0.5) == pytest.approx(0, abs=1e-12)
    z = np.linspace(-1, 1, 2001)
    assert FIELDS["hydrogen"](0 * z, 0 * z, z).max() == pytest.approx(1)
    assert value("shells", 0, 0.6, 0) == pytest.approx(2 / 3, rel=1e-6)


def test_x_y_and_z_are_where_they_belong() -> None:
    ramp = open_field("field:ramp:3").read((0, 0, 0), (3, 3, 3))
    np.testing.assert_array_equal(ramp, np.broadcast_to(np.float32([0, 0.5, 1]), (3, 3, 3)))
    lobes = open_field("field:hydrogen:9").read((0, 0, 0), (9, 9, 9))
    assert lobes[5, 4, 4] > 3.9 * lobes[4, 4, 5] > 0


@pytest.mark.parametrize(
    ("spec", "part"),
    [
        ("field:", "no such field"),
        ("field:nothing:3", "marschner-lobb, gaussian"),
        ("field:ramp:0", "impossible size"),
        ("field:ramp:-3", "impossible size"),
        ("field:ramp:3.5", "impossible size"),
        ("field:ramp:", "impossible size"),
        ("field:ramp:3:4", "impossible size"),
    ],
)
def test_impossible_fields(spec: str, part: str) -> None:
    refused(lambda: open_source(spec), part)
