"""Built-in functions of GLSL in generated code, scalar by scalar."""

from __future__ import annotations

import math
from collections.abc import Callable

from clusterviz.kernels.objects import has_features
from clusterviz.spmd.emitter import Emitter, Part, constant

Parts = list[Part]
Function = Callable[[Emitter, list[Parts]], Parts]


def _each(function: Callable[..., Part]) -> Function:
    """Return a function of components; an argument that is a scalar counts for each of them."""

    def found(emit: Emitter, given: list[Parts]) -> Parts:
        size = max(map(len, given))
        return [function(emit, *(one[n % len(one)] for one in given)) for n in range(size)]

    return found


def least(emit: Emitter, a: Part, b: Part) -> Part:
    """Return the minimum; b where one is NaN."""
    return emit.select(emit.compare("<", a, b), a, b)


def most(emit: Emitter, a: Part, b: Part) -> Part:
    """Return the maximum; b where one is NaN."""
    return emit.select(emit.compare(">", a, b), a, b)


def _mix(emit: Emitter, a: Part, b: Part, share: Part) -> Part:
    if share.element == "b":
        return emit.select(share, b, a)
    return emit.call("fmuladd", a.element, emit.binary("-", b, a), share, a)


def _absolute(emit: Emitter, a: Part) -> Part:
    if a.element in "fd":
        return emit.call("fabs", a.element, a)
    return most(emit, a, emit.binary("-", constant(a.element, 0), a))


def dot(emit: Emitter, a: Parts, b: Parts) -> Part:
    found = emit.binary("*", a[0], b[0])
    for x, y in zip(a[1:], b[1:], strict=True):
        found = emit.call("fmuladd", x.element, x, y, found)
    return found


def _length(emit: Emitter, a: Parts) -> Part:
    return emit.call("sqrt", a[0].element, dot(emit, a, a))


def _joined(sign: str) -> Function:
    def found(emit: Emitter, given: list[Parts]) -> Parts:
        result = given[0][0]
        for part in given[0][1:]:
            result = emit.binary(sign, result, part)
        return [result]

    return found


def _normalized(emit: Emitter, given: list[Parts]) -> Parts:
    length = _length(emit, given[0])
    return [emit.binary("/", part, length) for part in given[0]]


def _halves(emit: Emitter, given: list[Parts]) -> Parts:
    (part,) = given[0]
    lanes = emit.lanes if part.varying else 1
    both = emit.new(f"bitcast {emit.of(part)} to <{2 * lanes} x i32>")
    kind = f"<{2 * lanes} x i32>"
    if not part.varying:
        return [emit.part(f"extractelement {kind} {both}, i32 {n}", "u", False) for n in range(2)]
    numbers = [", ".join(f"i32 {2 * lane + n}" for lane in range(lanes)) for n in range(2)]
    return [
        emit.part(f"shufflevector {kind} {both}, {kind} poison, <{lanes} x i32> <{one}>", "u", True) for one in numbers
    ]


LOGARITHM = (0.222222222, 0.285714286, 0.4, 0.666666667, 2.0)
EXPONENTIAL = (0.000198412698, 0.00138888889, 0.00833333333, 0.0416666667, 0.166666667, 0.5, 1.0, 1.0)


def _polynomial(emit: Emitter, x: Part, coefficients: tuple[float, ...]) -> Part:
    found = constant("f", coefficients[0])
    for coefficient in coefficients[1:]:
        found = emit.call("fmuladd", "f", emit.spread(found) if x.varying else found, x, constant("f", coefficient))
    return found


def _power(emit: Emitter, x: Part, y: Part) -> Part:
    """Return x^y for normal x > 0, and 0 for x = 0: by the logarithm of the mantissa, and an exponential series."""

    def number(value: float) -> Part:
        return constant("f", value)

    bits = emit.bits(most(emit, x, number(1.2e-38)), "i")
    exponent = emit.binary(">>", emit.binary("-", bits, constant("i", 0x3F3504F3)), constant("i", 23))
    mantissa = emit.bits(emit.binary("-", bits, emit.binary("<<", exponent, constant("i", 23))), "f")
    above = emit.binary("-", mantissa, number(1.0))
    f = emit.binary("/", above, emit.binary("+", above, number(2.0)))
    series = emit.binary("*", f, _polynomial(emit, emit.binary("*", f, f), LOGARITHM))
    logarithm = emit.call("fmuladd", "f", emit.convert(exponent, "f"), number(0.693147181), series)
    power = most(emit, least(emit, emit.binary("*", y, logarithm), number(88.0)), number(-87.0))
    n = emit.call("floor", "f", emit.call("fmuladd", "f", power, number(1.44269504), number(0.5)))
    rest = emit.call(
        "fmuladd", "f", n, number(2.12194440e-4), emit.call("fmuladd", "f", n, number(-0.693359375), power)
    )
    whole = emit.binary("<<", emit.binary("+", emit.convert(n, "i"), constant("i", 127)), constant("i", 23))
    found = emit.binary("*", emit.bits(whole, "f"), _polynomial(emit, rest, EXPONENTIAL))
    return emit.select(emit.compare(">", x, number(0.0)), found, number(0.0))


def _fraction(emit: Emitter, a: Part) -> Part:
    """Return what a number is above the whole one below: rounded down by AVX-512, in one step instead of three."""
    if not (a.varying and a.element == "f" and emit.lanes == 16 and has_features("avx512dq")):
        return emit.binary("-", a, emit.call("floor", a.element, a))
    name, kind = "llvm.x86.avx512.mask.reduce.ps.512", emit.kind("f", True)
    emit.declare(name, kind, [kind, "i32", kind, "i16", "i32"])
    return emit.part(f"call {kind} @{name}({emit.of(a)}, i32 9, {kind} zeroinitializer, i16 -1, i32 4)", "f", True)


def _call(name: str) -> Function:
    return _each(lambda emit, *parts: emit.call(name, parts[0].element, *parts))


def _compare(sign: str) -> Function:
    return _each(lambda emit, a, b: emit.compare(sign, a, b))


def _library(name: str) -> Function:
    """Return a function of the C library, lane by lane."""

    def found(emit: Emitter, *parts: Part) -> Part:
        emit.declare(name, "float", ["float"] * len(parts))
        if not any(part.varying for part in parts):
            return emit.part(f"call float @{name}({', '.join(map(emit.of, parts))})", "f", False)
        kind, whole = emit.kind("f", True), "poison"
        for lane in range(emit.lanes):
            given = ", ".join(emit.of(emit.lane(part, lane)) for part in parts)
            one = emit.new(f"call float @{name}({given})")
            whole = emit.new(f"insertelement {kind} {whole}, float {one}, i32 {lane}")
        return Part(whole, "f", True)

    return _each(found)


def _sign(emit: Emitter, a: Part) -> Part:
    zero, one, minus = (constant(a.element, number) for number in (0, 1, -1))
    below = emit.select(emit.compare("<", a, zero), minus, zero)
    return emit.select(emit.compare(">", a, zero), one, below)


def _smooth_step(emit: Emitter, low: Part, high: Part, x: Part) -> Part:
    zero, one = constant(x.element, 0.0), constant(x.element, 1.0)
    share = emit.binary("/", emit.binary("-", x, low), emit.binary("-", high, low))
    share = most(emit, least(emit, share, one), zero)
    slope = emit.binary("-", constant(x.element, 3.0), emit.binary("+", share, share))
    return emit.binary("*", emit.binary("*", share, share), slope)


def _cross(emit: Emitter, given: list[Parts]) -> Parts:
    a, b = given
    pairs = ((1, 2), (2, 0), (0, 1))
    return [emit.binary("-", emit.binary("*", a[i], b[k]), emit.binary("*", a[k], b[i])) for i, k in pairs]


def _reflect(emit: Emitter, given: list[Parts]) -> Parts:
    twice = emit.binary("*", constant(given[0][0].element, 2.0), dot(emit, given[1], given[0]))
    return [emit.binary("-", i, emit.binary("*", twice, n)) for i, n in zip(*given, strict=True)]


def _scaled(factor: float) -> Function:
    return _each(lambda emit, a: emit.binary("*", a, constant(a.element, factor)))


def _bits(element: str) -> Function:
    return _each(lambda emit, a: emit.bits(a, element))


BUILT_INS: dict[str, Function] = {
    **{name: _call(name) for name in ("floor", "ceil", "trunc", "sqrt", "exp", "exp2", "log", "log2", "sin", "cos")},
    **{name: _call("rint") for name in ("round", "roundEven")},
    **{name: _library(name + "f") for name in ("tan", "asin", "acos")},
    "atan": lambda emit, given: _library("atan2f" if len(given) == 2 else "atanf")(emit, given),
    "radians": _scaled(math.pi / 180),
    "degrees": _scaled(180 / math.pi),
    "sign": _each(_sign),
    "mod": _each(
        lambda emit, a, b: emit.binary(
            "-", a, emit.binary("*", b, emit.call("floor", a.element, emit.binary("/", a, b)))
        )
    ),
    "step": _each(
        lambda emit, edge, a: emit.select(
            emit.compare("<", a, edge), constant(a.element, 0.0), constant(a.element, 1.0)
        )
    ),
    "smoothstep": _each(_smooth_step),
    "cross": _cross,
    "distance": lambda emit, given: [_length(emit, [emit.binary("-", a, b) for a, b in zip(*given, strict=True)])],
    "reflect": _reflect,
    "isnan": _each(lambda emit, a: emit.compare("!=", a, a)),
    "isinf": _each(lambda emit, a: emit.compare("==", emit.call("fabs", a.element, a), constant(a.element, math.inf))),
    "pow": _each(_power),
    "fma": _call("fmuladd"),
    "fract": _each(_fraction),
    "inversesqrt": _each(lambda emit, a: emit.binary("/", constant(a.element, 1.0), emit.call("sqrt", a.element, a))),
    "abs": _each(_absolute),
    "min": _each(least),
    "max": _each(most),
    "clamp": _each(lambda emit, a, low, high: most(emit, least(emit, a, high), low)),
    "mix": _each(_mix),
    "dot": lambda emit, given: [dot(emit, *given)],
    "length": lambda emit, given: [_length(emit, given[0])],
    "normalize": _normalized,
    "lessThan": _compare("<"),
    "lessThanEqual": _compare("<="),
    "greaterThan": _compare(">"),
    "greaterThanEqual": _compare(">="),
    "equal": _compare("=="),
    "notEqual": _compare("!="),
    "all": _joined("&"),
    "any": _joined("|"),
    "not": _each(lambda emit, a: emit.inverse(a)),
    "floatBitsToInt": _bits("i"),
    "floatBitsToUint": _bits("u"),
    "intBitsToFloat": _bits("f"),
    "uintBitsToFloat": _bits("f"),
    "unpackDouble2x32": _halves,
}
