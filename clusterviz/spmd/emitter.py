"""LLVM IR as text: instructions on numbers that are equal for all lanes, and on vectors of a number a lane."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Iterable, Sequence

from clusterviz.kernels.objects import cpu, has_features
from clusterviz.spmd.ir import Number
from clusterviz.spmd.types import whole

LLVM = {"f": "float", "d": "double", "i": "i32", "u": "i32", "b": "i1", "l": "i64", "p": "ptr"}
WHOLE = {"+": "add", "-": "sub", "*": "mul", "&": "and", "|": "or", "^": "xor", "<<": "shl"}
REAL = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
ORDER = {"<": "lt", "<=": "le", ">": "gt", ">=": "ge"}


class Part:
    """Scalar of a value, in generated code.

    `text`: LLVM's name of it; of a vector if it is varying. `element`: key of `LLVM`. `varying`: lanes may differ.
    `constant`: its value if that is known.
    """

    __slots__ = ("constant", "element", "text", "varying")

    def __init__(self, text: str, element: str, varying: bool, constant: Number | None = None) -> None:
        self.text, self.element, self.varying, self.constant = text, element, varying, constant


def constant(element: str, value: Number) -> Part:
    """Return a constant."""
    if element in "fd":
        rounded = ctypes.c_float(value).value if element == "f" else value
        return Part(f"0x{struct.unpack('Q', struct.pack('d', rounded))[0]:016X}", element, False, rounded)
    if element == "b":
        return Part("true" if value else "false", element, False, bool(value))
    return Part(str(int(value)), element, False, int(value))


class Emitter:
    """Function in the making.

    `lanes`: of its vectors; `caller`: function that calls it.
    """

    flags = ""  # of LLVM, of operations with floating-point numbers: what it may assume of them

    def __init__(self, name: str, lanes: int, caller: Emitter | None = None) -> None:
        self.lanes, self._name = lanes, name
        self._entry, self._lines = list[str](), list[str]()
        self._declared: dict[str, str] = caller._declared if caller else {}
        self._parameters = ["ptr noalias %blocks"]
        self._count = 0
        self.is_open = True

    def module(self, functions: Sequence[str] = ()) -> str:
        """Finish the function, and return the module's text with other functions."""
        self.line("ret void")
        text = self._text("define void", "nounwind")
        return "\n".join([*self._declared.values(), *functions, text, "!0 = !{}", ""])

    def function(self, results: Sequence[Part]) -> str:
        """Finish a function that others call, and return its text."""
        kind = self.struct([(part.element, part.varying) for part in results])
        whole = "poison"
        for number, part in enumerate(results):
            whole = self.new(f"insertvalue {kind} {whole}, {self.of(part)}, {number}")
        self.line(f"ret {kind} {whole}")
        return self._text(f"define internal fastcc {kind}", "noinline nounwind")

    def _text(self, begin: str, end: str) -> str:
        # LLVM 22 fails to compile masks of one lane for AVX-512.
        if self.lanes == 1 and has_features("avx512f"):
            end += f' "target-features"="{cpu()[1]},-avx512f"'
        body = ["entry:", *self._entry, "  br label %begin", "begin:", *self._lines]
        return "\n".join([f"{begin} @{self._name}({', '.join(self._parameters)}) {end} {{", *body, "}"])

    def struct(self, kinds: Sequence[tuple[str, bool]]) -> str:
        """Return the LLVM type of several values."""
        return "{" + ", ".join(self.kind(*kind) for kind in kinds) + "}"

    def parameter(self, element: str, varying: bool) -> Part:
        """Return a further parameter of the function."""
        part = Part(f"%p{len(self._parameters)}", element, varying)
        self._parameters.append(self.of(part))
        return part

    def kind(self, element: str, varying: bool) -> str:
        """Return an LLVM type."""
        return f"<{self.lanes} x {LLVM[element]}>" if varying else LLVM[element]

    def of(self, part: Part) -> str:
        """Return a part with its LLVM type."""
        return f"{self.kind(part.element, part.varying)} {part.text}"

    def line(self, text: str) -> None:
        """Emit an instruction without a result."""
        if self.is_open:
            self._lines.append("  " + text)

    def new(self, text: str) -> str:
        """Emit an instruction, and return the name of its result."""
        self._count += 1
        if self.is_open:
            self._lines.append(f"  %v{self._count} = {text}")
        return f"%v{self._count}"

    def part(self, text: str, element: str, varying: bool) -> Part:
        """Emit an instruction, and return its result."""
        return Part(self.new(text), element, varying)

    def room(self, kind: str) -> str:
        """Return the address of memory for a value, which becomes a register where LLVM can."""
        self._count += 1
        self._entry.append(f"  %a{self._count} = alloca {kind}, align 64")
        return f"%a{self._count}"

    def label(self) -> str:
        self._count += 1
        return f"b{self._count}"

    def begin(self, label: str) -> None:
        """Begin a block; the one before goes on with it."""
        self.jump(label)
        self._lines.append(f"{label}:")
        self.is_open = True

    def jump(self, label: str) -> None:
        """End the block."""
        self.line(f"br label %{label}")
        self.is_open = False

    def branch(self, condition: Part, then: str, otherwise: str) -> None:
        """End the block by a branch on a uniform condition."""
        self.line(f"br i1 {condition.text}, label %{then}, label %{otherwise}")
        self.is_open = False

    def spread(self, part: Part) -> Part:
        """Return a part as a vector."""
        if part.varying:
            return part
        kind = self.kind(part.element, True)
        if part.constant is not None:
            return Part(f"splat ({LLVM[part.element]} {part.text})", part.element, True, part.constant)
        one = self.new(f"insertelement {kind} poison, {self.of(part)}, i32 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.part(f"shufflevector {kind} {one}, {kind} poison, {zeros}", part.element, True)

    def spread_all(self, *parts: Part) -> list[Part]:
        """Return parts as vectors if one of them is varying."""
        return [self.spread(part) for part in parts] if any(part.varying for part in parts) else list(parts)

    def call(self, name: str, result: str, *parts: Part, suffix: str = "") -> Part:
        """Call an LLVM intrinsic with parts of one type, by its name without the type."""
        parts = tuple(self.spread_all(*parts))
        varying, element = parts[0].varying, parts[0].element
        letter = {"f": "f32", "d": "f64", "b": "i1", "l": "i64"}.get(element, "i32")
        full = f"llvm.{name}.{suffix or (f'v{self.lanes}' * varying + letter)}"
        kind = self.kind(result, varying)
        self.declare(full, kind, [self.kind(part.element, varying) for part in parts])
        flags = self.flags if result in "fd" else ""
        return self.part(f"call {flags}{kind} @{full}({', '.join(map(self.of, parts))})", result, varying)

    def declare(self, name: str, result: str, kinds: Sequence[str]) -> None:
        """Declare an intrinsic."""
        self._declared.setdefault(name, f"declare {result} @{name}({', '.join(kinds)})")

    def reduced(self, name: str, part: Part) -> Part:
        """Reduce a vector to a number."""
        kind, full = self.kind(part.element, False), f"llvm.vector.reduce.{name}.v{self.lanes}{LLVM[part.element]}"
        self.declare(full, kind, [self.kind(part.element, True)])
        return self.part(f"call {kind} @{full}({self.of(part)})", part.element, False)

    def any(self, mask: Part) -> Part:
        """Return whether any lane of a mask is set."""
        if not mask.varying:
            return mask
        bits = self.new(f"bitcast {self.of(mask)} to i{self.lanes}")
        return self.part(f"icmp ne i{self.lanes} {bits}, 0", "b", False)

    def both(self, a: Part | None, b: Part) -> Part:
        """Return where two masks are set; None is set everywhere."""
        return b if a is None else self.binary("&", a, b)

    def inverse(self, a: Part) -> Part:
        """Return where a mask is not set."""
        return self.binary("^", a, constant("b", True))

    def select(self, mask: Part, a: Part, b: Part) -> Part:
        """Return a where the mask is set, else b."""
        if mask.constant is not None:
            return a if mask.constant else b
        if mask.varying or a.varying or b.varying:
            a, b = self.spread(a), self.spread(b)
        return self.part(f"select {self.of(mask)}, {self.of(a)}, {self.of(b)}", a.element, a.varying)

    def binary(self, sign: str, a: Part, b: Part) -> Part:
        """Return an arithmetic operator's value."""
        element = a.element
        if element == "b" and sign in "&|^":
            for known, other in ((a, b), (b, a)):
                if known.constant is not None and not (sign == "^" and known.constant):
                    fixed = bool(known.constant) == (sign == "|")
                    return other if not fixed or sign == "^" else known
        a, b = self.spread_all(a, b)
        if element in "fd":
            operator = f"{REAL[sign]} {self.flags}".rstrip()
        elif sign == ">>":
            operator = "ashr" if element == "i" else "lshr"
        elif sign in "/%":
            return self._divide(sign, a, b)
        else:
            operator = WHOLE[sign]
        if sign in ("<<", ">>") and b.constant is None:
            b = Part(self.binary("&", b, constant(b.element, 31)).text, b.element, b.varying)
        return self.part(f"{operator} {self.of(a)}, {b.text}", element, a.varying)

    def _divide(self, sign: str, a: Part, b: Part) -> Part:
        """Return a quotient or remainder of integers; that of a division by 0 is some number, and no trap."""
        signed = a.element == "i"
        minus = self.compare("==", b, constant("i", -1)) if signed else constant("b", False)
        if b.constant in (None, 0, -1):
            b = self.select(
                self.binary("|", minus, self.compare("==", b, constant(a.element, 0))), constant(b.element, 1), b
            )
        operator = ("s" if signed else "u") + ("div" if sign == "/" else "rem")
        found = self.part(f"{operator} {self.of(a)}, {b.text}", a.element, a.varying)
        if signed and sign == "/" and b.constant is None:
            found = self.select(minus, self.binary("-", constant("i", 0), a), found)
        return found

    def compare(self, sign: str, a: Part, b: Part) -> Part:
        """Return a comparison's value; false for NaN but with "!="."""
        a, b = self.spread_all(a, b)
        if a.element in "fd":
            word = "fcmp " + {"==": "oeq", "!=": "une"}.get(sign, "o" + ORDER.get(sign, ""))
        else:
            signed = "s" if a.element == "i" else "u"
            word = "icmp " + {"==": "eq", "!=": "ne"}.get(sign, signed + ORDER.get(sign, ""))
        return self.part(f"{word} {self.of(a)}, {b.text}", "b", a.varying)

    def convert(self, part: Part, element: str) -> Part:
        """Return a part as another element."""
        given = part.element
        if given == element or {given, element} == {"i", "u"}:
            return Part(part.text, element, part.varying, part.constant)
        if part.constant is not None:
            value = part.constant
            found = constant(
                element, bool(value) if element == "b" else whole(element, value) if element in "iu" else float(value)
            )
            return self.spread(found) if part.varying else found
        if element == "b":
            return self.compare("!=", part, constant(given, 0))
        if given in "fd":
            word = {"d": "fpext", "f": "fptrunc", "i": "fptosi", "u": "fptoui"}[element]
        elif element in "fd":
            word = "sitofp" if given == "i" else "uitofp"
        else:
            word = "zext" if given in "bu" else "sext"
        return self.part(f"{word} {self.of(part)} to {self.kind(element, part.varying)}", element, part.varying)

    def nearest(self, part: Part) -> Part:
        """Return the nearest integer of a float, in one step where rounding and converting take two."""
        lanes = f"v{self.lanes}" * part.varying
        return self.call("lrint", "i", part, suffix=f"{lanes}i32.{lanes}f32")

    def clock(self) -> list[Part]:
        """Return the low and the high word of the CPU's cycle counter."""
        self.declare("llvm.readcyclecounter", "i64", [])
        now = self.part("call i64 @llvm.readcyclecounter()", "l", False)
        high = self.new(f"lshr i64 {now.text}, 32")
        return [self.part(f"trunc i64 {word} to i32", "u", False) for word in (now.text, high)]

    def bits(self, part: Part, element: str) -> Part:
        """Return the same bits as another element."""
        return self.part(f"bitcast {self.of(part)} to {self.kind(element, part.varying)}", element, part.varying)

    def offsets(self, part: Part, lanes: Iterable[int]) -> list[str]:
        """Return unsigned integers of lanes as 64 bits each: two are taken at once, and divided outside of vectors."""
        if not part.varying or self.lanes == 1:
            return [self.new(f"zext i32 {self.lane(part, lane).text} to i64") for lane in lanes]
        kind, found = f"<{self.lanes // 2} x i64>", []
        pairs = self.new(f"bitcast {self.of(part)} to {kind}")
        for lane in lanes:
            both = self.new(f"extractelement {kind} {pairs}, i32 {lane // 2}")
            found.append(self.new(f"lshr i64 {both}, 32" if lane % 2 else f"and i64 {both}, {(1 << 32) - 1}"))
        return found

    def lane(self, part: Part, number: int) -> Part:
        """Return the part of one lane."""
        if not part.varying:
            return part
        return self.part(f"extractelement {self.of(part)}, i32 {number}", part.element, False)
