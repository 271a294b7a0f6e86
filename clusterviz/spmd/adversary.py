"""Adversarial driver: machine code that takes every freedom that GLSL leaves to a driver.

A shader that draws the same picture in such code does not depend on what llvmpipe, or our own compiler, happens to
do. CLUSTERVIZ_ADVERSARY names one of `DRIVERS`; without it shaders are compiled as ever.

- Operations that give no `precise` value may be reassociated, contracted and replaced by reciprocals, as if there were
  neither NaN, infinities nor signed zeros (LLVM's fast-math flags). What they give then is frozen before it decides
  anything, so that a wrong number is drawn, and nothing crashes.
- A comparison with NaN is false in one driver and true in the other; `!(a < b)` is `a >= b`; `isnan` and `isinf` are
  false. Only the bits of a number that was loaded can tell.
- Subnormal numbers are 0.
- Floats outside of an integer's range saturate in one driver and wrap around in the other.
- Division and built-in functions err by the units in the last place that GLSL allows, up or down by the bits of the
  result.
- Integers divided by 0 give any number; `round` rounds halves up in one driver, to even ones in the other.

Reference: The OpenGL Shading Language 4.60, sections 4.7.1 (range and precision), 4.7.2 and 4.9.1 (`precise`), 5.4.1
(conversion), 5.9 (division of integers by 0), 8.3 (`round`, `isnan`). Sine and cosine: Vulkan 1.3, appendix A,
"Precision of GLSL.std.450 instructions".
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from clusterviz.spmd.analysis import children, root, walk
from clusterviz.spmd.codegen import Generator
from clusterviz.spmd.emitter import Emitter, Part, constant
from clusterviz.spmd.ir import Assign, BuiltIn, Declare, Expression, Function, Loop, Name, Operation, Program, Variable
from clusterviz.spmd.variables import Parts


@dataclass(frozen=True)
class Driver:
    """What a driver makes of its freedom."""

    nan_compares: bool  # value of every comparison with NaN
    saturates: bool  # conversion to an integer takes the nearest one in its range, else it wraps around
    halves_up: bool  # `round` rounds halves up, else to even numbers
    backwards: bool  # sums of several terms, and products of several factors, begin with the last one


DRIVERS = {
    "saturating": Driver(nan_compares=False, saturates=True, halves_up=False, backwards=True),
    "wrapping": Driver(nan_compares=True, saturates=False, halves_up=True, backwards=False),
}
ULPS = {"sqrt": 3, "log": 3, "log2": 3, "/": 2, "pow": 16}
"""Units in the last place by which a result may be wrong; `exp` and `exp2` by 3 and twice the argument."""
ABSOLUTE = {"log": 2.0**-21, "log2": 2.0**-21, "sin": 2.0**-11, "cos": 2.0**-11}
"""Errors of logarithms of numbers from 0.5 to 2, and of sines and cosines."""
FLIPPED = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}
BY_ZERO = -1_234_567
FLUSHED = 0x9FC0  # of x86: no exceptions, subnormal arguments and results are 0


def precise_assignments(program: Program) -> frozenset[int]:
    """Return the ids of the assignments and declarations whose values go into precise ones of the same function.

    What a variable gets behind its last use for a precise value goes into none, though a later call may use it for one.
    """
    found = set[int]()
    for function in (one for named in program.functions.values() for one in named if one.body is not None):
        places = list(_assignments(function.body))
        ends = {id(loop): at for at, (*_, loop) in enumerate(places) if loop is not None}
        # Of each variable, the last place at which it goes into a precise value.
        last = {id(target): len(places) for _, target, _, _ in places if target.is_precise}
        while True:
            reached = dict(last)
            for at, (_, target, value, loop) in enumerate(places):
                if at <= last.get(id(target), -1):
                    until = ends.get(id(loop), at)
                    last |= {id(one): max(last.get(id(one), -1), until) for one in _variables(value)}
            if reached == last:
                break
        found |= {id(node) for at, (node, target, _, _) in enumerate(places) if at <= last.get(id(target), -1)}
    return frozenset(found)


def _assignments(
    node: Any, loop: Loop | None = None
) -> Iterator[tuple[Declare | Assign, Variable, Expression, Loop | None]]:
    """Yield assignments and declarations in their order: node, variable, value and the outermost loop around them."""
    loop = loop or (node if isinstance(node, Loop) else None)
    for child in children(node):
        yield from _assignments(child, loop)
    if isinstance(node, Declare) and node.value is not None:
        yield node, node.variable, node.value, loop
    if isinstance(node, Assign) and (target := root(node.target)) is not None:
        yield node, target, node.value, loop


def _variables(node: Any) -> Iterator[Variable]:
    return (one.variable for one in walk(node) if isinstance(one, Name) and one.variable.kind != "system")


class AdversarialEmitter(Emitter):
    """Emitter of an adversarial driver's code."""

    is_precise = False  # what is emitted gives a precise value

    def __init__(self, name: str, lanes: int, caller: Emitter | None, driver: Driver) -> None:
        super().__init__(name, lanes, caller)
        self.driver = driver

    @property
    def flags(self) -> str:  # type: ignore[override]
        """Flags of LLVM: none where a value is precise."""
        return "" if self.is_precise else "fast "

    def flush(self, begins: bool) -> None:
        """Make subnormal numbers 0 from here on, or have them again."""
        if platform.machine() not in ("x86_64", "AMD64"):
            return
        if begins:
            self._state = [self.room("i32") for _ in range(2)]
            self.line(f"store i32 {FLUSHED}, ptr {self._state[1]}")
            self.line(f"call void @llvm.x86.sse.stmxcsr(ptr {self._state[0]})")
        for name in ("ldmxcsr", "stmxcsr"):
            self.declare(f"llvm.x86.sse.{name}", "void", ["ptr"])
        self.line(f"call void @llvm.x86.sse.ldmxcsr(ptr {self._state[begins]})")

    def module(self, functions: Any = ()) -> str:
        self.flush(False)
        return super().module(functions)

    def frozen(self, part: Part) -> Part:
        """Return some number where a part is none, always the same one."""
        return self.part(f"freeze {self.of(part)}", part.element, part.varying)

    def compare(self, sign: str, a: Part, b: Part) -> Part:
        if a.element not in "fd":
            return super().compare(sign, a, b)
        a, b = map(self.frozen, self.spread_all(a, b))
        order = {"==": "eq", "!=": "ne", "<": "lt", "<=": "le", ">": "gt", ">=": "ge"}[sign]
        word = f"fcmp {'u' if self.driver.nan_compares else 'o'}{order}"
        return self.part(f"{word} {self.of(a)}, {b.text}", "b", a.varying)

    def bits(self, part: Part, element: str) -> Part:
        return super().bits(self.frozen(part) if part.element in "fd" else part, element)

    def convert(self, part: Part, element: str) -> Part:
        if part.element not in "fd" or element not in "iu" or part.constant is not None:
            return super().convert(part, element)
        part, letters = self.frozen(part), {"f": "f32", "d": "f64"}[part.element]
        lanes = f"v{self.lanes}" * part.varying
        if self.driver.saturates:
            name = "fptosi.sat" if element == "i" else "fptoui.sat"
            return self.call(name, element, part, suffix=f"{lanes}i32.{lanes}{letters}")
        wide = self.call("fptosi.sat", "l", part, suffix=f"{lanes}i64.{lanes}{letters}")
        return self.part(f"trunc {self.of(wide)} to {self.kind(element, part.varying)}", element, part.varying)

    def nearest(self, part: Part) -> Part:
        return self.convert(self.rounded(part), "i")

    def rounded(self, part: Part) -> Part:
        """Return what `round` gives."""
        if self.driver.halves_up:
            return super().call("floor", part.element, self.binary("+", part, constant(part.element, 0.5)))
        return super().call("rint", part.element, part)

    def binary(self, sign: str, a: Part, b: Part) -> Part:
        found = super().binary(sign, a, b)
        return self.wrong(found, ULPS["/"]) if sign == "/" and found.element == "f" else found

    def _divide(self, sign: str, a: Part, b: Part) -> Part:
        found = super()._divide(sign, a, b)
        return (
            found
            if b.constant
            else self.select(self.compare("==", b, constant(b.element, 0)), constant(b.element, BY_ZERO), found)
        )

    def call(self, name: str, result: str, *parts: Part, suffix: str = "") -> Part:
        found = super().call(name, result, *parts, suffix=suffix)
        if result != "f":
            return found
        if name in ("exp", "exp2"):
            return self.wrong(found, 3, of=parts[0])
        if name in ABSOLUTE:
            near = super().binary("+", found, self._sign_of(found, ABSOLUTE[name]))
            if name not in ULPS:
                return near
            inside = self.both(
                self.compare(">=", parts[0], constant("f", 0.5)), self.compare("<=", parts[0], constant("f", 2.0))
            )
            return self.select(inside, near, self.wrong(found, ULPS[name]))
        return self.wrong(found, ULPS[name]) if name in ULPS else found

    def _sign_of(self, part: Part, size: float) -> Part:
        """Return a number of this size, whose sign depends on the bits of a part."""
        odd = super().compare("==", super().binary("&", self._mixed(part), constant("i", 1)), constant("i", 1))
        return self.select(self.spread(odd) if part.varying else odd, constant("f", size), constant("f", -size))

    def _mixed(self, part: Part) -> Part:
        """Return a few bits that depend on all bits of a part."""
        bits = self.bits(part, "i")
        return super().binary(">>", super().binary("*", bits, constant("i", -1640531535)), constant("u", 20))

    def wrong(self, part: Part, ulps: int, of: Part | None = None) -> Part:
        """Return a float32 with an error of so many units in the last place, and twice `of` more; not 0, inf, NaN."""
        whole = super().binary
        bits = self.bits(part, "i")
        least = whole("&", self._mixed(part), constant("i", 1))
        sign = whole("-", whole("+", least, least), constant("i", 1))
        size = constant("i", ulps)
        if of is not None:
            clamped = super().call("minnum", "f", super().call("fabs", "f", of), constant("f", 128.0))
            size = whole("+", size, self.convert(whole("+", clamped, clamped), "i"))
        exponent = whole("&", bits, constant("i", 0x7F800000))
        is_normal = self.both(
            super().compare("!=", exponent, constant("i", 0)),
            super().compare("!=", exponent, constant("i", 0x7F800000)),
        )
        moved = self.bits(whole("+", bits, whole("*", sign, size)), "f")
        return self.select(is_normal, moved, part)


class AdversarialGenerator(Generator):
    """Generator of an adversarial driver's code."""

    emit: AdversarialEmitter
    separates = False

    def __init__(self, program: Program, lanes: int, intrinsics: dict[str, Callable[..., Parts]], driver: str) -> None:
        super().__init__(program, lanes, intrinsics)
        self._driver, self._precise = DRIVERS[driver], precise_assignments(program)

    def _emitter(self, name: str, caller: Emitter | None = None) -> Emitter:
        return AdversarialEmitter(name, self.lanes, caller, self._driver)

    def _begin(self, name: str) -> None:
        super()._begin(name)
        self.emit.flush(True)

    @contextmanager
    def _precisely(self, is_precise: bool) -> Iterator[None]:
        before, self.emit.is_precise = self.emit.is_precise, is_precise
        yield
        self.emit.is_precise = before

    def _declare(self, declaration: Declare) -> None:
        with self._precisely(id(declaration) in self._precise):
            super()._declare(declaration)

    def _assign(self, node: Assign) -> Parts:
        with self._precisely(id(node) in self._precise):
            return super()._assign(node)

    def _body(self, function: Function, bindings: Any, path: int) -> Parts:
        with self._precisely(False):
            return super()._body(function, bindings, path)

    def _terms(self, node: Expression, signs: str, sign: str) -> Iterator[tuple[str, Expression]]:
        """Yield the terms of a sum with their signs, or the factors of a product."""
        if not (isinstance(node, Operation) and node.operator in signs and len(node.operands) == 2):
            yield sign, node
            return
        (a, b), inner = node.operands, {"-+": "-", "--": "+"}.get(sign + node.operator, node.operator)
        yield from self._terms(a, signs, sign)
        yield from self._terms(b, signs, inner)

    def _backwards(self, node: Operation, signs: str) -> Parts | None:
        """Return a sum of several terms, or a product, from its end; None if there are only two."""
        terms = list(self._terms(node, signs, signs[0]))[::-1]
        if len(terms) < 3:
            return None
        found: Parts = []
        for sign, term in terms:
            parts = self.value(term)
            parts = [parts[n % len(parts)] for n in range(node.type.parts)]
            if sign == "-":
                parts = [self._negative(part) for part in parts]
            found = [self.emit.binary(signs[0], *pair) for pair in zip(found, parts, strict=True)] if found else parts
        return found

    def _fused(self, node: Operation, product: Operation, other: Expression) -> Parts:
        if not self.emit.is_precise:
            return super()._fused(node, product, other)
        given = [self.value(one) for one in node.operands]
        size = node.type.parts
        return [self.emit.binary(node.operator, *(one[n % len(one)] for one in given)) for n in range(size)]

    def _operation(self, node: Operation) -> Parts:
        inner = node.operands[0]
        if node.operator == "!" and isinstance(inner, Operation) and inner.operator in FLIPPED:
            return super()._operation(replace(inner, operator=FLIPPED[inner.operator]))
        if node.type.element in "fd" and self._driver.backwards and not self.emit.is_precise:
            for signs in ("+-", "*"):
                if node.operator in signs and (found := self._backwards(node, signs)) is not None:
                    return found
        return super()._operation(node)

    def _built_in(self, node: BuiltIn) -> Parts:
        if node.name in ("isnan", "isinf"):
            return [constant("b", False)] * node.type.parts
        if node.name == "round":
            return [self.emit.rounded(part) for part in self.value(node.arguments[0])]
        found = super()._built_in(node)
        return [self.emit.wrong(part, ULPS["pow"]) for part in found] if node.name == "pow" else found
