"""Opacity of a slab from the opacity of a unit length, to float32's last bits: the twin of opacity.glsl."""

from __future__ import annotations

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import F32, I32, Operand, Value

OPTICAL = (0.222222222, 0.285714286, 0.4, 0.666666667, 2.0)
EXPONENTIAL = (0.000198412698, 0.00138888889, 0.00833333333, 0.0416666667, 0.166666667, 0.5, 1.0)


def optical_depth(code: Code, a: Value) -> Value:
    """−log(1 − a) for a in [0, 1 − 2⁻²⁴]: the exponent apart, and atanh's series for the mantissa."""
    exponent, mantissa = _split(1.0 - a)
    exponent = code.select(a < 0.29, 0, exponent)
    # Where the exponent is 0 the mantissa less one is -a itself, with all of its digits.
    return -_logarithm(code, exponent, code.select(exponent.equals(0), -a, mantissa))


def power(code: Code, x: Value, y: Value) -> Value:
    """x^y to 2e-7 of 1, for x in [0, 1] and y ≥ 0; 0^0 is 1."""
    depth = -_logarithm(code, *_split(code.most(x, 1e-37)))
    found = 1.0 - absorbed(code, depth * y)
    return code.select((x > 0.0) | y.equals(0.0), found, 0.0)


def _split(x: Value) -> tuple[Value, Value]:
    """The exponent of normal numbers, and their mantissa less one: x = (1 + mantissa) · 2^exponent."""
    exponent = (x.bits(I32) - 0x3F3504F3).shifted(23)
    return exponent, (x.bits(I32) - (exponent << 23)).bits(F32) - 1.0


def _logarithm(code: Code, exponent: Value, mantissa: Value) -> Value:
    f = mantissa / (mantissa + 2.0)
    return code.fma(exponent.to(F32), 0.693147181, f * polynomial(code, f * f, OPTICAL))


def absorbed(code: Code, depth: Value) -> Value:
    """1 − exp(−depth) for depth ≥ 0: exp = 2⁻ⁿ (1 + q), so that nothing cancels for small depths (n = 0)."""
    d = code.least(depth, 80.0)
    n = code.call("floor", code.fma(d, 1.44269504, 0.5))
    r = code.fma(n, -2.12194440e-4, code.fma(n, 0.693359375, -d))
    q = r * polynomial(code, r, EXPONENTIAL)
    scale = ((127 - n.to(I32)) << 23).bits(F32)
    return (1.0 - scale) - scale * q


def slab_opacity(code: Code, a: Value, units: Operand) -> Value:
    """The opacity of a slab that is so many opacity unit distances long."""
    return absorbed(code, optical_depth(code, a) * units)


def polynomial(code: Code, x: Value, coefficients: tuple[float, ...]) -> Value:
    """By Horner's rule, the highest power first."""
    found = code.same(F32, coefficients[0])
    for coefficient in coefficients[1:]:
        found = code.fma(found, x, coefficient)
    return found
