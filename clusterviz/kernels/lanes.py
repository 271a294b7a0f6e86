"""Vector code written as expressions, from which kernels are generated with LLVM.

A `Value` is a number or a vector of numbers in generated code; operators on it generate instructions. LLVM lowers them
for each CPU: the same code serves AVX-512, AVX2 and NEON. A number in an operation with a vector is used for all lanes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

F32, F64 = ir.FloatType(), ir.DoubleType()
I1, I8, I16, I32, I64 = (ir.IntType(bits) for bits in (1, 8, 16, 32, 64))
POINTER = ir.PointerType()
BYTES = {F32: 4, F64: 8, I8: 1, I16: 2, I32: 4, I64: 8}
Number = float | int
Text = dict[str, str]

_WHOLE: Text = {"+": "add", "-": "sub", "*": "mul", "&": "and_", "|": "or_", "^": "xor", "<<": "shl", ">>": "lshr"}
_REAL: Text = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}


class Value:
    """A number or a vector in generated code.

    Attributes
    ----------
    builder : llvmlite's builder of instructions
    raw : llvmlite's value
    """

    __slots__ = ("builder", "raw")

    def __init__(self, builder: Any, raw: Any) -> None:
        self.builder, self.raw = builder, raw

    @property
    def element(self) -> Any:
        """LLVM type of a lane."""
        return self.raw.type.element if isinstance(self.raw.type, ir.VectorType) else self.raw.type

    @property
    def lanes(self) -> int:
        """Number of lanes; 0 for a number."""
        return self.raw.type.count if isinstance(self.raw.type, ir.VectorType) else 0

    @property
    def is_real(self) -> bool:
        """Whether lanes are floats."""
        return self.element in (F32, F64)

    def _binary(self, sign: str, other: Operand, swapped: bool = False) -> Value:
        mine, theirs = unify(self, other)
        if swapped:
            mine, theirs = theirs, mine
        write = getattr(self.builder, (_REAL if self.is_real else _WHOLE)[sign])
        return Value(self.builder, write(mine.raw, theirs.raw))

    def _compare(self, sign: str, other: Operand) -> Value:
        mine, theirs = unify(self, other)
        builder = self.builder
        write = builder.fcmp_ordered if self.is_real else builder.icmp_signed
        return Value(self.builder, write(sign, mine.raw, theirs.raw))

    def __add__(self, other: Operand) -> Value:
        return self._binary("+", other)

    def __radd__(self, other: Number) -> Value:
        return self._binary("+", other)

    def __sub__(self, other: Operand) -> Value:
        return self._binary("-", other)

    def __rsub__(self, other: Number) -> Value:
        return self._binary("-", other, swapped=True)

    def __mul__(self, other: Operand) -> Value:
        return self._binary("*", other)

    def __rmul__(self, other: Number) -> Value:
        return self._binary("*", other)

    def __truediv__(self, other: Operand) -> Value:
        return self._binary("/", other)

    def __rtruediv__(self, other: Number) -> Value:
        return self._binary("/", other, swapped=True)

    def __and__(self, other: Operand) -> Value:
        return self._binary("&", other)

    def __or__(self, other: Operand) -> Value:
        return self._binary("|", other)

    def __xor__(self, other: Operand) -> Value:
        return self._binary("^", other)

    def __lshift__(self, other: Operand) -> Value:
        return self._binary("<<", other)

    def __rshift__(self, other: Operand) -> Value:
        """Logical shift to the right."""
        return self._binary(">>", other)

    def shifted(self, bits: int) -> Value:
        """Arithmetic shift to the right."""
        return Value(self.builder, self.builder.ashr(self.raw, unify(self, bits)[1].raw))

    def __invert__(self) -> Value:
        return Value(self.builder, self.builder.not_(self.raw))

    def __neg__(self) -> Value:
        return 0.0 - self if self.is_real else 0 - self

    def __lt__(self, other: Operand) -> Value:
        return self._compare("<", other)

    def __le__(self, other: Operand) -> Value:
        return self._compare("<=", other)

    def __gt__(self, other: Operand) -> Value:
        return self._compare(">", other)

    def __ge__(self, other: Operand) -> Value:
        return self._compare(">=", other)

    def equals(self, other: Operand) -> Value:
        """Compare for equality, lane by lane."""
        return self._compare("==", other)

    def to(self, element: Any) -> Value:
        """Convert: floats to integers towards zero, integers as signed ones."""
        if element is self.element:
            return self
        builder, kind = self.builder, kind_of(element, self.lanes)
        if self.is_real:
            write = {F64: builder.fpext, F32: builder.fptrunc}.get(element, builder.fptosi)
        elif element in (F32, F64):
            write = builder.uitofp if self.element is I1 else builder.sitofp
        elif element.width > self.element.width:
            write = builder.zext if self.element is I1 else builder.sext
        else:
            write = builder.trunc
        return Value(self.builder, write(self.raw, kind))

    def unsigned(self, element: Any) -> Value:
        """Convert unsigned integers to wider ones."""
        if element is self.element:
            return self
        return Value(self.builder, self.builder.zext(self.raw, kind_of(element, self.lanes)))

    def bits(self, element: Any) -> Value:
        """Return the same bits as lanes of another type."""
        lanes = self.lanes and self.lanes * BYTES[self.element] // BYTES[element]
        return Value(self.builder, self.builder.bitcast(self.raw, kind_of(element, lanes)))

    def lane(self, number: int) -> Value:
        """Return one lane."""
        return Value(self.builder, self.builder.extract_element(self.raw, I32(number)))

    def with_lane(self, number: int, value: Value) -> Value:
        """Return the vector with one lane replaced."""
        return Value(self.builder, self.builder.insert_element(self.raw, value.raw, I32(number)))


Operand = Value | Number
Vector = tuple[Value, Value, Value]


def vector_of(parts: Iterable[Value]) -> Vector:
    """Return three values as a 3-D vector."""
    x, y, z = parts
    return x, y, z


def kind_of(element: Any, lanes: int) -> Any:
    """Return the LLVM type of a number (0 lanes) or a vector."""
    return ir.VectorType(element, lanes) if lanes else element


def splat(value: Value, lanes: int) -> Value:
    """Return a vector with a number in all lanes."""
    builder, empty = value.builder, ir.Constant(kind_of(value.element, lanes), ir.Undefined)
    one = builder.insert_element(empty, value.raw, I32(0))
    return Value(builder, builder.shuffle_vector(one, one, ir.Constant(kind_of(I32, lanes), [0] * lanes)))


def unify(a: Operand, b: Operand) -> tuple[Value, Value]:
    """Convert two operands to one type: constants to the type of values, numbers to vectors."""
    if not isinstance(a, Value):
        second, first = unify(b, a)
        return first, second
    if not isinstance(b, Value):
        constant = float(b) if a.is_real else int(b)
        b = Value(a.builder, ir.Constant(a.raw.type, [constant] * a.lanes if a.lanes else constant))
    if a.lanes and not b.lanes:
        b = splat(b, a.lanes)
    elif b.lanes and not a.lanes:
        a = splat(a, b.lanes)
    return a, b
