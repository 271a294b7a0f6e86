"""Adversarial drivers: each freedom that GLSL leaves is taken, and none where a value is precise."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.spmd.adversary import BY_ZERO, DRIVERS
from clusterviz.spmd.machine_code import ADVERSARY_VARIABLE, addresses, function_of, object_code
from clusterviz.spmd.source import ShaderSource

PROGRAM = """
layout(std430, binding = 0) readonly buffer GivenBlock {{ float given[]; }};
layout(std430, binding = 1) buffer FoundBlock {{ float found[]; }};
{functions}
void main() {{ found[gl_LocalInvocationIndex] = f(given[gl_LocalInvocationIndex]); }}
"""
LANES = 8
NAN, INFINITE, SUBNORMAL = np.float32(np.nan), np.float32(np.inf), np.float32(1e-40)


@pytest.fixture(params=DRIVERS)
def driver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv(ADVERSARY_VARIABLE, request.param)
    return str(request.param)


def run(functions: str, *given: float) -> np.ndarray:
    """float32: f of each of `given`."""
    source = ShaderSource(PROGRAM.format(functions=functions), ("test",))
    call = function_of(object_code(source, "f", LANES), "f")
    values, found = np.resize(np.float32(given), LANES), np.zeros(LANES, np.float32)
    call(addresses({}, {0: values, 1: found}, np.zeros(7, np.uint32)).ctypes.data)
    return found[: len(given)]


def shown(condition: str) -> str:
    return f"float f(float x) {{ return {condition} ? 1.0 : 0.0; }}"


def test_comparisons_with_nan_are_what_the_driver_likes(driver: str) -> None:
    answer = float(DRIVERS[driver].nan_compares)
    for condition in ("x < 1.0", "x >= 1.0", "abs(x) <= 3e38", "x == x", "!(x >= 1.0)"):
        assert run(shown(condition), NAN) == answer, condition
    for condition in ("isnan(x)", "isinf(x)"):
        assert not run(shown(condition), NAN, INFINITE).any()
    # The bits of a number that was read are what they are.
    assert run(shown("(floatBitsToUint(x) & 0x7f800000u) == 0x7f800000u"), NAN, INFINITE, 1.0).tolist() == [1, 1, 0]


def test_sums_that_depend_on_their_order_need_precise(driver: str) -> None:
    plain = run("float f(float x) { return (1.0 - x) - (1.0 - x) + 1e-9 * x; }", 0.5)
    precise = run(
        "float f(float x) { precise float a = 1.0 - x; precise float b = a - (1.0 - x); precise float c = b + 1e-9 * x;"
        " return c; }",
        0.5,
    )
    assert precise == pytest.approx(5e-10)
    if DRIVERS[driver].backwards:
        assert plain != precise


def test_variables_that_go_into_a_precise_one_are_precise(driver: str) -> None:
    """Kahan's sum: what is lost of each addition is found again, unless the compiler knows that it is 0."""
    kahan = "float f(float x) {{ float y = 1e-8; {0} float t = x + y; {0} float lost = (t - x) - y; return lost; }}"
    assert run(kahan.format("precise"), 1.0) == np.float32(-1e-8)
    own = "float f(float x) { float y = 1e-8; float t = x + y; precise float lost = (t - x) - y; return lost; }"
    assert run(own, 1.0) == np.float32(-1e-8)


def test_what_a_variable_gets_after_it_went_into_a_precise_one_is_not_precise(driver: str) -> None:
    """A later call that needs the value for a precise one is another function."""
    late = (
        "float f(float x) {{ float lost = 0.0; {0} {{ precise float t = x + 1e-8 - lost; lost = (t - x) - 1e-8; }}"
        " return lost; }}"
    )
    assert run(late.format("if (x > 0.0)"), 1.0) == (0 if DRIVERS[driver].backwards else np.float32(-1e-8))
    assert run(late.format("for (int n = 0; n < 1; ++n)"), 1.0) == np.float32(-1e-8)


def test_subnormal_numbers_are_zero(driver: str) -> None:
    assert run(shown("x * 1e30 > 0.0"), SUBNORMAL, 1e-30).tolist() == [0, 1]
    assert np.float32(1e-30) * np.float32(1e-10) != 0, "the caller's arithmetic is as before"


def test_conversions_out_of_range_saturate_or_wrap(driver: str) -> None:
    signed, unsigned = (f"float f(float x) {{ return float({kind}(x) >> 1); }}" for kind in ("int", "uint"))
    found = run(signed, 1e30, -1e30, 3e9).tolist(), run(unsigned, -2.0, 7.9).tolist()
    if DRIVERS[driver].saturates:
        assert found == ([2.0**30, -(2.0**30), 2.0**30], [0.0, 3.0])
    else:
        assert found == ([-1.0, 0.0, float(np.float32((3 * 10**9 - 2**32) >> 1))], [2.0**31, 3.0])


def test_built_in_functions_and_quotients_err_as_far_as_they_may(driver: str) -> None:
    given = np.float32(np.linspace(1.1, 9.7, LANES))
    for name, exact, ulps in (
        ("x / 3.0", given.astype(float) / 3, 3),
        ("sqrt(x)", np.sqrt(given.astype(float)), 4),
        ("log(x)", np.log(given.astype(float)), np.where(given <= 2, 2**-21 / np.spacing(np.log(given)) + 1, 4)),
        ("exp(x)", np.exp(given.astype(float)), 4 + 2 * given),
    ):
        error = np.abs(run(f"float f(float x) {{ return {name}; }}", *given) - exact) / np.spacing(np.float32(exact))
        assert error.max() > 1, name
        assert (error <= ulps).all(), name


def test_integers_divided_by_zero_are_any_number(driver: str) -> None:
    assert run("float f(float x) { int none = int(x); return float(7 / none); }", 0.0, 7.0).tolist() == [BY_ZERO, 1]


def test_halves_are_rounded_as_the_driver_likes(driver: str) -> None:
    expected = [1, 2, 3] if DRIVERS[driver].halves_up else [0, 2, 2]
    assert run("float f(float x) { return round(x); }", 0.5, 1.5, 2.5).tolist() == expected
    assert run("float f(float x) { return float(int(round(x))); }", 0.5, 1.5, 2.5).tolist() == expected


def test_a_driver_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ADVERSARY_VARIABLE, "kind")
    with pytest.raises(
        InputError, match="CLUSTERVIZ_ADVERSARY: no such driver; found kind; allowed saturating, wrapping"
    ):
        run(shown("x < 1.0"), 1.0)
